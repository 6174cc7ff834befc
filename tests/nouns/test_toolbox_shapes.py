"""Neighbours, local features, boxes, hulls, depth images, image features: against numpy and closed forms."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from percept import CameraIntrinsics, InvalidArgument, Pose, ResourceExhausted

CAMERA = CameraIntrinsics(width_px=160, height_px=120, fx_px=150.0, fy_px=150.0, cx_px=79.5, cy_px=59.5)


@pytest.fixture
def rng():
    return np.random.default_rng(5)


def distances(a, b):
    return np.linalg.norm(a[:, None].astype(float) - b[None], axis=2)


def test_neighbours_are_those_of_brute_force(client, rng):
    points = rng.uniform(0, 1, (800, 3)).astype(np.float32)
    queries = rng.uniform(-0.2, 1.2, (60, 3)).astype(np.float32)
    far = distances(queries, points)
    found = client.toolbox.find_neighbours(points, queries=queries, k=7)
    assert np.array_equal(np.diff(found.offsets.astype(int)), np.full(60, 7))
    assert np.allclose(found.distances_m.reshape(60, 7), np.sort(far, axis=1)[:, :7], atol=1e-6)
    within = client.toolbox.find_neighbours(points, queries=queries, radius_m=0.2)
    for i in range(60):
        indices, away = within.of(i)
        assert set(indices.tolist()) == set(np.flatnonzero(far[i] <= 0.2).tolist())
        assert (np.diff(away) >= 0).all()
    both = client.toolbox.find_neighbours(points, queries=queries, radius_m=0.2, k=3)
    counts = np.minimum((far <= 0.2).sum(1), 3)
    assert np.array_equal(np.diff(both.offsets.astype(int)), counts)
    own = client.toolbox.find_neighbours(points, k=1)
    assert np.array_equal(own.indices, np.arange(800))
    # More than there are: all of them.
    assert len(client.toolbox.find_neighbours(points[:5], k=50).indices) == 25
    for bad, field in (({}, "k"), ({"k": 0}, "k"), ({"radius_m": -1.0}, "radius_m")):
        with pytest.raises(InvalidArgument) as error:
            client.toolbox.find_neighbours(points, **bad)
        assert error.value.field == field
    with pytest.raises(ResourceExhausted) as error:
        client.toolbox.find_neighbours(np.zeros((200_000, 3), np.float32), radius_m=1.0)
    assert error.value.reason == "NEIGHBOURS_TOO_MANY"


def test_local_features_are_those_of_the_covariance(client, rng):
    points = rng.uniform(0, 1, (500, 3)).astype(np.float32) * (1, 1, 0.2)
    points = points.astype(np.float32)
    found = client.toolbox.compute_local_features(points, k=12)
    nearest = np.argsort(distances(points, points), axis=1)[:, :12]
    for i in range(0, 500, 25):
        values, vectors = np.linalg.eigh(np.cov(points[nearest[i]].T.astype(float), bias=True))
        l3, l2, l1 = values
        assert found.linearity[i] == pytest.approx((l1 - l2) / l1, abs=1e-3)
        assert found.planarity[i] == pytest.approx((l2 - l3) / l1, abs=1e-3)
        assert found.scattering[i] == pytest.approx(l3 / l1, abs=1e-3)
        assert found.curvature[i] == pytest.approx(l3 / values.sum(), abs=1e-3)
        assert found.verticality[i] == pytest.approx(1 - abs(vectors[2, 0]), abs=1e-2)


def test_boxes_and_hull_of_a_turned_box_are_its_own(client, rng):
    size = np.array([1.0, 0.6, 0.3])
    corners = np.array(list(itertools.product((-0.5, 0.5), repeat=3))) * size
    inner = rng.uniform(-0.5, 0.5, (300, 3)) * size
    turn = Pose(translation=np.array([2.0, -1, 0.5]), rotation=np.array([0.2, 0.3, -0.1, (1 - 0.14) ** 0.5]))
    points = (np.vstack([corners, inner]) @ turn.matrix[:3, :3].T + turn.translation).astype(np.float32)
    boxes = client.toolbox.fit_boxes(points)
    assert np.allclose(boxes.minimal.size_m, size, atol=1e-4)
    assert np.allclose(boxes.minimal.centre, turn.translation, atol=1e-4)
    assert np.allclose(boxes.axis_aligned.size_m, np.ptp(points, axis=0), atol=1e-6)
    volumes = [np.prod(b.size_m) for b in (boxes.minimal, boxes.upright, boxes.axis_aligned)]
    assert volumes == sorted(volumes)
    hull = client.toolbox.compute_convex_hull(points)
    assert hull.volume_m3 == pytest.approx(np.prod(size), rel=1e-4)
    assert hull.area_m2 == pytest.approx(2 * (0.6 + 0.3 + 0.18), rel=1e-4)
    assert len(hull.vertices) == 8
    # Signed tetrahedra add up to the volume if the triangles turn outward.
    a, b, c = (hull.vertices[hull.triangles[:, i]] for i in range(3))
    assert np.einsum("ni,ni->n", a, np.cross(b, c)).sum() / 6 == pytest.approx(hull.volume_m3)
    features = client.toolbox.compute_shape_features(points).features
    assert features.hull_volume_m3 == pytest.approx(hull.volume_m3)
    assert np.allclose(features.variance_m2, points.astype(float).var(axis=0), rtol=1e-4)
    covariance = np.cov(points.T.astype(float), bias=True)
    for value, vector in zip(features.eigenvalues_m2, features.eigenvectors):
        assert np.allclose(covariance @ vector, value * vector, atol=1e-6)
    for call in (client.toolbox.fit_boxes, client.toolbox.compute_convex_hull):
        with pytest.raises(InvalidArgument) as error:
            call(np.full((4, 3), np.nan, np.float32))
        assert error.value.reason == "CLOUD_EMPTY"


def ray_grid():
    v, u = np.mgrid[0:120, 0:160]
    return np.stack([(u - CAMERA.cx_px) / CAMERA.fx_px, (v - CAMERA.cy_px) / CAMERA.fy_px, np.ones(u.shape)], -1)


def plane_depth(normal, offset):
    """Depth of the plane normal . p = offset."""
    return (offset / (ray_grid() @ normal)).astype(np.float32)


def test_depth_filters_do_what_they_are_named_for(client, rng):
    flat = np.full((120, 160), 2.0, np.float32)
    speckled = flat.copy()
    speckled[::10, ::10] = 3.0
    for filters in ([("median", {})], [("remove_outliers", {}), ("fill_holes", {"min_neighbours": 8})]):
        inner = client.toolbox.filter_depth(speckled, filters)[5:-5, 5:-5]
        assert np.allclose(inner, 2.0)
    noisy = flat + rng.normal(0, 0.01, flat.shape).astype(np.float32)
    noisy[:, 80:] += 1.0
    smooth = client.toolbox.filter_depth(noisy, [("bilateral", {"radius_px": 3})])
    assert smooth[10:-10, 10:70].std() < 0.005
    # The edge stays where it was.
    assert np.allclose(smooth[10:-10, 79], 2.0, atol=0.03)
    assert np.allclose(smooth[10:-10, 80], 3.0, atol=0.03)
    for bad, field in (
        ([], "filters"),
        ([("median", {"size_px": 4})], "filters[0].median.size_px"),
        ([("blur", {})], "filters"),
    ):
        with pytest.raises(InvalidArgument) as error:
            client.toolbox.filter_depth(flat, bad)
        assert error.value.field == field


def test_normals_and_planes_of_a_depth_image_are_metric(client):
    normal = np.array([0.3, -0.2, 0.933])
    normal /= np.linalg.norm(normal)
    depth = plane_depth(normal, 1.5)
    normals = client.toolbox.compute_depth_normals(depth, intrinsics=CAMERA)
    there = np.any(normals != 0, axis=2)
    assert there[5:-5, 5:-5].all()
    angle = np.degrees(np.arccos(np.clip(normals[there] @ -normal, -1, 1)))
    assert np.quantile(angle, 0.99) < 1
    wall = plane_depth(np.array([0.0, 0, 1]), 1.8)
    both = np.where(np.arange(160) < 80, depth, wall).astype(np.float32)
    found = client.toolbox.segment_depth_planes(both, intrinsics=CAMERA, min_pixels=1000)
    assert len(found.planes) == 2
    left, right = (found.planes[np.bincount(half[half >= 0]).argmax()] for half in np.split(found.labels, 2, axis=1))
    assert abs(left.plane.normal @ normal) > 0.9999
    assert abs(abs(left.plane.offset_m) - 1.5) < 0.002
    assert abs(right.plane.normal[2]) > 0.9999
    assert abs(abs(right.plane.offset_m) - 1.8) < 0.002


def test_edges_tell_who_hides_whom(client):
    depth = np.full((120, 160), 3.0, np.float32)
    depth[40:80, 60:100] = 1.5
    edges = client.toolbox.find_depth_edges(depth, intrinsics=CAMERA)
    assert edges[60, 60] == 1
    assert edges[60, 59] == 2
    assert not edges[10:30, 10:40].any()


def test_colours_of_another_camera_lie_where_they_belong(client):
    depth = np.full((120, 160), 2.0, np.float32)
    # The colour camera stands 0.1 m to the right: what the depth camera sees at u it sees at u - 7.5.
    t_colour_depth = Pose.from_xyz(-0.1, 0, 0)
    columns = np.tile(np.arange(160, dtype=np.uint8), (120, 1))
    image = np.repeat(columns[:, :, None], 3, axis=2)
    colour, seen = client.toolbox.register_colour(
        depth, image, depth_camera=CAMERA, colour_camera=CAMERA, t_colour_depth=t_colour_depth
    )
    expected = np.arange(160) - 7.5
    assert seen[60, 10:].all()
    assert not seen[60, :7].any()
    assert np.abs(colour[60, 10:, 0].astype(float) - expected[10:]).max() <= 1
    with pytest.raises(InvalidArgument) as error:
        client.toolbox.register_colour(
            depth[:-1], image, depth_camera=CAMERA, colour_camera=CAMERA, t_colour_depth=Pose()
        )
    assert error.value.reason == "SIZE_MISMATCH"


@pytest.mark.parametrize(("method", "size"), [("orb", 32), ("sift", 128)])
def test_features_of_a_shifted_image_match_by_the_shift(client, rng, method, size):
    coarse = rng.integers(0, 256, (30, 40)).astype(np.float64)
    big = np.kron(coarse, np.ones((8, 8)))
    # Blurred a little, so that blobs have a scale.
    for _ in range(2):
        big = (big + np.roll(big, 1, 0) + np.roll(big, -1, 0) + np.roll(big, 1, 1) + np.roll(big, -1, 1)) / 5
    image = big.astype(np.uint8)
    shifted = np.roll(image, (12, 20), axis=(0, 1))
    a = client.toolbox.extract_features(image, method=method, max_features=400)
    b = client.toolbox.extract_features(shifted, method=method, max_features=400)
    assert 50 < len(a.points) <= 400
    assert a.descriptors.shape == (len(a.points), size)
    assert len(a.sizes_px) == len(a.angles_rad) == len(a.responses) == len(a.octaves) == len(a.points)
    found = client.toolbox.match_features(a.descriptors, b.descriptors, ratio=0.8, mutual=True)
    assert len(found.pairs) > 40
    moved = b.points[found.pairs[:, 1]] - a.points[found.pairs[:, 0]]
    # A pixel of the coarsest level is 3.6 of the image (1.2^7).
    assert (np.abs(moved - (20, 12)) < 4).all(axis=1).mean() > 0.9
    # Distances are what they say.
    first, second = a.descriptors[found.pairs[0, 0]], b.descriptors[found.pairs[0, 1]]
    if method == "orb":
        assert found.distances[0] == np.unpackbits(first ^ second).sum()
    else:
        assert found.distances[0] == pytest.approx(np.linalg.norm(first.astype(float) - second), abs=0.1)
    for call, field in (
        (lambda t: t.extract_features(image, method=method, max_features=0), "max_features"),
        (lambda t: t.match_features(a.descriptors, b.descriptors, ratio=0.0), "ratio"),
        (
            lambda t: t.match_features(a.descriptors[:, :7].copy(), b.descriptors[:, :7].copy()),
            "descriptor_bytes",
        ),
    ):
        with pytest.raises(InvalidArgument) as error:
            call(client.toolbox)
        assert error.value.field == field
