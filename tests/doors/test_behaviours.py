"""One suite of behaviours, run through all three doors."""

from __future__ import annotations

import numpy as np
import pytest
from percept import DepthFrame, NotFound, ScanFrame
from percept._convert import sensors

from support import world
from support.doors import DOORS
from support.server import eventually

pytestmark = pytest.mark.parametrize("door", DOORS, indirect=True)


def depth_message(session, index, pose):
    frame = DepthFrame("camera", stamp_ns=world.stamp(index), depth=world.depth_image(pose), metres_per_unit=0.001)
    return sensors.frame_to(session.session_id, frame, index + 1)


def scan_message(session, index, pose):
    frame = ScanFrame("laser", stamp_ns=world.stamp(index), **world.scan(pose))
    return sensors.frame_to(session.session_id, frame, index + 1)


def test_depth_frames_move_the_pose_as_the_robot_moved(door, client):
    session = client.sessions.create(sensors=[world.CAMERA])
    poses = world.drive(8)
    assert door.pose(session.session_id) is None
    for i, pose in enumerate(poses):
        assert door.send(depth_message(session, i, pose)).accepted
    newest = eventually(lambda: (p := door.pose(session.session_id)) and p.stamp_ns == world.stamp(7) and p)
    assert newest, "no pose of the last frame"
    assert newest.state == "tracking"
    truth = world.truth_in_map(poses)[-1]
    # Depth is rounded to a millimetre; a few of those for a short local model.
    assert world.position_error_m(newest.t_map_base, truth) < 0.02
    assert newest.covariance.shape == (6, 6)
    assert (np.diag(newest.covariance) >= 0).all()


def test_scans_become_a_map_with_walls_where_they_are(door, client):
    session = client.sessions.create(sensors=[world.LASER])
    for i, pose in enumerate(world.drive(5)):
        assert door.send(scan_message(session, i, pose)).accepted
    eventually(lambda: (p := door.pose(session.session_id)) and p.stamp_ns == world.stamp(4))
    grid = door.grid(session.session_id)
    assert grid.stamp.frame_id == "map"
    near_wall = [grid.cell_at(*world.to_map(-3.0 + d, 0.0)) for d in (-0.1, -0.05, 0.0, 0.05, 0.1)]
    assert max(c for c in near_wall if c is not None) > 50, "the wall behind the robot"
    assert 0 <= grid.cell_at(*world.to_map(-0.4, 0.0)) < 50, "the floor before the robot"
    assert grid.cell_at(*world.to_map(-3.6, 0.0)) in (-1, None), "beyond the wall"


def test_a_map_of_nothing_is_empty(door, client):
    session = client.sessions.create(sensors=[world.LASER])
    assert door.grid(session.session_id).cells.size == 0


def test_a_refused_frame_leaves_the_session_unharmed(door, client):
    session = client.sessions.create(sensors=[world.CAMERA])
    poses = world.drive(3)
    for i in (0, 1):
        assert door.send(depth_message(session, i, poses[i])).accepted
    eventually(lambda: (p := door.pose(session.session_id)) and p.stamp_ns == world.stamp(1))
    before = door.pose(session.session_id)
    late = depth_message(session, 1, poses[2])
    late.stamp_ns -= 1
    refused = door.send(late)
    assert not refused.accepted
    if door.tells_why:
        assert (refused.reason, refused.code) == ("STAMP_NOT_INCREASING", "INVALID_ARGUMENT")
    assert door.pose(session.session_id) == before
    assert len(session.trajectory()) == 2
    assert door.send(depth_message(session, 2, poses[2])).accepted
    status = session.sensors.list()[0]
    assert (status.accepted, status.rejected) == (3, 1)
    assert "1" in status.verdict_message


def test_an_unknown_session_is_not_found(door, name):
    with pytest.raises((NotFound, AssertionError)) as error:
        door.pose(name)
    assert "SESSION_NOT_FOUND" in str(error.value)
