"""The toolbox against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from percept import InvalidArgument, PointCloud, Pose, ResourceExhausted, Step

from support import world

NOISE_M = 0.002


@pytest.fixture
def rng():
    return np.random.default_rng(7)


def plane_points(rng, n, z=0.0, size=2.0):
    xy = rng.uniform(-size / 2, size / 2, (n, 2))
    return np.column_stack([xy, rng.normal(z, NOISE_M, n)]).astype(np.float32)


def ball(rng, centre, n=200, radius=0.05):
    return (rng.normal(size=(n, 3)) * radius / 3 + centre).astype(np.float32)


def test_outliers_go_and_the_rest_keeps_its_order_and_channels(client, rng):
    surface, far = plane_points(rng, 2000), np.array([[0, 0, 3], [5, 5, 5]], np.float32)
    intensities = np.arange(2002, dtype=np.float32)
    cloud = PointCloud(np.vstack([surface, far]), intensities=intensities)
    kept = client.toolbox.remove_statistical_outliers(cloud)
    assert not {2000, 2001} & set(kept.indices.tolist())
    assert kept.cloud.num_points > 1900
    assert np.array_equal(kept.cloud.points, cloud.points[kept.indices])
    assert np.array_equal(kept.cloud.intensities, intensities[kept.indices])


def test_one_centroid_a_voxel(client, rng):
    points = rng.uniform(0, 1, (5000, 3)).astype(np.float32)
    small = client.toolbox.downsample_voxels(points, voxel_size_m=0.25)
    assert small.num_points == 64
    cells = np.floor(points / 0.25).astype(int)
    expected = {tuple(c): points[(cells == c).all(1)].mean(0) for c in np.unique(cells, axis=0)}
    for p in small.points:
        assert np.allclose(p, expected[tuple(np.floor(p / 0.25).astype(int))], atol=1e-5)


def test_normals_stand_on_the_plane_and_look_at_the_viewpoint(client, rng):
    cloud = client.toolbox.estimate_normals(plane_points(rng, 2000, z=1.0), viewpoint_m=(0, 0, 5))
    # Zero where fewer than three neighbours were found, which happens at the rim.
    found = np.any(cloud.normals != 0, axis=1)
    assert found.mean() > 0.99
    assert np.allclose(np.linalg.norm(cloud.normals[found], axis=1), 1, atol=1e-4)
    assert np.quantile(cloud.normals[:, 2], 0.05) > 0.99
    below = client.toolbox.estimate_normals(plane_points(rng, 2000, z=1.0))
    assert np.quantile(below.normals[:, 2], 0.95) < -0.99


def test_normals_of_a_closed_surface_all_look_outward(client, rng):
    ball = rng.normal(size=(4000, 3))
    ball = (ball / np.linalg.norm(ball, axis=1, keepdims=True)).astype(np.float32)
    for around in (
        {"radius_m": 0.15},
        {"radius_m": np.inf, "max_neighbours": 12},
        {"radius_m": 0.15, "max_neighbours": 0},
        {"radius_m": np.inf, "max_neighbours": 4, "min_neighbours": 3},
    ):
        found = client.toolbox.estimate_normals(ball, orientation="spanning_tree", **around).normals
        defined = found.any(1)
        assert defined.mean() > 0.99
        assert np.quantile((found * ball)[defined].sum(1), 0.01) > 0.8
        # The viewpoint knows of one side only.
        seen = client.toolbox.estimate_normals(ball, viewpoint_m=(0, 0, 5), **around).normals
        assert (seen * ball).sum(1).min() < -0.8
    for bad, field in (
        ({"radius_m": np.inf, "max_neighbours": 0}, "max_neighbours"),
        ({"orientation": "spanning_tree", "tree_neighbours": 0}, "tree_neighbours"),
        ({"min_neighbours": 2}, "min_neighbours"),
        ({"orientation": "sideways"}, "orientation"),
    ):
        with pytest.raises(InvalidArgument) as error:
            client.toolbox.estimate_normals(ball, **bad)
        assert error.value.field == field


def test_planes_are_found_with_their_points(client, rng):
    floor = plane_points(rng, 3000, size=4.0)
    wall = plane_points(rng, 1500)[:, [2, 0, 1]] + np.array([2, 0, 1.2], np.float32)
    planes = client.toolbox.segment_planes(np.vstack([floor, wall]), max_planes=2, seed=3)
    assert [p.kind for p in planes] == ["floor", "wall"]
    assert abs(planes[0].plane.normal[2]) > 0.999
    assert abs(planes[0].plane.offset_m) < 0.005
    assert abs(abs(planes[1].plane.offset_m) - 2.0) < 0.005
    assert len(planes[0].indices) > 2900
    assert (np.diff(planes[0].indices.astype(int)) > 0).all()
    again = client.toolbox.segment_planes(np.vstack([floor, wall]), max_planes=2, seed=3)
    assert again == planes


def test_planes_are_named_by_what_is_up_and_say_how_far_they_are_from_level(client, rng):
    floor = plane_points(rng, 3000, size=4.0)
    wall = plane_points(rng, 1500)[:, [2, 0, 1]] + np.array([2, 0, 1.2], np.float32)
    cloud = np.vstack([floor, wall])
    # As a camera's optical frame has it: x right, y down, z ahead.
    optical = cloud[:, [1, 2, 0]] * np.array([-1, -1, 1], np.float32)
    found = client.toolbox.segment_planes(optical, max_planes=2, seed=3)
    assert [p.kind for p in found] == ["wall", "floor"]
    found = client.toolbox.segment_planes(optical, max_planes=2, seed=3, up=(0, -3, 0))
    assert [p.kind for p in found] == ["floor", "wall"]
    assert [p.tilt_rad for p in found] == pytest.approx([0, np.pi / 2], abs=0.01)
    # Twenty degrees off: nothing is what it is, and why is said.
    turned = client.toolbox.segment_planes(optical, max_planes=2, seed=3, up=(np.sin(0.35), -np.cos(0.35), 0))
    assert turned[0].kind == "other"
    assert turned[0].tilt_rad == pytest.approx(0.35, abs=0.01)
    step = Step("segment_planes", max_planes=2, seed=3, up=(0, -1, 0))
    assert [p.kind for p in client.toolbox.run_pipeline(optical, [step]).steps[0].answer] == ["floor", "wall"]
    for bad in ((0, 0, 0), (0, float("nan"), 0)):
        with pytest.raises(InvalidArgument) as error:
            client.toolbox.segment_planes(optical, up=bad)
        assert (error.value.reason, error.value.field) == ("OUT_OF_RANGE", "up")


@pytest.mark.parametrize("method", ["euclidean", "dbscan"])
def test_groups_are_told_apart_and_noise_is_noise(client, rng, method):
    balls = [ball(rng, c) for c in ((0, 0, 0), (1, 0, 0), (0, 1, 0))]
    points = np.vstack([*balls, [[5, 5, 5]]]).astype(np.float32)
    clusters = client.toolbox.cluster_points(points, method=method, eps_m=0.05)
    assert clusters.num_clusters == 3
    assert clusters.labels[-1] == -1
    for i in range(3):
        labels = clusters.labels[i * 200 : (i + 1) * 200]
        assert (labels == i).mean() > 0.95


def test_the_shape_of_a_box_is_that_of_the_box(client, rng):
    size = np.array([1.0, 0.5, 0.2])
    points = rng.uniform(-0.5, 0.5, (20000, 3)) * size
    turn = Pose.from_xyz(0.3, -0.2, 1.0, yaw_rad=0.5)
    turned = (points @ turn.matrix[:3, :3].T + turn.translation).astype(np.float32)
    shape = client.toolbox.compute_shape_features(turned)
    assert np.allclose(shape.features.centroid, turn.translation, atol=0.02)
    # Variance of a uniform distribution: length^2 / 12.
    assert np.allclose(shape.features.eigenvalues_m2, size**2 / 12, rtol=0.05)
    l1, l2, l3 = shape.features.eigenvalues_m2
    assert shape.features.linearity == pytest.approx((l1 - l2) / l1)
    assert shape.features.planarity == pytest.approx((l2 - l3) / l1)
    assert shape.features.sphericity == pytest.approx(l3 / l1)
    assert shape.features.volume_m3 == pytest.approx(np.prod(shape.upright_box.size_m))
    assert np.allclose(shape.features.extent_m, np.ptp(turned, axis=0), atol=1e-6)
    assert np.allclose(np.sort(shape.upright_box.size_m), np.sort(size), atol=0.03)
    assert np.allclose(shape.upright_box.centre, turn.translation, atol=0.02)


def test_registration_finds_how_the_cloud_was_moved(client):
    target = world.cloud(world.drive(1)[0])
    moved = Pose.from_xyz(0.1, -0.05, 0.02, yaw_rad=0.03)
    back = np.linalg.inv(moved.matrix)
    source = (target @ back[:3, :3].T + back[:3, 3]).astype(np.float32)
    for method in ("point_to_plane", "point_to_point"):
        found = client.toolbox.register_clouds(source, target=target, method=method, max_distance_m=0.5)
        assert found.converged, method
        tolerance = 0.005 if method == "point_to_plane" else 0.03
        assert np.allclose(found.t_target_source.matrix, moved.matrix, atol=tolerance), method
        assert found.fitness > 0.9
        assert len(found.degenerate_axes) == 6
        assert found.covariance.shape == (6, 6)


def test_unprojection_is_the_pinhole_model(client):
    pose = world.drive(1)[0]
    depth = world.depth_image(pose)
    cloud = client.toolbox.unproject_depth(depth, intrinsics=world.INTRINSICS, metres_per_unit=0.001, stride=4)
    k = world.INTRINSICS
    v, u = np.mgrid[0:240:4, 0:320:4]
    z = depth[::4, ::4] / 1000
    expected = np.stack([(u - k.cx_px) / k.fx_px * z, (v - k.cy_px) / k.fy_px * z, z], -1).reshape(-1, 3)
    assert np.allclose(cloud.points, expected, atol=1e-4)
    none = np.zeros((240, 320), np.uint16)
    empty = client.toolbox.unproject_depth(none, intrinsics=world.INTRINSICS, metres_per_unit=0.001)
    assert empty.num_points == 0
    near = client.toolbox.unproject_depth(depth, intrinsics=world.INTRINSICS, metres_per_unit=0.001, max_depth_m=3.0)
    assert near.num_points == ((depth > 0) & (depth <= 3000)).sum()


def test_objects_are_found_in_a_cloud_of_the_room(client):
    pose = world.drive(1)[0]
    points = world.cloud(pose, rings=64) + np.array([0, 0, world.CAMERA_HEIGHT_M], np.float32)
    found = client.toolbox.detect_objects(points)
    assert found
    centres = np.array([d.box.centre + pose.translation for d in found])
    wanted = [(low + high) / 2 for low, high in world.FURNITURE]
    near = [np.linalg.norm(centres[:, :2] - w[:2], axis=1).min() for w in wanted]
    assert sum(d < 0.4 for d in near) >= 3, near
    assert all(0 <= d.confidence <= 1 and d.features.num_points > 0 for d in found)


def test_a_car_is_found_in_a_scan_of_a_street(client):
    # Beams of a lidar 1.7 m above a street meet the ground or a car of 4.1 x 1.7 x 1.5 m, 12 m ahead: body and cabin.
    boxes = [((10, 1.2, 0.2), (14.1, 2.9, 0.9)), ((10.4, 1.3, 0.9), (13, 2.8, 1.5))]
    azimuths, elevations = np.arange(-180, 180, 0.18), np.arange(-24.8, 2.1, 0.42)
    azimuth, elevation = np.meshgrid(np.radians(azimuths), np.radians(elevations))
    rays = np.stack(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], -1
    ).reshape(-1, 3)
    origin = np.array([0, 0, 1.7])
    with np.errstate(divide="ignore"):
        ranges = np.where(rays[:, 2] < 0, -origin[2] / rays[:, 2], np.inf)
        for low, high in boxes:
            a, b = (np.array(low) - origin) / rays, (np.array(high) - origin) / rays
            near, far = np.minimum(a, b).max(1), np.maximum(a, b).min(1)
            ranges = np.where((near > 0) & (near <= far), np.minimum(ranges, near), ranges)
    points = (rays * ranges[:, None])[ranges < 80].astype(np.float32)
    found = client.toolbox.detect_objects(points, environment="outdoor", sensor_height_m=1.7)
    cars = [d for d in found if d.object_class in ("car", "van")]
    assert len(cars) == 1, found
    assert np.linalg.norm(cars[0].box.centre[:2] - [12.05, 2.05]) < 0.6
    with pytest.raises(InvalidArgument, match="sensor_height_m"):
        client.toolbox.detect_objects(points, environment="outdoor", sensor_height_m=-1.0)


def test_a_cloud_without_points_is_served_or_refused_precisely(client):
    empty = np.empty((0, 3), np.float32)
    for call in (client.toolbox.downsample_voxels, client.toolbox.remove_statistical_outliers):
        try:
            answer = call(empty)
        except InvalidArgument as error:
            assert error.reason == "CLOUD_EMPTY"  # noqa: PT017
        else:
            assert getattr(answer, "cloud", answer).num_points == 0


@pytest.mark.parametrize("value", [0.0, -1.0, float("nan")])
def test_parameters_out_of_their_bounds_are_refused_by_name(client, rng, value):
    with pytest.raises(InvalidArgument) as error:
        client.toolbox.downsample_voxels(plane_points(rng, 100), voxel_size_m=value)
    assert error.value.reason in ("PARAMETER_OUT_OF_RANGE", "OUT_OF_RANGE")
    assert "voxel_size_m" in error.value.field


def test_a_cloud_over_the_limit_is_refused(client):
    with pytest.raises(ResourceExhausted) as error:
        client.toolbox.downsample_voxels(np.zeros((2_000_001, 3), np.float32))
    assert (error.value.reason, error.value.field) == ("CLOUD_TOO_LARGE", "cloud.cloud.num_points")
