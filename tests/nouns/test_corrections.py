"""What people say of objects: labels, deleted, merged and split things, learned classes; and the past."""

from __future__ import annotations

import dataclasses
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from percept import Client, FailedPrecondition, InvalidArgument, NotFound, OrientedBox, Pose, RelationFilter

from support import world


def furnished(client: Client, name: str | None = None):
    session = (
        client.sessions.create(name, sensors=[world.LIDAR]) if name else client.sessions.create(sensors=[world.LIDAR])
    )
    drive(session, 0)
    return session


def drive(session, lap: int) -> None:
    """The robot goes through the room, there and back again by turns."""
    poses = world.lidar_drive()
    with session.stream() as stream:
        for i, pose in enumerate(poses if lap % 2 == 0 else poses[::-1]):
            stamp = world.stamp(lap * (world.LIDAR_LAST + 1) + i)
            stream.send_cloud("lidar", stamp_ns=stamp, points=world.cloud(pose))
    assert stream.summary.rejected == 0, stream.summary.rejections


@pytest.fixture
def session(client):
    return furnished(client)


def listed(session, **asked):
    return {o.object_id: o for o in session.scene.objects(**asked)}


def test_a_label_stays_while_the_robot_goes_on_looking(session):
    thing = next(iter(listed(session).values()))
    said = session.scene.label(thing.object_id, "Office Plant")
    assert (said.label, said.object_class, said.confidence) == ("office plant", "unknown", 1.0)
    assert said.annotation.label == "office plant"
    drive(session, 1)
    after = session.scene.object(thing.object_id)
    assert after.label == "office plant"
    assert after.num_observations > thing.num_observations
    # What the machine thinks is told beside it.
    assert "office plant" not in after.class_probabilities
    assert [h.label for h in after.history][-1] == "office plant"
    assert list(listed(session, object_class="OFFICE plant")) == [thing.object_id]
    assert list(listed(session, text="PLANT")) == [thing.object_id]
    # Relations are asked for by it, too.
    graph = session.scene.graph(relations=RelationFilter(subject_class="office plant", kinds=["in_room"]))
    assert {r.subject_id for r in graph.relations} <= {f"object/{thing.object_id}"}
    assert session.scene.label(thing.object_id, "").annotation.label == ""


def test_the_graph_tells_what_happened_since_a_time(session):
    things = listed(session)
    since = {t.object_id: t.first_seen_ns for t in things.values()}
    assert not [r for r in session.scene.graph().relations if r.stamp_ns is not None]
    told = session.scene.graph(since_ns=0).relations
    appeared = {r.subject_id: r for r in told if r.kind == "appeared_in"}
    assert set(appeared) == {f"object/{i}" for i in things}
    for i, stamp in since.items():
        assert stamp <= appeared[f"object/{i}"].stamp_ns <= things[i].last_seen_ns
    order = [r for r in told if r.kind in ("before", "together")]
    assert len(order) == len(things) - 1
    assert len({r.subject_id for r in order}) == len(order)
    # Of one kind, and from later on.
    asked = RelationFilter(kinds=["appeared_in"])
    late = sorted(since.values())[-1]
    some = session.scene.graph(since_ns=late, relations=asked).relations
    assert len(some) < len(appeared)
    assert all(r.stamp_ns > late for r in some)
    with pytest.raises(InvalidArgument) as error:
        session.scene.graph(since_ns=late + 1, at_ns=late)
    assert error.value.field == "since_ns"


def test_who_watches_some_objects_is_told_of_those_and_of_what_becomes_of_them(session):
    ours, other, third = list(listed(session))[:3]
    boxes = listed(session)
    low, high = boxes[ours].box.centre - 0.01, boxes[ours].box.centre + 0.01
    by_label = session.watch(kinds=["object"], label="office plant")
    by_text = session.watch(kinds=["object"], text="PLANT")
    by_place = session.watch(kinds=["object"], low=low, high=high)
    loops = session.watch(kinds=["loop"])
    with by_label, by_text, by_place, loops:
        session.scene.label(other, "desk")
        session.scene.label(third, "plant pot")
        session.scene.label(ours, "office plant")
        # It is no plant any more, and is followed all the same.
        session.scene.label(ours, "box")
        told = lambda watch, num: [next(watch).event for _ in range(num)]  # noqa: E731
        assert [(e.object_id, e.object.label) for e in told(by_label, 2)] == [
            (ours, "office plant"),
            (ours, "box"),
        ]
        assert [e.object_id for e in told(by_text, 3)] == [third, ours, ours]
        assert [e.object_id for e in told(by_place, 2)] == [ours, ours]
        # A watch of other kinds hears nothing of it.
        session.map.optimise()
    for wrong, field in [({"kinds": ["life"]}, "kinds"), ({"label": "x" * 40}, "objects.label")]:
        with pytest.raises(InvalidArgument) as error, session.watch(**wrong) as watch:
            next(watch)
        assert error.value.field == field


def test_what_is_deleted_is_not_told_again(session):
    before = listed(session)
    thing = next(iter(before))
    assert session.scene.delete_object(thing).annotation.is_deleted
    drive(session, 1)
    assert thing not in listed(session)
    assert f"object/{thing}" not in {n.node_id for n in session.scene.graph().nodes}
    place = before[thing].box.centre
    assert not [o for o in listed(session).values() if np.linalg.norm(o.box.centre - place) < 0.2]
    assert session.scene.object(thing).annotation.is_deleted
    assert thing in listed(session, include_set_aside=True)
    session.scene.restore_object(thing)
    assert thing in listed(session)


def test_two_that_are_one_are_told_as_one(session):
    part, whole = list(listed(session))[:2]
    changed = session.scene.merge_objects(part, whole)
    assert {o.object_id for o in changed} == {part, whole}
    drive(session, 1)
    after = listed(session)
    assert part not in after
    for thing in (part, whole):
        # The whole's box holds both middles.
        aside = listed(session, include_set_aside=True)[thing]
        assert np.allclose(listed(session, include_set_aside=True)[whole].box.size_m, after[whole].box.size_m)
        inside = np.linalg.inv(after[whole].box.t_frame_box.matrix) @ [*aside.box.centre, 1]
        assert (np.abs(inside[:3]) <= after[whole].box.size_m / 2 + 1e-6).all()
    session.scene.restore_object(part)
    assert part in listed(session)


def test_one_that_is_two_stays_two(session):
    thing, found = next(iter(listed(session).items()))
    box = found.box
    half = box.size_m * [0.5, 1, 1]
    shift = Pose.from_xyz(half[0] / 2, 0, 0), Pose.from_xyz(-half[0] / 2, 0, 0)
    places = [Pose.from_matrix(box.t_frame_box.matrix @ s.matrix) for s in shift]
    boxes = [OrientedBox(t_frame_box=place, size_m=half) for place in places]
    gone, *pieces = session.scene.split_object(thing, boxes)
    assert gone.annotation.is_deleted
    assert [p.annotation.is_drawn for p in pieces] == [True, True]
    drive(session, 1)
    after = listed(session)
    assert thing not in after
    for piece, drawn in zip(pieces, boxes, strict=True):
        assert np.allclose(after[piece.object_id].box.centre, drawn.centre, atol=0.2)


def test_corrections_and_classes_are_there_after_a_restart(own_server):
    with Client(own_server.grpc) as client:
        session = furnished(client, "kept")
        first, second, *_ = listed(session)
        session.scene.label(first, "machine", learn=True)
        session.scene.delete_object(second)
        before = session.scene.object(first)
    own_server.kill()
    own_server.start()
    with Client(own_server.grpc) as client:
        session = client.sessions.get("kept")
        assert session.scene.object(first) == before
        assert second not in listed(session)
        (machine,) = [c for c in session.scene.object_classes() if c.label == "machine"]
        assert (machine.is_built_in, machine.num_examples, machine.num_objects) == (False, 1, 1)


def test_what_looks_like_an_example_is_of_its_class(client):
    """What one session learned by a thing, shown to it anew, it calls by that name."""
    session = furnished(client)
    thing, found = next((i, o) for i, o in listed(session).items() if o.label != "unknown")
    session.scene.label(thing, "machine", learn=True)
    # Nobody says so any more; it is learned all the same.
    session.scene.label(thing, "")
    for lap in (1, 2):
        drive(session, lap)
    after = session.scene.object(thing)
    assert after.label == "machine", (found, after)
    assert after.confidence < 1
    assert session.scene.forget_class("Machine") == 1
    with pytest.raises(NotFound) as error:
        session.scene.forget_class("machine")
    assert error.value.reason == "CLASS_NOT_FOUND"


def test_the_past_can_be_asked_for(session):
    thing, now = next(iter(listed(session).items()))
    before = now.first_seen_ns - 1
    assert thing not in listed(session, at_ns=before)
    then = listed(session, at_ns=now.last_seen_ns)[thing]
    assert then.label == now.label
    drive(session, 1)
    session.scene.label(thing, "machine")
    assert listed(session, at_ns=now.last_seen_ns)[thing].label == now.label
    graph = session.scene.graph(at_ns=world.stamp(10))
    robot = next(n for n in graph.nodes if n.kind == "robot")
    assert graph.stamp_ns == world.stamp(10)
    assert np.allclose(
        robot.t_map_node.matrix,
        session.transform("map", "base", at_ns=world.stamp(10)).t_target_source.matrix,
        atol=1e-6,
    )
    assert all(n.object.first_seen_ns <= graph.stamp_ns for n in graph.nodes if n.kind == "object")
    with pytest.raises(InvalidArgument) as error:
        session.scene.graph(at_ns=1)
    assert error.value.reason == "STAMP_BEFORE_TRAJECTORY"


def test_objects_by_place_and_time(session):
    objects = listed(session)
    by_distance = list(session.scene.objects(near=[0, 0, 0], page_size=2))
    nearest = sorted(objects.values(), key=lambda o: np.linalg.norm(o.box.centre))[:2]
    assert [o.object_id for o in by_distance] == [o.object_id for o in nearest]
    some = nearest[0]
    low, high = some.box.centre - 0.01, some.box.centre + 0.01
    assert list(listed(session, low=low, high=high)) == [some.object_id]
    rooms = session.scene.rooms().rooms
    in_rooms = {i for r in rooms for i in listed(session, room_id=r.room_id)}
    assert in_rooms == {i for r in rooms for i in r.object_ids}
    last = max(o.last_seen_ns for o in objects.values())
    assert listed(session, seen_since_ns=last + 1) == {}
    assert listed(session, seen_until_ns=0) == {}
    assert set(listed(session, seen_since_ns=0, seen_until_ns=last)) == set(objects)


def test_what_cannot_be_is_refused(session):
    thing, other = list(listed(session))[:2]
    box = session.scene.object(thing).box
    nowhere = dataclasses.replace(box, size_m=np.zeros(3))
    for call, kind, reason, field in [
        (lambda: session.scene.label(10**9, "x"), NotFound, "OBJECT_NOT_FOUND", "object_id"),
        (lambda: session.scene.label(thing, "x" * 32), InvalidArgument, "CLASS_NAME_INVALID", "label"),
        (lambda: session.scene.label(thing, "a\nb"), InvalidArgument, "CLASS_NAME_INVALID", "label"),
        (lambda: session.scene.label(thing, "", learn=True), InvalidArgument, "CORRECTION_INVALID", "learn"),
        (lambda: session.scene.merge_objects(thing, thing), InvalidArgument, "CORRECTION_INVALID", "part_of"),
        (lambda: session.scene.merge_objects(thing, 10**9), NotFound, "OBJECT_NOT_FOUND", "part_of"),
        (lambda: session.scene.split_object(thing, [box]), InvalidArgument, "CORRECTION_INVALID", "pieces"),
        (
            lambda: session.scene.split_object(thing, [box, nowhere]),
            InvalidArgument,
            "CORRECTION_INVALID",
            "pieces.boxes[1]",
        ),
        (lambda: list(session.scene.objects(room_id=10**9)), NotFound, "ROOM_NOT_FOUND", "room_id"),
        (
            lambda: list(session.scene.objects(at_ns=1, include_set_aside=True)),
            InvalidArgument,
            "FILTERS_INVALID",
            "include_set_aside",
        ),
    ]:
        with pytest.raises(kind) as error:
            call()
        assert (error.value.reason, error.value.field) == (reason, field)
    # Nothing can be learned from what is not there.
    own = session.scene.object(other).box
    above = Pose.from_xyz(*np.add(own.centre, (0, 0, own.size_m[2] / 2 + 0.6)))
    apart = dataclasses.replace(own, t_frame_box=Pose.from_xyz(*np.add(own.centre, (500.0, 0, 0))))
    with pytest.raises(InvalidArgument, match="away from the thing") as error:
        session.scene.split_object(other, [own, apart])
    assert error.value.field == "pieces.boxes[1]"
    _, _, far = session.scene.split_object(other, [own, OrientedBox(t_frame_box=above, size_m=(0.2, 0.2, 0.2))])
    with pytest.raises(FailedPrecondition) as error:
        session.scene.label(far.object_id, "ghost", learn=True)
    assert error.value.reason == "OBJECT_NOT_IN_MAP"
    assert session.scene.object(far.object_id).label != "ghost"


def test_many_who_correct_at_once(session):
    things = list(listed(session))
    with ThreadPoolExecutor(16) as pool:
        done = list(pool.map(lambda k: session.scene.label(things[k % len(things)], f"thing {k}"), range(64)))
    assert all(o.annotation.label for o in done)
    for k, thing in enumerate(things):
        assert int(session.scene.object(thing).label.split()[1]) % len(things) == k
