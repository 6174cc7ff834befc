"""Rooms: divided, named, led to, and what the graph says of them."""

from __future__ import annotations

import numpy as np
import pytest
from percept import Client, GridMap, InvalidArgument, NotFound, Path, RelationFilter

from support import world

#: Cells of 0.1 m: two rooms of 4 m x 3 m above a corridor of 8.5 m x 1.5 m, doors of 1 m between all of them.
RESOLUTION_M = 0.1


def flat() -> np.ndarray:
    cells = np.full((55, 95), 100, np.int8)
    cells[5:20, 5:90] = 0
    cells[25:55, 5:45] = 0
    cells[25:55, 50:90] = 0
    cells[35:45, 45:50] = 0
    cells[20:25, 15:25] = 0
    cells[20:25, 70:80] = 0
    cells[54, :] = 100
    return cells


LEFT, RIGHT, CORRIDOR = (2.0, 4.0), (7.0, 4.0), (5.5, 1.2)


def plan_of(session):
    session.map.import_map(GridMap(cells=flat(), resolution_m=RESOLUTION_M))
    return session


@pytest.fixture(scope="module")
def session(client):
    return plan_of(client.sessions.create(params={"map": {"occupancy": {"resolution_m": RESOLUTION_M}}}))


def at(rooms, point):
    """The room whose outline holds a point: by crossings."""

    def holds(room):
        a, b = room.outline, np.roll(room.outline, -1, axis=0)
        between = (a[:, 1] > point[1]) != (b[:, 1] > point[1])
        with np.errstate(divide="ignore", invalid="ignore"):
            x = a[:, 0] + (point[1] - a[:, 1]) / (b[:, 1] - a[:, 1]) * (b[:, 0] - a[:, 0])
        return np.count_nonzero(between & (x > point[0])) % 2 == 1

    (room,) = [r for r in rooms.rooms if holds(r)]
    return room


def test_rooms_and_doors_are_those_of_the_plan(session):
    rooms = session.scene.rooms()
    assert len(rooms.rooms) == 3
    left, right, corridor = (at(rooms, p) for p in (LEFT, RIGHT, CORRIDOR))
    assert (left.kind, right.kind, corridor.kind) == ("room", "room", "corridor")
    assert left.area_m2 == pytest.approx(4 * 2.9, abs=1.2)
    assert corridor.area_m2 == pytest.approx(8.5 * 1.5, abs=1.5)
    pairs = {d.room_ids for d in rooms.doors}
    joined = [(left, right), (left, corridor), (right, corridor)]
    assert pairs == {tuple(sorted((a.room_id, b.room_id))) for a, b in joined}
    assert all(d.width_m == pytest.approx(1.0, abs=0.15) for d in rooms.doors)
    assert rooms.places == () and rooms.links == ()
    assert rooms.map_version == session.map.summary().stamp.map_version


def test_places_lie_on_free_floor_and_are_linked(session):
    rooms = session.scene.rooms(with_places=True)
    cells = flat()
    for place in rooms.places:
        x, y = np.floor(place.position / RESOLUTION_M).astype(int)
        assert cells[y, x] == 0
        assert place.clearance_m > 0.15
    assert sum(p.is_in_door for p in rooms.places) == 3
    joined = {rooms.places[0].place_id}
    for _ in rooms.places:
        joined |= {i for link in rooms.links if joined & set(link.place_ids) for i in link.place_ids}
    assert joined == {p.place_id for p in rooms.places}


def test_a_name_stays_with_its_room(session):
    left = at(session.scene.rooms(), LEFT)
    assert session.scene.name_room(left.room_id, "Ada's office").name == "Ada's office"
    again = at(session.scene.rooms(), LEFT)
    assert (again.room_id, again.name) == (left.room_id, "Ada's office")
    label = next(n.label for n in session.scene.graph().nodes if n.node_id == f"room/{left.room_id}")
    assert label == "Ada's office"
    assert session.scene.name_room(left.room_id, "").name == ""
    for room_id, name, kind, field in [
        (10**9, "x", NotFound, "room_id"),
        (left.room_id, "x" * 65, InvalidArgument, "name"),
        (left.room_id, "a\nb", InvalidArgument, "name"),
    ]:
        with pytest.raises(kind) as error:
            session.scene.name_room(room_id, name)
        assert error.value.field == field


def test_the_way_to_a_room_goes_from_door_to_door(session):
    rooms = session.scene.rooms()
    left, corridor = at(rooms, LEFT), at(rooms, CORRIDOR)
    session.scene.name_room(corridor.room_id, "Corridor")
    route = session.scene.route_to_room("corridor", start=LEFT)
    assert [s.room_id for s in route.steps] == [left.room_id, corridor.room_id]
    assert str(route.steps[1]) == "Corridor"
    assert route.steps[0].door.center == pytest.approx([2.0, 2.2], abs=0.35)
    assert route.steps[1].door is None
    assert isinstance(route.outcome, Path)
    assert route.outcome.waypoints[-1] == pytest.approx(route.goal, abs=1e-6)
    assert at(rooms, route.goal).room_id == corridor.room_id
    # By number; in the room already.
    assert len(session.scene.route_to_room(left.room_id, start=LEFT).steps) == 1
    with pytest.raises(NotFound) as error:
        session.scene.route_to_room("cellar", start=LEFT)
    assert (error.value.reason, error.value.field) == ("ROOM_NOT_FOUND", "room_name")
    session.scene.name_room(left.room_id, "CORRIDOR")
    with pytest.raises(InvalidArgument) as error:
        session.scene.route_to_room("corridor", start=LEFT)
    assert error.value.reason == "ROOM_NAME_AMBIGUOUS"
    session.scene.name_room(left.room_id, "")
    session.scene.name_room(corridor.room_id, "")


def test_names_and_rooms_are_there_after_a_restart(own_server):
    with Client(own_server.grpc) as client:
        session = plan_of(client.sessions.create("kept", params={"map": {"occupancy": {"resolution_m": RESOLUTION_M}}}))
        before = session.scene.rooms()
        session.scene.name_room(at(before, RIGHT).room_id, "lab")
    own_server.stop()
    own_server.start()
    with Client(own_server.grpc) as client:
        after = client.sessions.get("kept").scene.rooms()
        assert [r.room_id for r in after.rooms] == [r.room_id for r in before.rooms]
        assert at(after, RIGHT).name == "lab"


def test_a_session_without_a_map_has_no_rooms(client):
    session = client.sessions.create(sensors=[world.LIDAR])
    rooms = session.scene.rooms(with_places=True)
    assert (rooms.rooms, rooms.doors, rooms.places) == ((), (), ())
    with pytest.raises(NotFound):
        session.scene.route_to_room(0)


def test_the_graph_answers_what_is_asked(session, lidar_session):
    rooms = session.scene.rooms()
    pair = RelationFilter(kinds=["connected_to"])
    graph = session.scene.graph(relations=pair)
    assert len(graph.relations) == 3 and len(graph.nodes) == 3
    corridor = at(rooms, CORRIDOR)
    of_corridor = session.scene.graph(relations=RelationFilter(kinds=["connected_to"], room_id=corridor.room_id))
    assert len(of_corridor.relations) == 2
    # What a lidar has seen: who is in which room, and left and right for somebody.
    kinds = {r.kind for r in lidar_session.scene.graph().relations}
    assert "in_room" in kinds and not kinds & {"left_of", "right_of", "in_front_of", "behind"}
    for frame in ("robot", "map", "viewer"):
        seen = lidar_session.scene.graph(directions=frame, viewer_yaw_rad=1.0)
        frames = {r.frame for r in seen.relations if r.kind in ("left_of", "right_of")}
        assert frames == {frame}
    strong = lidar_session.scene.graph(relations=RelationFilter(kinds=["near", "next_to"], min_strength=0.8))
    assert all(r.strength >= 0.8 for r in strong.relations)
    named = {i for r in strong.relations for i in (r.subject_id, r.object_id)}
    assert {n.node_id for n in strong.nodes} == named


@pytest.mark.parametrize(
    ("asked", "field"),
    [
        ({"relations": RelationFilter(subject_id="chair 3")}, "filter.subject_id"),
        ({"relations": RelationFilter(min_strength=2.0)}, "filter.min_strength"),
        ({"relations": RelationFilter(low=(0, 0, 0), high=(0, 1, 1))}, "region"),
        ({"directions": "gravity"}, "directions"),
        ({"directions": "viewer", "viewer_yaw_rad": float("nan")}, "viewer_yaw_rad"),
    ],
)
def test_a_question_that_cannot_be_is_refused(session, asked, field):
    with pytest.raises(InvalidArgument) as error:
        session.scene.graph(**asked)
    assert error.value.field == field
