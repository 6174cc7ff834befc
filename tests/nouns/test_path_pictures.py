"""Pictures for people: of a path, of all layers, of what became of a map."""

from __future__ import annotations

import httpx
import numpy as np
import pytest
from percept import (
    FailedPrecondition,
    GridMap,
    InvalidArgument,
    NoPath,
    NotFound,
    Path,
    PathColouring,
    PathOptions,
    PerceptError,
    Pose,
    Zone,
)

from support import world

#: A hall of 8 x 4 m with a wall across it that has a door of 1 m.
CELLS = np.zeros((80, 160), np.int8)
CELLS[:, 80] = 100
CELLS[30:50, 80] = 0
HALL = GridMap(cells=CELLS, resolution_m=0.05, origin=(-1.0, 2.0))
START, GOAL = (0.5, 4.0), (6.0, 4.5)
#: Colours of the pictures: blocked, start, goal, appeared.
RED, GREEN, MAGENTA = (204, 24, 30), (0, 158, 115), (200, 0, 140)


def pixels(client, png: bytes) -> np.ndarray:
    """(H, W, 3) of a PNG."""
    return client.toolbox.decode_colour(png)


def count(client, png: bytes, colour) -> int:
    return int((pixels(client, png) == np.array(colour)).all(-1).sum())


def test_a_path_is_drawn_with_its_ends_and_the_path_comes_along(client):
    picture = client.toolbox.draw_path_on_map(HALL, START, GOAL)
    assert isinstance(picture.outcome, Path)
    assert picture.outcome == client.toolbox.plan_on_map(HALL, START, GOAL)
    assert (picture.misfit, picture.stamp) == (None, None)
    image = pixels(client, picture.png)
    assert max(image.shape) >= 900
    for colour in (GREEN, MAGENTA):
        assert (image == np.array(colour)).all(-1).sum() > 100
    assert picture._repr_png_() == picture.png
    # The same input gives the same bytes.
    assert client.toolbox.draw_path_on_map(HALL, START, GOAL).png == picture.png


def test_colours_along_a_path_mean_what_is_asked(client):
    slow = PathOptions(zones=[Zone(polygon=[(1, 2), (2, 2), (2, 6), (1, 6)], speed_share=0.2)])
    draw = client.toolbox.draw_path_on_map
    drawn = {c: draw(HALL, START, GOAL, colouring=c, options=slow).png for c in PathColouring}
    assert drawn["unspecified"] == drawn["clearance"]
    assert len(set(drawn.values())) == 3
    with pytest.raises(InvalidArgument) as error:
        client.toolbox.draw_path_on_map(HALL, START, GOAL, colouring="height")
    assert error.value.field == "colouring"


def test_where_there_is_no_path_the_reason_and_what_blocks_are_drawn(client):
    cells = CELLS.copy()
    cells[:, 80] = 100
    shut = GridMap(cells=cells, resolution_m=0.05, origin=(-1.0, 2.0))
    picture = client.toolbox.draw_path_on_map(shut, START, GOAL)
    assert isinstance(picture.outcome, NoPath)
    assert picture.outcome.reason == "unreachable"
    assert picture.outcome.blocking is not None
    assert count(client, picture.png, RED) > 50
    assert count(client, client.toolbox.draw_path_on_map(HALL, START, GOAL).png, RED) == 0


def test_a_given_path_is_drawn_as_it_is_with_its_first_misfit(client):
    through_the_wall = [Pose.from_xy_yaw(x, 5.5, 0.0) for x in (0.5, 6.0)]
    picture = client.toolbox.draw_path_on_map(HALL, path=through_the_wall)
    assert picture.outcome is None
    assert picture.misfit == client.toolbox.validate_on_map(HALL, through_the_wall)
    assert picture.misfit.pose.translation[0] == pytest.approx(3.0, abs=0.5)
    assert count(client, picture.png, RED) > 50
    planned = client.toolbox.plan_on_map(HALL, START, GOAL)
    assert client.toolbox.draw_path_on_map(HALL, path=planned).misfit is None


def test_the_path_of_a_session_is_drawn_from_where_the_robot_is(client, laser_session):
    picture = laser_session.draw_path(world.to_map(2.4, 0.0))
    assert picture.outcome == laser_session.plan(world.to_map(2.4, 0.0))
    assert picture.stamp == picture.outcome.stamp
    assert count(client, picture.png, GREEN) > 100
    given = laser_session.draw_path(path=picture.outcome)
    assert (given.outcome, given.misfit) == (None, None)


def test_a_robot_that_does_not_know_where_it_is_is_drawn_a_reason(client):
    session = client.sessions.create(sensors=[world.LASER])
    session.map.import_map(HALL)
    picture = session.draw_path(GOAL)
    assert picture.outcome.reason == "lost"
    assert count(client, picture.png, MAGENTA) > 100


@pytest.mark.parametrize(
    ("arguments", "field"),
    [
        ({}, "goal"),
        ({"goal": GOAL, "path": [Pose(), Pose()]}, "goal"),
        ({"goal": (np.nan, 0.0)}, "goal"),
        ({"goal": GOAL, "start": (0.0, np.inf)}, "start"),
        ({"path": [Pose.from_xy_yaw(0, 0, np.nan)]}, "poses[0]"),
        ({"path": np.zeros((3, 3))}, "poses[0]"),
        ({"path": [Pose()] * 100_001}, "poses"),
        ({"goal": GOAL, "params": {"robot_radius_m": -1.0}}, "params"),
        ({"goal": GOAL, "options": PathOptions(footprint=[(0, 0), (1, 0)])}, "options.footprint"),
    ],
)
def test_what_cannot_be_drawn_is_refused_by_field(laser_session, arguments, field):
    with pytest.raises(PerceptError) as error:
        laser_session.draw_path(**arguments)
    assert error.value.field == field, error.value


def test_all_layers_of_a_session_are_drawn_side_by_side(client, laser_session, lidar_session):
    sizes = {}
    for name, session in (("laser", laser_session), ("lidar", lidar_session)):
        image = pixels(client, session.map.export("layers_png").data)
        sizes[name] = image.shape
    # The laser's has the grid and the cloud, the lidar's six layers in two rows.
    assert sizes["lidar"][0] > sizes["laser"][0] / 2
    assert max(sizes["lidar"]) > 2000


def test_layers_of_an_empty_map_are_refused(client):
    session = client.sessions.create(sensors=[world.LASER])
    with pytest.raises(FailedPrecondition) as error:
        session.map.export("layers_png")
    assert error.value.reason == "MAP_EMPTY"


@pytest.fixture
def hall(client):
    session = client.sessions.create(params={"map": {"occupancy": {"resolution_m": 0.05}}})
    session.map.import_map(HALL)
    return session


def test_what_appeared_and_what_has_gone_is_counted_and_drawn(client, hall):
    same = hall.map.compare(hall.map.occupancy())
    assert (same.num_appeared, same.num_gone, same.num_newly_seen) == (0, 0, 0)
    assert same.cell_area_m2 == pytest.approx(0.0025)
    before = hall.map.occupancy().cells.copy()
    where = hall.map.occupancy()
    # What stood in the left room a box of 0.5 m, 10 x 10 cells, and the wall right of the door did not.
    assert (abs(before[10:20, 20:30] - 20) <= 20).all()
    before[10:20, 20:30] = 100
    column, row = ((np.array([3.025, 4.75]) - where.origin) / where.resolution_m).astype(int)
    wall = np.argwhere(before >= 60)
    wall = wall[(wall[:, 0] > row) & (wall[:, 1] == column)]
    assert len(wall) > 10
    before[wall[:, 0], wall[:, 1]] = 0
    older = GridMap(cells=before, resolution_m=where.resolution_m, origin=where.origin)
    found = hall.map.compare(older, tolerance_m=0.0)
    assert found.num_gone == 100
    assert found.num_appeared == len(wall)
    assert found.stamp == where.stamp
    assert count(client, found.png, RED) > 100
    assert count(client, found.png, GREEN) > 100


def test_a_map_is_compared_with_that_of_another_session(client, hall):
    other = client.sessions.create(params={"map": {"occupancy": {"resolution_m": 0.05}}})
    with pytest.raises(FailedPrecondition) as error:
        hall.map.compare(before_session=other.session_id)
    assert (error.value.reason, error.value.field) == ("MAP_EMPTY", "session_id")
    other.map.import_map(HALL)
    found = hall.map.compare(before_session=other.session_id)
    assert (found.num_appeared, found.num_gone) == (0, 0)
    with pytest.raises(NotFound):
        hall.map.compare(before_session="nobody")


@pytest.mark.parametrize(
    ("arguments", "field"),
    [
        ({}, "before"),
        ({"tolerance_m": -0.1}, "tolerance_m"),
        ({"tolerance_m": 9.0}, "tolerance_m"),
        ({"tolerance_m": float("nan")}, "tolerance_m"),
        ({"before": GridMap(cells=CELLS, resolution_m=0.0)}, "grid.geometry.resolution_m"),
        ({"before": GridMap(cells=np.full((2, 2), 101, np.int8), resolution_m=0.1)}, "grid.cells"),
        ({"before": GridMap(cells=CELLS, resolution_m=0.05, origin=(1e7, 0.0))}, "before"),
    ],
)
def test_maps_that_cannot_be_compared_are_refused_by_field(hall, arguments, field):
    if "tolerance_m" in arguments:
        arguments = {"before": HALL} | arguments
    with pytest.raises(PerceptError) as error:
        hall.map.compare(**arguments)
    assert error.value.field == field, error.value


def test_rest_answers_with_the_picture_or_where_it_is_asked_for_with_all(server, hall):
    url = f"{server.rest_url}/v1/sessions/{hall.session_id}/draw-path"
    body = {"start": {"x": 0.5, "y": 4.0}, "goal": {"x": 6.0, "y": 4.5}}
    for accept in ("image/png", "*/*"):
        answer = httpx.post(url, json=body, headers={"accept": accept}, timeout=30)
        assert (answer.status_code, answer.headers["content-type"]) == (200, "image/png")
        assert answer.content.startswith(b"\x89PNG")
    answer = httpx.post(url, json=body, headers={"accept": "application/json"}, timeout=30)
    assert answer.json()["path"]["length_m"] > 5
    refused = httpx.post(url, json={}, timeout=30)
    problem = refused.json()
    assert (refused.status_code, problem["reason"], problem["field"]) == (400, "FIELD_MISSING", "goal")
