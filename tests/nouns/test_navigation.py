from __future__ import annotations

import numpy as np
import pytest
from percept import InvalidArgument, NoPath, NotFound, Path, ScanFrame

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
    assert np.linalg.norm(path.waypoints[0, :2] - start[:2]) < 0.1
    assert np.linalg.norm(path.waypoints[-1, :2] - goal) < 0.1
    steps = np.linalg.norm(np.diff(path.waypoints[:, :2], axis=0), axis=1)
    assert path.length_m == pytest.approx(steps.sum(), rel=1e-3)
    assert path.cost >= path.length_m - 1e-6
    offset = world.drive(1)[0].translation[:2]
    along = [
        clear_of_furniture_m(*(a + f * (b - a) + offset))
        for a, b in zip(path.waypoints[:-1, :2], path.waypoints[1:, :2], strict=True)
        for f in np.linspace(0, 1, 20)
    ]
    assert min(along) > 0.1
    # Within the diagonal of a cell of what the grid can know.
    resolution = laser_session.map.summary().occupancy.resolution_m
    assert path.min_clearance_m == pytest.approx(min(along), abs=2 * resolution)


def test_headings_look_at_the_next_waypoint(laser_session):
    path = laser_session.plan(world.to_map(2.4, 0.0), start=world.to_map(-2.0, 1.0))
    steps = np.diff(path.waypoints[:, :2], axis=0)
    wanted = np.arctan2(steps[:, 1], steps[:, 0])
    turn = np.angle(np.exp(1j * (path.waypoints[:-1, 2] - wanted)))
    assert np.abs(turn).max() < 1e-6


@pytest.mark.parametrize(
    ("goal", "start", "reasons"),
    [
        ((2.95, 0.0), None, {"goal_occupied"}),
        ((50.0, 0.0), None, {"goal_outside_map"}),
        ((1.6, 1.0), None, {"goal_unknown", "goal_occupied"}),
        ((1.0, 0.0), (2.95, 0.0), {"start_occupied"}),
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
    assert np.linalg.norm(answer.outcome.waypoints[-1, :2] - goal) < 0.1
    assert answer.stamp.map_version == answer.pose.map_version
    assert len(session.trajectory()) == 3
    again = session.navigate(frame, goal=goal)
    assert again.frame.duplicate
    assert len(session.trajectory()) == 3
