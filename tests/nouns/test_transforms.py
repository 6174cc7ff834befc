"""Where the robot was, where frames are, and parts of the trajectory."""

from __future__ import annotations

import httpx
import numpy as np
import pytest
from percept import Client, FailedPrecondition, InvalidArgument, NotFound, Pose

from support import world

FRAMES = ["map", "odom", "base", "laser"]


def between(a: np.ndarray, b: np.ndarray, share: float) -> np.ndarray:
    """On the shortest screw from one planar pose to another: the power of what takes one to the other, by its
    eigenvalues, which is another way than the server's."""
    step = np.linalg.inv(a) @ b
    values, vectors = np.linalg.eig(step[np.ix_([0, 1, 3], [0, 1, 3])])
    part = np.real(vectors @ np.diag(values.astype(complex) ** share) @ np.linalg.inv(vectors))
    out = np.eye(4)
    out[np.ix_([0, 1, 3], [0, 1, 3])] = part
    return a @ out


def planar(matrix: np.ndarray) -> np.ndarray:
    """x, y and heading."""
    return np.array([matrix[0, 3], matrix[1, 3], np.arctan2(matrix[1, 0], matrix[0, 0])])


def test_a_pose_between_two_frames_lies_between_theirs(laser_session):
    trajectory = laser_session.trajectory()
    for i, share in ((0, 0.5), (7, 0.25), (20, 0.9)):
        at_ns = world.stamp(i) + round(share * world.FRAME_NS)
        found = laser_session.pose_at(at_ns)
        assert (found.stamp_ns, found.before_ns, found.after_ns) == (
            at_ns,
            world.stamp(i),
            world.stamp(i + 1),
        )
        expected = between(trajectory.t_map_base[i], trajectory.t_map_base[i + 1], share)
        assert planar(found.t_map_base.matrix) == pytest.approx(planar(expected), abs=1e-6)
        assert found.scale == "metric"
        truth = world.truth_in_map(world.drive(30))
        # Scans are exact; what is left is the discretisation of the local map.
        assert world.position_error_m(found.t_map_base, between(truth[i], truth[i + 1], share)) < 0.03


def test_a_pose_at_a_frame_is_that_frames(laser_session):
    trajectory = laser_session.trajectory()
    for i in (0, 11, 29):
        found = laser_session.pose_at(world.stamp(i))
        assert found.before_ns == found.after_ns == world.stamp(i)
        assert np.allclose(found.t_map_base.matrix, trajectory.t_map_base[i], atol=1e-9)


@pytest.mark.parametrize(
    ("at_ns", "kind", "reason"),
    [
        (world.stamp(0) - 1, InvalidArgument, "STAMP_BEFORE_TRAJECTORY"),
        (world.stamp(29) + 1, FailedPrecondition, "STAMP_AFTER_TRAJECTORY"),
        (-(2**63), InvalidArgument, "STAMP_BEFORE_TRAJECTORY"),
        (2**63 - 1, FailedPrecondition, "STAMP_AFTER_TRAJECTORY"),
    ],
)
def test_outside_of_the_trajectory_the_range_is_told_and_nothing_made_up(laser_session, at_ns, kind, reason):
    for ask in (
        lambda: laser_session.pose_at(at_ns),
        lambda: laser_session.transform("map", "laser", at_ns=at_ns),
    ):
        with pytest.raises(kind) as error:
            ask()
        assert (error.value.reason, error.value.field) == (reason, "at_ns")
        assert str(world.stamp(0)) in error.value.message
        assert str(world.stamp(29)) in error.value.message


def test_before_the_first_frame_there_is_no_pose_but_the_sensors_mounts(client):
    session = client.sessions.create(sensors=[world.LASER])
    with pytest.raises(FailedPrecondition) as error:
        session.pose_at(1)
    assert error.value.reason == "TRAJECTORY_EMPTY"
    with pytest.raises(FailedPrecondition):
        session.transform("map", "base")
    mount = session.transform("base", "laser")
    assert mount.t_target_source == world.LASER.t_base_sensor
    assert (mount.stamp_ns, mount.state) == (None, "unspecified")
    assert session.transform("base", "laser", at_ns=7) == mount


def test_transforms_chain_as_a_tree_of_frames_does(laser_session):
    for at_ns in (None, world.stamp(12) + 1234):

        def find(target, source, at_ns=at_ns):
            return laser_session.transform(target, source, at_ns=at_ns).t_target_source.matrix

        for a in FRAMES:
            for b in FRAMES:
                assert np.allclose(find(a, b) @ find(b, a), np.eye(4), atol=1e-9)
                assert np.allclose(find("map", a) @ find(a, b), find("map", b), atol=1e-9)


def test_the_newest_transform_is_the_newest_pose(laser_session):
    pose = laser_session.pose()
    for frame, expected in (("map", pose.t_map_base), ("odom", pose.t_odom_base)):
        found = laser_session.transform(frame, "base")
        assert np.allclose(found.t_target_source.matrix, expected.matrix, atol=1e-9)
        assert (found.stamp_ns, found.map_version) == (pose.stamp_ns, pose.map_version)
    mounted = pose.t_map_base.matrix @ world.LASER.t_base_sensor.matrix
    assert np.allclose(laser_session.transform("map", "laser").t_target_source.matrix, mounted, atol=1e-9)


def test_a_transform_at_a_time_is_what_the_pose_was_then(laser_session):
    at_ns = world.stamp(3) + world.FRAME_NS // 2
    found, pose = laser_session.transform("map", "base", at_ns=at_ns), laser_session.pose_at(at_ns)
    assert np.allclose(found.t_target_source.matrix, pose.t_map_base.matrix, atol=1e-12)
    odom = laser_session.transform("odom", "base", at_ns=at_ns)
    assert np.allclose(odom.t_target_source.matrix, pose.t_odom_base.matrix, atol=1e-12)


def test_odom_at_a_frame_is_what_was_answered_then_also_after_a_restart(own_server, name):
    poses = world.drive(12)
    with Client(own_server.grpc) as client:
        session = client.sessions.create(name, sensors=[world.LASER])
        said = [
            session.send_scan("laser", stamp_ns=world.stamp(i), **world.scan(pose)).pose.t_odom_base.matrix
            for i, pose in enumerate(poses)
        ]
    for _ in range(2):
        with Client(own_server.grpc) as client:
            for i, expected in enumerate(said):
                found = client.session(name).transform("odom", "base", at_ns=world.stamp(i))
                assert np.allclose(found.t_target_source.matrix, expected, atol=1e-6), i
        own_server.kill()
        own_server.start()


@pytest.mark.parametrize(
    ("target", "source", "field"),
    [
        ("map", "nobody", "source_frame"),
        ("base_link", "map", "target_frame"),
        ("", "map", "target_frame"),
        ("map", "sensors/nobody", "source_frame"),
        ("map", "x" * 5000, "source_frame"),
    ],
)
def test_unknown_frames_are_refused_with_those_that_there_are(laser_session, target, source, field):
    with pytest.raises(NotFound) as error:
        laser_session.transform(target, source)
    assert (error.value.reason, error.value.field) == ("FRAME_NOT_FOUND", field)
    assert "map, odom, base, laser" in error.value.message


def test_a_sensor_that_has_the_name_of_a_frame_is_told_apart(client):
    session = client.sessions.create()
    session.sensors.declare("odom", kind="odometry", t_base_sensor=Pose.from_xy_yaw(0.5, 0.0, 0.0))
    assert session.transform("base", "sensors/odom").t_target_source.translation[0] == 0.5
    with pytest.raises(FailedPrecondition):
        session.transform("base", "odom")


def test_a_camera_without_scale_says_so_and_has_no_odom_in_the_past(client):
    session = client.sessions.create(sensors=[world.EYE])
    poses = [Pose.from_xy_yaw(-0.8, 0.05 * i, 0.0) for i in range(12)]
    for i, pose in enumerate(poses):
        session.send_colour("eye", stamp_ns=world.stamp(i), colour=world.colour_image(pose))
    trajectory = session.trajectory()
    assert len(trajectory) > 1
    assert session.pose_at(int(trajectory.stamps_ns[-1])).scale == "unknown"
    assert session.transform("map", "base").scale == "unknown"
    with pytest.raises(FailedPrecondition) as error:
        session.transform("odom", "base", at_ns=int(trajectory.stamps_ns[0]))
    assert error.value.reason == "ODOM_NOT_KNOWN"


def test_a_part_of_the_trajectory_includes_both_its_ends(laser_session):
    whole = laser_session.trajectory()
    part = laser_session.trajectory(from_ns=world.stamp(5), to_ns=world.stamp(9))
    assert part.stamps_ns.tolist() == [world.stamp(i) for i in range(5, 10)]
    assert np.array_equal(part.positions, whole.positions[5:10])
    assert len(laser_session.trajectory(from_ns=world.stamp(5) + 1, to_ns=world.stamp(6) - 1)) == 0
    assert len(laser_session.trajectory(to_ns=world.stamp(2))) == 3
    assert len(laser_session.trajectory(from_ns=world.stamp(28))) == 2


def test_pages_of_a_trajectory_join_to_the_whole(laser_session):
    whole, stamps, token = laser_session.trajectory(), [], ""
    while True:
        page = laser_session.trajectory(page_size=7, page_token=token)
        assert len(page) <= 7
        stamps += page.stamps_ns.tolist()
        token = page.next_page_token
        if not token:
            break
    assert stamps == whole.stamps_ns.tolist()
    assert whole.next_page_token == ""


def test_a_thinned_trajectory_keeps_its_ends(laser_session):
    thin = laser_session.trajectory(max_poses=5)
    assert thin.stamps_ns.tolist() == [world.stamp(i) for i in (0, 7, 14, 21, 29)]
    assert len(laser_session.trajectory(max_poses=1000)) == 30


@pytest.mark.parametrize(
    ("asked", "reason", "field"),
    [
        ({"from_ns": 2, "to_ns": 1}, "TRAJECTORY_RANGE_INVALID", "from_ns"),
        ({"max_poses": 1}, "TRAJECTORY_RANGE_INVALID", "max_poses"),
        ({"max_poses": 3, "page_size": 3}, "TRAJECTORY_RANGE_INVALID", "max_poses"),
        ({"page_size": 3, "page_token": "x"}, "PAGE_TOKEN_INVALID", "page_token"),
    ],
)
def test_parts_that_cannot_be_are_refused(laser_session, asked, reason, field):
    with pytest.raises(InvalidArgument) as error:
        laser_session.trajectory(**asked)
    assert (error.value.reason, error.value.field) == (reason, field)


def test_rest_answers_the_same(server, laser_session):
    url = f"{server.rest_url}/v1/sessions/{laser_session.session_id}"
    at_ns = world.stamp(3) + 5
    pose = httpx.get(f"{url}/pose", params={"at_ns": at_ns}).json()
    assert "pose" not in pose
    x = laser_session.pose_at(at_ns).t_map_base.translation[0]
    assert pose["pose_at"]["t_map_base"]["translation"]["x"] == pytest.approx(x, abs=1e-12)
    frames = {"target_frame": "map", "source_frame": "laser"}
    found = httpx.get(f"{url}/transform", params=frames | {"at_ns": at_ns}).json()["transform"]
    z = laser_session.transform("map", "laser", at_ns=at_ns).t_target_source.translation[2]
    assert found["t_target_source"]["translation"]["z"] == pytest.approx(z, abs=1e-12)
    part = httpx.get(f"{url}/trajectory", params={"from_ns": world.stamp(5), "page_size": 2}).json()
    assert ([p["stamp_ns"] for p in part["poses"]], part["next_page_token"]) == (
        [str(world.stamp(5)), str(world.stamp(6))],
        str(world.stamp(6)),
    )
    late = httpx.get(f"{url}/pose", params={"at_ns": world.stamp(40)})
    assert (late.status_code, late.json()["reason"]) == (409, "STAMP_AFTER_TRAJECTORY")
    assert httpx.get(f"{url}/pose?at_ns=now").json()["reason"] == "QUERY_INVALID"
