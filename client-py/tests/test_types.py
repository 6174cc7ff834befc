import dataclasses

import numpy as np
import pytest

import percept
from percept import CloudFrame, DepthFrame, InvalidArgument, PointCloud, Pose, RgbdFrame, ScanFrame


def random_pose(rng):
    q = rng.normal(size=4)
    return Pose(rng.normal(size=3), q / np.linalg.norm(q))


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
        assert Pose.from_yaw(1.0, 2.0, yaw).yaw_rad == pytest.approx(yaw)


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


def test_a_part_of_a_cloud_keeps_its_channels():
    points = np.arange(12, dtype=np.float32).reshape(4, 3)
    colours = np.arange(12, dtype=np.uint8).reshape(4, 3)
    cloud = PointCloud(points, colours=colours)
    mask = points[:, 2] > 3
    for chosen in (mask, [1, 2, 3], slice(1, None), np.array([-3, -2, -1])):
        part = cloud[chosen]
        assert np.array_equal(part.points, points[1:])
        assert np.array_equal(part.colours, colours[1:])
        assert part.normals is None
    assert len(cloud[np.zeros(4, bool)]) == len(cloud[[]]) == 0
    for wrong in (np.ones(3, bool), np.array([4]), np.array([[0]]), np.array([0.5])):
        with pytest.raises(InvalidArgument):
            cloud[wrong]
