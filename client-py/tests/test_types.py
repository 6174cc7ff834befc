import copy
import dataclasses
import datetime
import pickle

import numpy as np
import pytest

import percept
from percept import (
    CameraIntrinsics,
    CloudFrame,
    DepthFrame,
    InvalidArgument,
    OdometryFrame,
    OrientedBox,
    PathOptions,
    PointCloud,
    Pose,
    RgbdFrame,
    ScanFrame,
    SensorSpec,
)
from percept._convert import navigation, sensors
from percept.v1 import sensor_pb2


def random_pose(rng):
    q = rng.normal(size=4)
    return Pose(translation=rng.normal(size=3), rotation=q / np.linalg.norm(q))


def test_a_pose_survives_its_matrix():
    rng = np.random.default_rng(1)
    for _ in range(100):
        pose = random_pose(rng)
        again = Pose.from_matrix(pose.matrix)
        assert np.allclose(again.matrix, pose.matrix, atol=1e-12)
        assert np.linalg.norm(again.rotation) == pytest.approx(1)


def test_poses_compose_and_invert_as_their_matrices_do():
    rng = np.random.default_rng(2)
    for _ in range(100):
        a, b, points = random_pose(rng), random_pose(rng), rng.normal(size=(5, 3))
        assert np.allclose((a @ b).matrix, a.matrix @ b.matrix, atol=1e-12)
        assert np.allclose(a.inverse().matrix, np.linalg.inv(a.matrix), atol=1e-12)
        moved = points @ a.matrix[:3, :3].T + a.matrix[:3, 3]
        assert np.allclose(a.apply(points), moved, atol=1e-12)
        assert np.allclose(a.apply(points[0]), moved[0], atol=1e-12)
    with pytest.raises(InvalidArgument, match="shape"):
        Pose().apply(np.zeros((4, 4)))
    with pytest.raises(TypeError):
        Pose() @ np.eye(4)


def test_half_turns_about_each_axis_survive():
    for axis in np.eye(3):
        turn = 2 * np.outer(axis, axis) - np.eye(3)
        matrix = np.eye(4)
        matrix[:3, :3] = turn
        assert np.allclose(Pose.from_matrix(matrix).matrix, matrix, atol=1e-12)


def test_yaw_goes_in_and_comes_out():
    for yaw in (-3.1, -1.0, 0.0, 0.5, 3.1):
        assert Pose.from_xy_yaw(1.0, 2.0, yaw).yaw_rad == pytest.approx(yaw)


def test_roll_pitch_and_yaw_turn_about_fixed_axes_in_this_order():
    def turn(axis, angle):
        c, s = np.cos(angle), np.sin(angle)
        i, j = (axis + 1) % 3, (axis + 2) % 3
        out = np.eye(3)
        out[[i, j], [i, j]] = c
        out[j, i], out[i, j] = s, -s
        return out

    pose = Pose.from_xyz(1, 2, 3, roll_rad=0.3, pitch_rad=-0.5, yaw_rad=2.0)
    assert np.allclose(pose.matrix[:3, :3], turn(2, 2.0) @ turn(1, -0.5) @ turn(0, 0.3))
    assert pose.translation.tolist() == [1, 2, 3]
    assert Pose.from_xy_yaw(1, 2, 0.5) == Pose.from_xyz(1, 2, 0, yaw_rad=0.5)


@pytest.mark.parametrize(
    "make",
    [
        lambda bare: Pose(bare),
        lambda bare: Pose(*bare),
        lambda bare: SensorSpec("imu", kind="imu", t_base_sensor=bare),
        lambda bare: OrientedBox(t_frame_box=bare, size_m=(1, 1, 1)),
        lambda bare: OdometryFrame("o", stamp_ns=1, t_odom_base=bare),
        lambda bare: navigation.plan("s", bare, None, None, None),
        lambda bare: navigation.plan("s", (1, 2), bare, None, None),
        lambda bare: navigation.validate("s", np.array([bare, bare]), None, None),
    ],
)
@pytest.mark.parametrize("bare", [(1.0, 2.0, 0.5), np.array([1.0, 2.0, 0.5])], ids=["tuple", "array"])
def test_three_bare_numbers_are_no_pose(make, bare):
    with pytest.raises(TypeError, match=r"look alike.*from_xy_yaw") as error:
        make(bare)
    assert isinstance(error.value, InvalidArgument)


def test_a_pose_as_an_end_gives_its_place_and_heading():
    goal = Pose.from_xy_yaw(1, 2, 0.5)
    request = navigation.plan("s", goal, None, None, PathOptions(planner="hybrid")).request
    assert (request.goal.x, request.goal.y) == (1, 2)
    assert request.options.goal_yaw_rad == pytest.approx(0.5)
    told = PathOptions(planner="hybrid", goal_yaw_rad=3.0)
    assert navigation.plan("s", goal, None, None, told).request.options.goal_yaw_rad == 3.0
    assert not request.options.HasField("start_yaw_rad")


def test_poses_are_copied_and_pickled():
    pose = Pose.from_xy_yaw(1, 2, 0.5)
    assert copy.deepcopy(pose) == pickle.loads(pickle.dumps(pose)) == dataclasses.replace(pose) == pose


def test_a_sensor_is_checked_when_it_is_made():
    with pytest.raises(ValueError, match="range_max_m is -1; it must be above 0 and at most 10000 m"):
        SensorSpec("lidar", kind="lidar3d", range_max_m=-1)
    with pytest.raises(ValueError, match="kind is 'laser'; choose one of depth, rgbd"):
        SensorSpec("lidar", kind="laser")
    with pytest.raises(ValueError, match="kind is 'unspecified'; choose one of depth"):
        SensorSpec("lidar", kind="unspecified")
    with pytest.raises(ValueError, match="sensor_id is 5; use"):
        SensorSpec(5, kind="imu")
    with pytest.raises(ValueError, match="intrinsics is missing"):
        SensorSpec("camera", kind="depth")
    with pytest.raises(ValueError, match=r"width_px is 64.5.*whole number"):
        CameraIntrinsics(width_px=64.5, height_px=48, fx_px=60, fy_px=60, cx_px=32, cy_px=24)
    mount = Pose.from_xyz(1, 2, 3)
    assert SensorSpec("imu", kind="imu", t_base_sensor=mount.matrix).t_base_sensor == mount


def test_what_a_newer_server_says_of_a_sensor_can_be_read():
    told = sensors.spec(sensor_pb2.SensorSpec(sensor_id="radar", kind=99, range_max_m=1e6))
    assert (told.sensor_id, told.kind, told.range_max_m) == ("radar", "unspecified", 1e6)


def test_a_matrix_that_is_no_rotation_is_refused():
    mirror = np.diag([1.0, 1.0, -1.0, 1.0])
    for bad in (mirror, 2 * np.eye(4)):
        with pytest.raises(InvalidArgument) as error:
            Pose.from_matrix(bad)
        assert error.value.reason == "ROTATION_INVALID"


@pytest.mark.parametrize(
    ("points", "shown"),
    [
        (np.zeros((10, 2), np.float32), "(10, 2) float32"),
        (np.zeros((10, 3), np.float64), "(10, 3) float64"),
        ([[1, 2, 3]], "list"),
    ],
)
def test_a_wrong_array_is_refused_by_a_message_with_shape_and_type(points, shown):
    with pytest.raises(InvalidArgument) as error:
        PointCloud(points)
    assert error.value.field == "points"
    assert "(N, 3)" in error.value.message
    assert "float32" in error.value.message
    assert shown in error.value.message


def test_channels_have_one_entry_a_point():
    with pytest.raises(InvalidArgument) as error:
        PointCloud(np.zeros((3, 3), np.float32), intensities=np.zeros(2, np.float32))
    assert (error.value.reason, error.value.field) == ("SIZE_MISMATCH", "intensities")


def test_depth_in_units_needs_its_scale_and_metres_do_not():
    units, metres = np.zeros((4, 6), np.uint16), np.zeros((4, 6), np.float32)
    with pytest.raises(InvalidArgument, match="metres_per_unit"):
        DepthFrame("d", stamp_ns=1, depth=units)
    DepthFrame("d", stamp_ns=1, depth=units, metres_per_unit=0.001)
    DepthFrame("d", stamp_ns=1, depth=metres)
    with pytest.raises(InvalidArgument, match="colour"):
        RgbdFrame("d", stamp_ns=1, depth=metres, colour=np.zeros((4, 6), np.uint8))


@pytest.mark.parametrize("scale", ["mm", 0, -0.001, float("nan")])
def test_a_scale_of_depth_is_a_number_above_zero(scale):
    with pytest.raises(InvalidArgument, match=r"metres_per_unit is .*e\.g\. 0\.001 for millimetres"):
        DepthFrame("d", stamp_ns=1, depth=np.zeros((4, 6), np.uint16), metres_per_unit=scale)


def test_depth_in_float_takes_no_scale():
    # It was left aside: millimetres as float32 were taken for metres, with the scale beside them.
    metres = np.zeros((4, 6), np.float32)
    with pytest.raises(InvalidArgument, match="float32 is in metres; leave it out, and multiply") as error:
        DepthFrame("d", stamp_ns=1, depth=metres, metres_per_unit=0.001)
    assert (error.value.reason, error.value.field) == ("OPTIONS_CONFLICT", "metres_per_unit")
    DepthFrame("d", stamp_ns=1, depth=metres, metres_per_unit=1.0)


@pytest.mark.parametrize(
    ("stamp", "remedy"),
    [
        (1795836925.5, r"round\(seconds \* 1e9\)"),
        (None, r"time\.time_ns\(\)"),
        (True, r"not True"),
        (np.datetime64("2026-11-28T03:35:25"), r"astype\(\"datetime64\[ns\]\"\)"),
        (datetime.datetime(2026, 11, 28, tzinfo=datetime.timezone.utc), r"; send round\(when\.timestamp"),
        (datetime.datetime(2026, 11, 28), r"no time zone: name it first .*, then send round\("),
    ],
)
def test_a_stamp_that_is_no_number_of_nanoseconds_says_what_to_send(stamp, remedy):
    frame = DepthFrame("d", stamp_ns=stamp, depth=np.zeros((4, 6), np.float32))
    with pytest.raises(InvalidArgument, match=remedy) as error:
        sensors.frame_to("s", frame)
    assert (error.value.reason, error.value.field) == ("STAMP_INVALID", "stamp_ns")


def test_other_memory_layouts_are_copied_into_ours():
    wide = np.arange(48, dtype=">u2").reshape(4, 12)[:, ::2]
    frame = DepthFrame("d", stamp_ns=1, depth=wide, metres_per_unit=0.001)
    assert frame.depth.flags.c_contiguous
    assert frame.depth.dtype == np.dtype("<u2")
    assert np.array_equal(frame.depth, wide)


def test_values_are_frozen_print_short_and_compare_by_content():
    cloud = PointCloud(np.ones((1000, 3), np.float32))
    frame = CloudFrame("lidar", stamp_ns=5, cloud=cloud)
    assert repr(frame).startswith(
        "CloudFrame(sensor_id='lidar', stamp_ns=5, cloud=PointCloud(points=<1000 x 3"
    )
    assert frame == CloudFrame("lidar", stamp_ns=5, cloud=PointCloud(np.ones((1000, 3), np.float32)))
    assert frame != CloudFrame("lidar", stamp_ns=6, cloud=cloud)
    with pytest.raises(dataclasses.FrozenInstanceError):
        frame.stamp_ns = 6


@pytest.mark.parametrize("num_points", [0, 1, 2, 3])
def test_clouds_of_few_points_print(num_points):
    assert "points=" in repr(PointCloud(np.zeros((num_points, 3), np.float32)))


def test_words_are_their_strings():
    assert percept.TrackingState.LOST == "lost"
    assert str(percept.ObjectClass.TABLE) == "table"


def test_a_scan_is_float32():
    with pytest.raises(InvalidArgument, match="ranges_m"):
        ScanFrame(
            "s",
            stamp_ns=1,
            ranges_m=np.zeros(3),
            angle_min_rad=0,
            angle_increment_rad=0.1,
            range_min_m=0.1,
            range_max_m=10,
        )


def test_everything_exported_exists():
    for name in percept.__all__:
        assert hasattr(percept, name), name
