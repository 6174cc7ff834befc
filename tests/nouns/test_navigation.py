from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from percept import (
    Client,
    GridMap,
    InvalidArgument,
    NoPath,
    NotFound,
    Path,
    PathOptions,
    Pose,
    ScanFrame,
    SpeedLimits,
    Steering,
    Zone,
)

from support import world


def clear_of_furniture_m(x, y):
    """Distance in the plane to the nearest true obstacle."""
    p = np.array([x, y])
    walls = np.minimum(p - world.ROOM[0][:2], world.ROOM[1][:2] - p).min()
    boxes = [np.linalg.norm(np.maximum(np.maximum(low[:2] - p, p - high[:2]), 0)) for low, high in world.FURNITURE]
    return min(walls, *boxes)


def test_a_path_leads_from_the_robot_to_the_goal_past_the_furniture(laser_session):
    goal = world.to_map(2.4, 0.0)
    path = laser_session.plan(goal)
    assert isinstance(path, Path), path
    assert path
    start = laser_session.pose().t_map_base.translation
    assert np.linalg.norm(path.waypoints[0] - start[:2]) < 0.1
    assert np.linalg.norm(path.waypoints[-1] - goal) < 0.1
    steps = np.linalg.norm(np.diff(path.waypoints, axis=0), axis=1)
    assert path.length_m == pytest.approx(steps.sum(), rel=1e-3)
    assert path.cost >= path.length_m - 1e-6
    offset = world.drive(1)[0].translation[:2]
    along = [
        clear_of_furniture_m(*(a + f * (b - a) + offset))
        for a, b in zip(path.waypoints[:-1], path.waypoints[1:], strict=True)
        for f in np.linspace(0, 1, 20)
    ]
    assert min(along) > 0.1
    # Within the diagonal of a cell of what the grid can know.
    resolution = laser_session.map.summary().occupancy.resolution_m
    assert path.min_clearance_m == pytest.approx(min(along), abs=2 * resolution)


def test_a_path_to_a_thing_ends_beside_it_and_looks_at_it(lidar_session):
    things = list(lidar_session.scene.objects())
    assert things
    offset = world.drive(1)[0].translation[:2]
    for thing in things:
        path = lidar_session.plan_to(thing, gap_m=0.4, options=PathOptions(planner="hybrid"))
        assert path, (thing, path)
        end = path.poses[-1]
        gap = np.abs(thing.box.t_frame_box.inverse().apply(end.translation))[:2] - thing.box.size_m[:2] / 2
        assert 0.39 < gap.max() < 0.81
        ahead = end.inverse().apply(np.array([*thing.box.centre[:2], 0.0]))
        assert abs(np.arctan2(ahead[1], ahead[0])) < 0.1
        assert clear_of_furniture_m(*(end.translation[:2] + offset)) > 0.1
    again = lidar_session.plan_to(things[0].object_id, gap_m=0.4)
    first = lidar_session.plan_to(things[0], gap_m=0.4)
    assert np.array_equal(again.waypoints, first.waypoints)
    with pytest.raises(NotFound):
        lidar_session.plan_to(10**6)


def test_what_cannot_be_reached_says_why_not(laser_session, lidar_session):
    thing = next(lidar_session.scene.objects())
    walled = [(-9, -9), (9, -9), (9, 9), (-9, 9)]
    none = lidar_session.plan_to(thing, options=PathOptions(zones=[Zone(polygon=walled)]))
    assert none.reason == "start_in_keep_out"
    far = dataclasses.replace(thing, box=dataclasses.replace(thing.box, t_frame_box=Pose.from_xyz(50, 0, 0)))
    assert laser_session.plan_to(far).reason == "goal_outside_map"


def test_headings_look_at_the_next_waypoint(laser_session):
    path = laser_session.plan(world.to_map(2.4, 0.0), start=world.to_map(-2.0, 1.0))
    steps = np.diff(path.waypoints, axis=0)
    wanted = np.arctan2(steps[:, 1], steps[:, 0])
    turn = np.angle(np.exp(1j * (path.yaws_rad[:-1] - wanted)))
    assert np.abs(turn).max() < 1e-6


@pytest.mark.parametrize(
    ("goal", "start", "reasons"),
    [
        ((2.95, 0.0), None, {"goal_occupied", "goal_does_not_fit"}),
        ((50.0, 0.0), None, {"goal_outside_map"}),
        ((1.6, 1.0), None, {"goal_unknown", "goal_occupied"}),
        ((1.0, 0.0), (2.95, 0.0), {"start_occupied", "start_does_not_fit"}),
        ((1.0, 0.0), (-50.0, 0.0), {"start_outside_map"}),
    ],
)
def test_no_path_is_an_answer_with_its_reason(laser_session, goal, start, reasons):
    answer = laser_session.plan(world.to_map(*goal), start=start and world.to_map(*start))
    assert isinstance(answer, NoPath)
    assert not answer
    assert answer.reason in reasons
    assert answer.detail


def test_a_robot_that_does_not_know_where_it_is_needs_a_start(client):
    session = client.sessions.create(sensors=[world.LASER])
    assert session.plan((1.0, 0.0)).reason == "lost"


def test_where_the_robot_was_before_a_restart_is_no_start(own_server):
    """Somebody may have moved it meanwhile. Its first frame is one: the map begins there."""
    poses = world.drive(12)
    with Client(own_server.grpc) as client:
        session = client.sessions.create("kept", sensors=[world.LASER])
        session.send_scan("laser", stamp_ns=world.stamp(0), **world.scan(poses[0]))
        assert session.plan((0.3, 0.0))
        for i, pose in enumerate(poses[1:], start=1):
            session.send_scan("laser", stamp_ns=world.stamp(i), **world.scan(pose))
        goal = world.to_map(*poses[4].translation[:2])
        assert session.plan(goal)
    own_server.stop()
    own_server.start()
    with Client(own_server.grpc) as client:
        session = client.sessions.get("kept")
        answer = session.plan(goal)
        assert (answer.reason, session.plan(goal, start=goal).length_m) == ("lost", 0.0)
        assert "let it send frames" in answer.detail
        for i in range(12, 15):
            session.send_scan("laser", stamp_ns=world.stamp(i), **world.scan(poses[-1]))
        assert session.plan(goal)


CAR = [(0.45, 0.2), (-0.25, 0.2), (-0.25, -0.2), (0.45, -0.2)]


def corridor(gap_m=1.0):
    """Two rooms of 4 m x 4 m, and a door of some width between them; cells of 0.05 m."""
    cells = np.zeros((80, 160), np.int8)
    cells[[0, -1], :] = cells[:, [0, -1]] = 100
    cells[:, 80] = 100
    half = round(gap_m / 0.05 / 2)
    cells[40 - half : 40 + half, 80] = 0
    return GridMap(cells=cells, resolution_m=0.05, origin=(-1.0, 2.0))


def covered(pose, corners):
    """Points all over a footprint at a pose."""
    (x, y, _), yaw = pose.translation, pose.yaw_rad
    low, high = np.min(corners, axis=0), np.max(corners, axis=0)
    px, py = np.meshgrid(np.arange(low[0], high[0] + 1e-9, 0.02), np.arange(low[1], high[1] + 1e-9, 0.02))
    return np.stack([x + px * np.cos(yaw) - py * np.sin(yaw), y + px * np.sin(yaw) + py * np.cos(yaw)], -1)


def test_a_car_steers_through_a_door_and_covers_nothing(client):
    grid = corridor()
    steering = Steering(turning_radius_m=0.7)
    options = PathOptions(planner="hybrid", start_yaw_rad=0.0, goal_yaw_rad=np.pi, footprint=CAR, steering=steering)
    path = client.toolbox.plan_on_map(grid, (0.5, 3.0), (5.5, 4.5), options=options)
    assert isinstance(path, Path), path
    assert np.allclose([*path.waypoints[0], path.yaws_rad[0]], [0.5, 3.0, 0.0], atol=1e-6)
    assert np.allclose(path.waypoints[-1], [5.5, 4.5])
    assert abs(np.angle(np.exp(1j * (path.yaws_rad[-1] - np.pi)))) < 0.05
    for pose in path.poses:
        cell = np.floor((covered(pose, CAR) - np.array(grid.origin)) / 0.05).astype(int)
        assert not grid.cells[cell[..., 1], cell[..., 0]].any()
    turns = np.angle(np.exp(1j * np.diff(path.yaws_rad)))
    steps = np.linalg.norm(np.diff(path.waypoints, axis=0), axis=1)
    assert (np.abs(turns) <= steps / 0.7 * 1.1 + 1e-3).all()
    assert path.is_final
    assert client.toolbox.validate_on_map(grid, path, options=options) is None
    narrow = client.toolbox.plan_on_map(corridor(0.3), (0.5, 3.0), (5.5, 4.5), options=options)
    assert narrow.reason in ("unreachable", "not_steerable")
    assert narrow.reason != "unreachable" or abs(narrow.blocking.obstacle[0] - 3.0) < 0.2


def test_zones_are_kept_out_of_or_slow_the_robot(client):
    grid = corridor()
    ends = (0.0, 4.0), (6.0, 4.0)
    free = client.toolbox.plan_on_map(grid, *ends)
    slow = Zone(polygon=[(1, 2), (5, 2), (5, 6), (1, 6)], speed_share=0.25)
    slowed = client.toolbox.plan_on_map(grid, *ends, options=PathOptions(zones=[slow]))
    assert slowed.duration_s > 2 * free.duration_s > 2 * free.length_m / 0.5
    fast = PathOptions(speed=SpeedLimits(max_speed_mps=2.0))
    assert client.toolbox.plan_on_map(grid, *ends, options=fast).duration_s < 0.6 * free.duration_s
    assert np.all(np.diff(free.times_s) > 0)
    assert free.times_s[-1] == free.duration_s
    shut = Zone(polygon=[(2.9, 3), (3.1, 3), (3.1, 5), (2.9, 5)])
    closed = client.toolbox.plan_on_map(grid, *ends, options=PathOptions(zones=[shut]))
    # Through the thin wall is less of a way than through the zone.
    assert closed.reason == "unreachable"
    assert abs(closed.blocking.obstacle[0] - 3.0) < 0.2
    inside = client.toolbox.plan_on_map(grid, ends[0], (3.0, 4.0), options=PathOptions(zones=[shut]))
    assert inside.reason == "goal_in_keep_out"
    misfit = client.toolbox.validate_on_map(grid, free, options=PathOptions(zones=[shut]))
    assert (misfit.reason, misfit.blocking.state) == ("blocked", "keep_out")
    assert abs(misfit.pose.translation[0] - 2.9) < 0.5


def test_a_nav2_map_is_planned_in_from_its_files(client, laser_session, tmp_path):
    laser_session.map.export("nav2_yaml", path=tmp_path / "map.yaml")
    laser_session.map.export("nav2_pgm", path=tmp_path / "map.pgm")
    goal, start = world.to_map(2.4, 0.0), world.to_map(-2.0, 1.0)
    ours = laser_session.plan(goal, start=start)
    theirs = client.toolbox.plan_on_map(tmp_path / "map.yaml", start, goal)
    assert theirs, theirs
    assert theirs.length_m == pytest.approx(ours.length_m, rel=0.03)
    assert theirs.stamp is None
    assert client.toolbox.validate_on_map(tmp_path / "map.yaml", theirs) is None
    (tmp_path / "map.pgm").write_bytes(b"P5\n9999999 9999999\n255\n")
    with pytest.raises(InvalidArgument) as refused:
        client.toolbox.plan_on_map(tmp_path / "map.yaml", start, goal)
    assert (refused.value.reason, refused.value.field) == ("FILE_INVALID", "map.nav2.image")


def test_a_path_is_checked_against_the_map_as_it_is_now(laser_session):
    path = laser_session.plan(world.to_map(2.4, 0.0), options=PathOptions(planner="any_angle"))
    assert laser_session.validate_path(path) is None
    through = [Pose.from_xy_yaw(*world.to_map(x, 1.0), 0.0) for x in (0.0, 1.6)]
    misfit = laser_session.validate_path(through)
    assert (misfit.pose_index, misfit.reason) == (0, "blocked")
    assert abs(misfit.pose.translation[0] - world.to_map(1.2, 1.0)[0]) < 0.4
    outside = laser_session.validate_path([Pose.from_xy_yaw(90.0, 0, 0)])
    assert (outside.pose_index, outside.reason, outside.blocking) == (0, "outside_map", None)
    assert laser_session.validate_path([]) is None


def test_a_watched_path_is_told_again_when_the_map_breaks_it(client):
    session = client.sessions.create(sensors=[world.LASER])
    poses = world.drive(40)
    for i, pose in enumerate(poses[:2]):
        session.send_scan("laser", stamp_ns=world.stamp(i), **world.scan(pose))
    goal = world.to_map(1.0, 0.0)
    with session.watch_path(goal) as watch:
        first = next(watch)
        assert (first.change, bool(first.outcome), first.misfit) == ("first", True, None)
        # A board of 1.2 m stands across the way now; where there was free space it has to be seen more than once.
        for i, pose in enumerate([*poses[2:], *poses[::-1], *poses, *poses[::-1]], 2):
            scan = world.scan(pose)
            (x, y), yaw = pose.translation[:2], np.arctan2(pose.matrix[1, 0], pose.matrix[0, 0])
            way = yaw + scan["angle_min_rad"] + np.arange(len(scan["ranges_m"])) * scan["angle_increment_rad"]
            with np.errstate(divide="ignore", invalid="ignore"):
                board = (0.4 - x) / np.cos(way)
                hits = (board > 0) & (np.abs(y + board * np.sin(way)) < 0.6)
            scan["ranges_m"] = np.where(hits, np.fmin(scan["ranges_m"], board), scan["ranges_m"]).astype(np.float32)
            session.send_scan("laser", stamp_ns=world.stamp(i), **scan)
        told = next(watch)
        assert told.change == "blocked"
        assert told.misfit.reason == "blocked"
        assert told.stamp.map_version >= first.stamp.map_version
        assert not told.outcome or session.validate_path(told.outcome) is None
    with pytest.raises(InvalidArgument), session.watch_path((float("nan"), 0.0)) as watch:
        next(watch)
    with pytest.raises(NotFound), client.session("nobody").watch_path((0.0, 0.0)) as watch:
        next(watch)


def test_a_watched_path_is_told_of_zones_while_no_frame_comes(client):
    """A robot that stands still, and a person who draws."""
    session = client.sessions.create(sensors=[world.LASER])
    for i, pose in enumerate(world.drive(40)):
        session.send_scan("laser", stamp_ns=world.stamp(i), **world.scan(pose))
    at = np.array(session.pose().t_map_base.translation[:2])
    goal = np.add(at, (1.5, 0.0))
    with session.watch_path(tuple(goal)) as watch:
        assert next(watch).change == "first"
        for center, half in [(goal, 0.2), (at, 0.4)]:
            square = [tuple(center + half * np.array(c)) for c in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
            session.update(zones=[Zone(polygon=square)])
            told = next(watch)
            assert (told.change, bool(told.outcome)) in [("blocked", False), ("other_reason", False)]
            assert told.outcome.reason == session.plan(tuple(goal)).reason
            session.update(zones=[])
            assert next(watch).change == "opened"


def test_what_is_no_question_is_refused_with_its_field(client, laser_session):
    grid, ends = corridor(), ((0.0, 4.0), (6.0, 4.0))

    def refused(given=grid, **options):
        with pytest.raises(InvalidArgument) as error:
            client.toolbox.plan_on_map(given, *ends, options=PathOptions(**options))
        return error.value.reason, error.value.field

    bow_tie = [(0.3, 0.3), (-0.3, -0.3), (0.3, -0.3), (-0.3, 0.3)]
    assert refused(footprint=bow_tie, planner="hybrid") == ("PARAMETER_OUT_OF_RANGE", "options.footprint")
    assert refused(footprint=[(0, 0), (1, 1)], planner="hybrid") == ("PARAMETER_OUT_OF_RANGE", "options.footprint")
    assert refused(footprint=[(float("nan"), 0)] * 3)[1] == "options.footprint"
    assert refused(zones=[Zone(polygon=[(0, 0), (1, 1)])])[1] == "options.zones.polygon"
    assert refused(zones=[Zone(polygon=[(0, 0), (1, 1), (1, 0)], speed_share=0.0)])[1] == "options.zones.speed_share"
    assert refused(speed=SpeedLimits(max_speed_mps=-1))[1] == "options.speed.max_speed_mps"
    hybrid = {"planner": "hybrid", "steering": Steering(turning_radius_m=0.0)}
    assert refused(**hybrid)[1] == "options.steering.turning_radius_m"
    assert refused(planner="hybrid", goal_yaw_rad=float("nan"))[1] == "goal.yaw_rad"
    wrong = GridMap(cells=np.full((4, 4), 101, np.int8), resolution_m=0.05)
    assert refused(wrong) == ("OUT_OF_RANGE", "map.grid.cells")
    assert refused(GridMap(cells=grid.cells, resolution_m=0.0))[1] == "map.grid.geometry.resolution_m"
    with pytest.raises(InvalidArgument) as error:
        laser_session.validate_path([Pose.from_xy_yaw(0, 0, float("inf"))])
    assert error.value.field == "poses[0]"


def test_goals_that_are_no_numbers_are_refused(laser_session):
    with pytest.raises(InvalidArgument) as error:
        laser_session.plan((float("nan"), 0.0))
    assert (error.value.reason, error.value.field) == ("OUT_OF_RANGE", "goal")


def test_unknown_sessions_are_not_found(client):
    with pytest.raises(NotFound):
        client.session("nobody").plan((0.0, 0.0))


def test_navigate_is_one_call_for_one_step(client):
    session = client.sessions.create(sensors=[world.LASER])
    poses = world.drive(3)
    goal = world.to_map(1.5, 0.0)
    for i, pose in enumerate(poses):
        frame = ScanFrame("laser", stamp_ns=world.stamp(i), **world.scan(pose))
        answer = session.navigate(frame, goal=goal)
    assert answer.pose.stamp_ns == world.stamp(2)
    assert answer.frame.pose == answer.pose
    assert isinstance(answer.outcome, Path), answer.outcome
    assert np.linalg.norm(answer.outcome.waypoints[-1] - goal) < 0.1
    assert answer.stamp.map_version == answer.pose.map_version
    assert len(session.trajectory()) == 3
    again = session.navigate(frame, goal=goal)
    assert again.frame.duplicate
    assert len(session.trajectory()) == 3


@pytest.fixture(scope="module")
def maze():
    """A map of 1000 x 1000 cells that is crossed by many walls with gaps at alternating ends."""
    cells = np.zeros((1000, 1000), np.int8)
    for i, x in enumerate(range(40, 1000, 40)):
        cells[(0 if i % 2 else 60) : (940 if i % 2 else 1000), x : x + 3] = 100
    return GridMap(cells=cells, resolution_m=0.05, origin=(0.0, 0.0))


def test_a_deadline_that_is_far_off_changes_no_more_than_what_is_told(client, maze):
    once = client.toolbox.plan_on_map(maze, (1.0, 25.0), (47.0, 25.0))
    in_time = client.toolbox.plan_on_map(maze, (1.0, 25.0), (47.0, 25.0), options=PathOptions(deadline_ms=600_000))
    assert (once.bound, once.is_final) == (None, True)
    assert (in_time.bound, in_time.is_final) == (1.0, True)
    # Of ways that cost the same over cells either may be taken, and smoothed.
    assert in_time.cost == pytest.approx(once.cost, rel=0.02)


@pytest.mark.parametrize("deadline_ms", [1, 20, 50, 100, 200, 400])
def test_whatever_is_known_at_the_deadline_is_told_with_a_bound_that_holds(client, maze, deadline_ms):
    least = client.toolbox.plan_on_map(maze, (1.0, 25.0), (47.0, 25.0))
    options = PathOptions(deadline_ms=deadline_ms)
    found = client.toolbox.plan_on_map(maze, (1.0, 25.0), (47.0, 25.0), options=options)
    if isinstance(found, NoPath):
        assert found.reason == "deadline"
        return
    assert found.is_final == (found.bound == 1.0)
    assert found.bound >= 1.0
    assert found.cost <= least.cost * found.bound * 1.02
    assert client.toolbox.validate_on_map(maze, found) is None
