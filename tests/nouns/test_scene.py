from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from percept import InvalidArgument, NotFound

from support import world


@pytest.fixture(scope="module")
def objects(lidar_session):
    found = list(lidar_session.scene.objects())
    assert found, "no object in a furnished room"
    return found


def test_furniture_is_found_where_it_stands(objects):
    centres = [(low + high) / 2 for low, high in world.FURNITURE]
    start = world.drive(1)[0].translation
    found = np.array([o.box.centre + start for o in objects])
    near = [np.linalg.norm(found[:, :2] - c[:2], axis=1).min() for c in centres]
    # Only the sides that the robot saw make the box.
    assert sum(d < 0.4 for d in near) >= 3, near


def test_objects_say_what_they_are(objects):
    for o in objects:
        assert 0 <= o.confidence <= 1
        assert (o.box.size_m > 0).all()
        assert o.first_seen_ns <= o.last_seen_ns
        assert o.num_observations >= 1
        assert o.state in ("static", "moving")
        # Upright: the box's z axis is the map's.
        assert o.box.t_frame_box.matrix[2, 2] == pytest.approx(1, abs=1e-6)
    ids = [o.object_id for o in objects]
    assert ids == sorted(set(ids))


def test_pages_and_classes_are_parts_of_the_whole(lidar_session, objects):
    assert list(lidar_session.scene.objects(page_size=1)) == objects
    by_class = [
        o
        for c in ("unknown", "table", "chair", "shelf", "box", "cylinder", "person")
        for o in lidar_session.scene.objects(object_class=c)
    ]
    assert sorted(by_class, key=lambda o: o.object_id) == objects
    one = lidar_session.scene.object(objects[0].object_id)
    assert one.history
    assert dataclasses.replace(one, history=()) == objects[0]


def test_what_does_not_exist_is_not_found(lidar_session):
    with pytest.raises(NotFound) as error:
        lidar_session.scene.object(10**9)
    assert (error.value.reason, error.value.field) == ("OBJECT_NOT_FOUND", "object_id")
    assert list(lidar_session.scene.objects(object_class="sofa")) == []
    with pytest.raises(InvalidArgument) as error:
        list(lidar_session.scene.objects(object_class="a name that no class of things can have"))
    assert (error.value.reason, error.value.field) == ("CLASS_NAME_INVALID", "label")


def test_the_graph_has_the_robot_and_every_object(lidar_session, objects):
    graph = lidar_session.scene.graph()
    nodes = {n.node_id: n for n in graph.nodes}
    assert len(nodes) == len(graph.nodes)
    robots = [n for n in graph.nodes if n.kind == "robot"]
    assert len(robots) == 1
    assert np.allclose(robots[0].t_map_node.matrix, lidar_session.pose().t_map_base.matrix, atol=1e-9)
    assert [n.object for n in graph.nodes if n.kind == "object"] == objects
    assert (graph.frame_id, graph.stamp_ns) == ("map", world.stamp(world.LIDAR_LAST))


def test_relations_join_nodes_with_a_strength_in_a_frame(lidar_session):
    graph = lidar_session.scene.graph()
    ids = {n.node_id for n in graph.nodes}
    assert graph.relations
    frames = {"inside": "any", "near": "any", "next_to": "any", "in_room": "any", "connected_to": "any"}
    for r in graph.relations:
        assert {r.subject_id, r.object_id} <= ids
        assert r.subject_id != r.object_id
        assert 0 < r.strength <= 1
        assert r.frame == frames.get(r.kind, "gravity")


def test_an_empty_session_has_a_graph_without_objects(client):
    session = client.sessions.create(sensors=[world.LIDAR])
    assert list(session.scene.objects()) == []
    assert [n for n in session.scene.graph().nodes if n.kind == "object"] == []


def test_what_was_taken_away_is_gone_within_three_seconds_and_does_not_come_back(client):
    # Rounds of a lidar whose rings are two degrees and a half apart; the crate stands for the first.
    low, high = world.FURNITURE[world.CRATE]
    left = [thing for i, thing in enumerate(world.FURNITURE) if i != world.CRATE]
    session = client.sessions.create(sensors=[world.LIDAR])
    poses = [pose for _ in range(3) for pose in world.circle()]
    place = (np.linalg.inv(poses[0].matrix) @ np.append((low + high) / 2, 1))[:2]
    told = []
    for i, pose in enumerate(poses):
        furniture = world.FURNITURE if i < world.ROUND else left
        # Three frames a second, each a keyframe.
        session.send_cloud("lidar", stamp_ns=world.stamp(5 * i), points=world.cloud(pose, furniture=furniture))
        if i >= world.ROUND - 1:
            near = [o for o in session.scene.objects() if np.linalg.norm(o.box.centre[:2] - place) < 0.5]
            told.append([o.object_id for o in near if o.state != "gone"])
    assert told[0], "the crate was never found"
    assert not any(told[10:]), [len(of) for of in told]
    others = [o.label for o in session.scene.objects() if o.state != "gone"]
    assert sorted(others) == ["chair", "shelf", "table"], others


def test_what_a_camera_that_turns_by_saw_go_is_gone_within_three_seconds(client):
    # Rounds of twelve seconds; in the second one the camera passes the place within two, with a keyframe or two.
    low, high = world.FURNITURE[world.CHEST]
    left = [thing for i, thing in enumerate(world.FURNITURE) if i != world.CHEST]
    session = client.sessions.create(sensors=[world.CAMERA])
    poses = world.circle(180)
    place = (np.linalg.inv(poses[0].matrix) @ np.append((low + high) / 2, 1))[:2]
    told = {}
    # More than half of it is in the picture from the tenth frame of a round to the thirtieth.
    for i, pose in enumerate([*poses, *poses[:60]]):
        furniture = world.FURNITURE if i < 180 else left
        depth = world.depth_image(pose, furniture=furniture)
        session.send_depth("camera", stamp_ns=world.stamp(i), depth=depth, metres_per_unit=0.001)
        if i in (179, 189) or i >= 190 + 45:
            near = [o for o in session.scene.objects() if np.linalg.norm(o.box.centre[:2] - place) < 0.4]
            told[i] = [o.label for o in near if o.state != "gone"]
    assert told.pop(179) and told.pop(189), "the chest was never found"
    assert not any(told.values()), told
