"""What the newest frames see counts for paths: a robot that stands makes no keyframe of who steps before it and on."""

from __future__ import annotations

import numpy as np
import pytest
from percept import InvalidArgument, NoPath, Path, PathOptions, Pose, SensorSpec

BEAMS = 720
ANGLES = np.linspace(-np.pi, np.pi, BEAMS, endpoint=False)
LASER = SensorSpec(
    "laser",
    kind="lidar2d",
    t_base_sensor=Pose.from_xyz(0.0, 0.0, 0.3),
    overload_policy="block",
)


def scan(*pillars):
    """From the middle of a corridor of 8 x 2 m; pillars are (x, y, radius)."""
    along = np.stack([np.cos(ANGLES), np.sin(ANGLES)], axis=1)
    with np.errstate(divide="ignore"):
        ranges = np.minimum(4.0 / np.abs(along[:, 0]), 1.0 / np.abs(along[:, 1]))
    for x, y, radius in pillars:
        b = along @ np.array([x, y])
        root = b * b - (x * x + y * y - radius * radius)
        ranges = np.where((root > 0) & (b > 0), np.minimum(ranges, b - np.sqrt(np.maximum(root, 0))), ranges)
    step = 2 * np.pi / BEAMS
    return {
        "ranges_m": ranges.astype(np.float32),
        "angle_min_rad": -np.pi,
        "angle_increment_rad": step,
        "range_min_m": 0.05,
        "range_max_m": 20.0,
    }


class Robot:
    """Stands in the middle of the corridor."""

    def __init__(self, client, **params):
        self.session = client.sessions.create(sensors=[LASER], params=params or None)
        self.now_ns = 1_000_000_000

    def sees(self, *pillars, times=1):
        for _ in range(times):
            self.now_ns += 100_000_000
            self.session.send_scan("laser", stamp_ns=self.now_ns, **scan(*pillars))


@pytest.fixture
def robot(client):
    robot = Robot(client)
    robot.sees(times=10)
    return robot


GOAL = (3.2, 0.0)
MAP_ONLY = PathOptions(map_only=True)
#: Beside one of them the robot gets by; past both it does not.
PERSON, OTHER = (1.8, 0.3, 0.3), (1.8, -0.5, 0.3)


def test_a_path_goes_round_who_stands_before_a_robot_that_stands(robot):
    session = robot.session
    straight = session.plan(GOAL)
    assert isinstance(straight, Path)
    robot.sees(PERSON)
    assert session.info().num_keyframes == 1
    around = session.plan(GOAL)
    assert isinstance(around, Path)
    x, y = around.waypoints[:, 0], around.waypoints[:, 1]
    assert np.min(np.hypot(x - PERSON[0], y - PERSON[1])) > 0.45
    on_map = session.plan(GOAL, options=MAP_ONLY)
    assert on_map.length_m == pytest.approx(straight.length_m, abs=0.02)
    # What was planned before is not to be driven, and is on the map.
    misfit = session.validate_path(straight)
    assert misfit is not None
    assert misfit.reason == "blocked"
    assert session.validate_path(straight, options=MAP_ONLY) is None
    robot.sees(PERSON, OTHER)
    none = session.plan(GOAL)
    assert isinstance(none, NoPath)
    assert none.reason == "unreachable"
    robot.sees()
    assert session.plan(GOAL).length_m == pytest.approx(straight.length_m, abs=0.02)


def test_the_grid_of_now_is_told_beside_that_of_the_map(robot):
    robot.sees(PERSON, times=5)
    plain, live = robot.session.map.occupancy(), robot.session.map.occupancy(live=True)

    def at(grid, x, y):
        column, row = (int(np.floor((v - o) / grid.resolution_m)) for v, o in zip((x, y), grid.origin, strict=True))
        return grid.cells[row, column]

    # The person's near side.
    assert at(plain, 1.53, 0.25) < 50
    assert at(live, 1.53, 0.25) > 50
    assert at(live, 0.8, -0.6) < 50


def test_a_watched_path_is_told_anew_though_no_keyframe_was_made(robot):
    with robot.session.watch_path(GOAL) as watch:
        first = next(watch)
        assert (first.change, bool(first.outcome)) == ("first", True)
        robot.sees(PERSON, times=10)
        told = next(watch)
        assert (told.change, told.misfit.reason) == ("blocked", "blocked")
        assert told.stamp.map_version == first.stamp.map_version
        assert isinstance(told.outcome, Path)
        robot.sees(PERSON, OTHER, times=10)
        told = next(watch)
        assert (told.change, bool(told.outcome)) == ("blocked", False)
        robot.sees(times=20)
        assert next(watch).change == "opened"


def test_it_can_be_switched_off_and_what_is_out_of_bounds_is_refused(client, robot):
    session = robot.session
    session.update(params={"live": {"time_s": 0.0}})
    robot.sees(PERSON, OTHER, times=3)
    assert isinstance(session.plan(GOAL), Path)
    session.update(params={"live": {"time_s": 2.0}})
    robot.sees(PERSON, OTHER, times=3)
    assert isinstance(session.plan(GOAL), NoPath)
    with pytest.raises(InvalidArgument) as error:
        session.update(params={"live": {"range_m": 0.1}})
    assert "live" in error.value.field
