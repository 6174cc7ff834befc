"""Paths that cover, frontiers, paths in space."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from percept import (
    Client,
    CoverageOptions,
    CoveragePath,
    FailedPrecondition,
    FlightOptions,
    FlightPath,
    GridMap,
    InvalidArgument,
    NoFlight,
    NoPath,
    PathOptions,
    StoreyOptions,
    Zone,
    ZoneMask,
)

from support import world


@pytest.fixture(scope="module")
def hall(client):
    """A hall of 8 x 4 m with a pillar; nothing is known of the third room behind its door at the upper right."""
    cells = np.full((90, 230), -1, np.int8)
    cells[4:86, 4:166] = 100
    cells[5:85, 5:165] = 0
    cells[40:50, 80:90] = 100
    cells[60:80, 165:166] = 0
    params = {"map": {"occupancy": {"resolution_m": 0.05}}}
    session = client.sessions.create(params=params)
    session.map.import_map(GridMap(cells=cells, resolution_m=0.05))
    return session


def test_a_path_covers_what_the_robot_reaches(hall):
    options = CoverageOptions(tool_width_m=0.5)
    found = hall.plan_coverage(start=(1.0, 1.0), coverage=options)
    assert isinstance(found, CoveragePath)
    assert found.covered_share >= 0.98
    assert 24 < found.coverable_m2 < 32
    assert len(found.leg_starts) == len(found.is_transit) > 5
    # As wide as the tool is, and to and fro: some 30 m^2 / 0.45 m.
    assert 55 < found.path.length_m < 110
    # Where the tool has been, by hand.
    step = 0.05
    y, x = np.mgrid[0.5:4.0:0.1, 0.5:8.0:0.1]
    points = np.column_stack([x.ravel(), y.ravel()])
    way = found.path.waypoints
    dense = np.vstack(
        [
            a + (b - a) * np.linspace(0, 1, max(2, int(np.linalg.norm(b - a) / step)))[:, None]
            for a, b in itertools.pairwise(way)
        ]
    )
    near = np.array([np.min(np.sum((dense - p) ** 2, axis=1)) for p in points]) <= 0.27**2
    pillar = (np.abs(points[:, 0] - 4.25) < 0.3) & (np.abs(points[:, 1] - 2.25) < 0.3)
    assert np.mean(near[~pillar]) > 0.97


def test_zones_are_left_out_of_what_is_covered(hall):
    left = Zone(polygon=[(-1, -1), (4, -1), (4, 5), (-1, 5)])
    whole = hall.plan_coverage(start=(6.0, 1.0))
    half = hall.plan_coverage(start=(6.0, 1.0), options=PathOptions(zones=[left]))
    assert 0.3 < half.coverable_m2 / whole.coverable_m2 < 0.7
    inside = hall.plan_coverage(start=(1.0, 1.0), options=PathOptions(zones=[left]))
    assert isinstance(inside, NoPath)
    assert inside.reason == "start_in_keep_out"


def test_the_frontier_is_where_the_unknown_begins(hall):
    found = hall.frontiers(start=(1.0, 1.0))
    assert found
    assert abs(found[0].length_m - 1.0) < 0.2
    assert np.allclose(found[0].cells.mean(axis=0), (8.27, 3.5), atol=0.15)
    assert found[0].cost > 6
    assert hall.plan(found[0].goal, start=(1.0, 1.0))
    assert hall.frontiers(start=(1.0, 1.0), min_length_m=5.0) == []
    with pytest.raises(InvalidArgument, match="outside of the map") as refused:
        hall.frontiers(start=(500.0, 1.0))
    assert refused.value.field == "start", "no frontiers would say that all is known"
    # Where the robot is nobody knows.
    with pytest.raises(FailedPrecondition) as error:
        hall.frontiers()
    assert error.value.reason == "NO_POSE_YET"


def test_no_frontier_lies_in_a_keep_out_zone_or_beyond_one(hall):
    start = (1.0, 1.0)
    across = Zone(polygon=[(6.0, -1), (6.2, -1), (6.2, 5), (6.0, 5)])
    over_the_door = Zone(polygon=[(7.8, 2.5), (9, 2.5), (9, 4.5), (7.8, 4.5)])
    beside = Zone(polygon=[(6.0, -1), (6.2, -1), (6.2, 1), (6.0, 1)])
    [free] = hall.frontiers(start=start)
    for zone, is_left in [(across, False), (over_the_door, False), (beside, True)]:
        asked = hall.frontiers(start=start, options=PathOptions(zones=[zone]))
        try:
            hall.update(zones=[zone])
            stored = hall.frontiers(start=start)
            ignored = hall.frontiers(start=start, options=PathOptions(ignore_session_zones=True))
        finally:
            hall.update(zones=[])
        assert [f.length_m for f in asked] == [f.length_m for f in stored] == ([free.length_m] if is_left else [])
        assert [f.length_m for f in ignored] == [free.length_m]
        # What is offered can be driven to.
        for frontier in stored:
            assert hall.plan(frontier.goal, start=start, options=PathOptions(zones=[zone]))


def test_a_mask_keeps_frontiers_away_as_well(hall):
    cells = np.full((10, 1), 100, np.int8)
    mask = ZoneMask(name="closed", cells=GridMap(cells=cells, resolution_m=0.5, origin=(6.0, -0.5)))
    try:
        hall.update(zone_masks=[mask])
        assert hall.frontiers(start=(1.0, 1.0)) == []
        assert hall.frontiers(start=(1.0, 1.0), options=PathOptions(ignore_session_zones=True))
    finally:
        hall.update(zone_masks=[])


def test_what_flies_goes_over_what_stands(lidar_session):
    start, goal = (*world.to_map(-1.0, 1.0), 1.0), (*world.to_map(2.5, 1.0), 1.0)
    found = lidar_session.plan_flight(goal, start=start, options=FlightOptions(robot_radius_m=0.2))
    assert isinstance(found, FlightPath), found
    straight = np.linalg.norm(np.subtract(goal, start))
    assert straight - 1e-6 <= found.length_m < 1.6 * straight
    assert np.allclose(found.waypoints[0], start) and np.allclose(found.waypoints[-1], goal)
    assert found.min_clearance_m is None or found.min_clearance_m >= 0.2 - 1e-6
    low = lidar_session.plan_flight(goal, start=start, options=FlightOptions(robot_radius_m=0.2, max_z_m=0.5))
    assert isinstance(low, NoFlight)
    assert low.reason in ("start_in_keep_out", "goal_in_keep_out")
    beneath = (*world.to_map(1.6, 1.0), 0.4)
    inside = lidar_session.plan_flight(beneath, start=start, options=FlightOptions(robot_radius_m=0.2))
    assert isinstance(inside, NoFlight)
    assert inside.reason.startswith("goal_")


def test_what_flies_keeps_out_of_zones_at_any_height(lidar_session):
    start, goal = (*world.to_map(-1.0, 1.0), 1.0), (*world.to_map(2.5, 1.0), 1.0)

    def around(x, y, by):
        return Zone(polygon=[world.to_map(x + a * by, y + b * by) for a, b in [(-1, -1), (1, -1), (1, 1), (-1, 1)]])

    def fly(**options):
        return lidar_session.plan_flight(goal, start=start, options=FlightOptions(robot_radius_m=0.2, **options))

    free, zone = fly(), around(0.75, 1.0, 0.3)
    in_time = fly(deadline_ms=600_000)
    assert in_time.is_final and in_time.bound == 1.0 and in_time.length_m == free.length_m
    round_it = fly(zones=[zone])
    assert isinstance(free, FlightPath) and isinstance(round_it, FlightPath), round_it
    assert round_it.length_m > free.length_m + 0.05
    inside = np.linspace(round_it.waypoints[:-1], round_it.waypoints[1:], 50).reshape(-1, 3)[:, :2]
    assert np.abs(inside - world.to_map(0.75, 1.0)).max(axis=1).min() > 0.3
    # Slow zones are for who drives.
    assert fly(zones=[Zone(polygon=zone.polygon, speed_share=0.1)]).length_m == free.length_m
    try:
        lidar_session.update(zones=[zone])
        assert fly().length_m == round_it.length_m
        assert fly(ignore_session_zones=True).length_m == free.length_m
    finally:
        lidar_session.update(zones=[])
    for at, reason in [((-1.0, 1.0), "start_in_keep_out"), ((2.5, 1.0), "goal_in_keep_out")]:
        none = fly(zones=[around(*at, 0.1)])
        assert isinstance(none, NoFlight)
        assert none.reason == reason
    wall = Zone(polygon=[world.to_map(x, y) for x, y in [(0.6, -9), (0.9, -9), (0.9, 9), (0.6, 9)]])
    none = fly(zones=[wall])
    assert isinstance(none, NoFlight)
    assert none.reason == "unreachable"
    with pytest.raises(InvalidArgument) as error:
        fly(zones=[Zone(polygon=[(0, 0), (1, 0)])])
    assert error.value.field.startswith("options.zones")


def test_questions_that_are_none_are_refused_with_their_field(hall, lidar_session, laser_session):
    nan = float("nan")
    for ask, field in [
        (lambda: hall.plan_coverage(start=(nan, 0.0)), "start"),
        (lambda: hall.plan_coverage(start=(1, 1), coverage=CoverageOptions(tool_width_m=0.0)), "coverage.tool_width_m"),
        (lambda: hall.plan_coverage(start=(1, 1), coverage=CoverageOptions(overlap=1.0)), "coverage.overlap"),
        (lambda: hall.frontiers(start=(1, 1), gain=-1.0), "gain"),
        (lambda: hall.frontiers(start=(1, 1), min_length_m=nan), "min_length_m"),
        (lambda: lidar_session.plan_flight((nan, 0, 0)), "goal"),
        (lambda: lidar_session.plan_flight((1, 0, 1), options=FlightOptions(robot_radius_m=-1.0)), "robot_radius_m"),
    ]:
        with pytest.raises(InvalidArgument) as error:
            ask()
        assert error.value.field.endswith(field), error.value
    with pytest.raises(FailedPrecondition) as error:
        laser_session.plan_flight((1, 0, 1))
    assert error.value.reason == "LAYER_OFF"


def test_what_is_wrong_with_a_question_is_told_also_where_nobody_knows_where_the_robot_is(own_server):
    with Client(own_server.grpc) as client:
        session = client.sessions.create("robot", sensors=[world.LASER])
        for i, pose in enumerate(world.drive(12)):
            session.send_scan("laser", stamp_ns=world.stamp(i), **world.scan(pose))
    assert own_server.stop() == 0
    own_server.start()
    nan = float("nan")
    with Client(own_server.grpc) as client:
        session = client.session("robot")
        assert isinstance(session.plan((0.5, 0.0)), NoPath), "no frame has come since"
        with pytest.raises(InvalidArgument) as error:
            session.plan((nan, 0.0))
        assert error.value.field == "goal"
        with pytest.raises(InvalidArgument) as error:
            session.plan_coverage(options=PathOptions(zones=[Zone(polygon=[(0, 0), (1, 0)])]))
        assert error.value.field.startswith("options.zones")
        with pytest.raises(FailedPrecondition) as off:
            session.plan((0.5, 0.0), options=PathOptions(storey=StoreyOptions(storey="lowest")))
        assert off.value.reason == "LAYER_OFF"
