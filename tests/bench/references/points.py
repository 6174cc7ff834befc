"""Filters and searches: scipy and Open3D answer the same question."""

from __future__ import annotations

import numpy as np

from . import data
from .finding import Finding


def legacy(points):
    """As Open3D has it, in float64."""
    import open3d as o3d

    return o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points.astype(float)))


def neighbours(toolbox):
    """kNN, radius and hybrid search, of every 20th point, against scipy's cKDTree. Each place once."""
    from scipy.spatial import cKDTree

    for name, points in data.clouds().items():
        points = np.unique(points, axis=0)
        queries = np.ascontiguousarray(points[::20])
        tree = cKDTree(points.astype(float))
        radius = {"lidar": 1.0, "redwood": 0.03, "table": 0.01}[name]
        for operation, k, limit in (("knn 10", 10, None), ("radius", None, radius), ("hybrid", 8, radius)):
            found = toolbox.find_neighbours(points, queries=queries, k=k, radius_m=limit)
            off = np.abs(truth_distances(points, queries, found) - found.distances_m)
            wrong = sum(
                not same_row(points, q, found.of(i)[0], expected)
                for i, (q, expected) in enumerate(zip(queries, expected_rows(tree, queries, k, limit)))
            )
            figures = {"queries": len(queries), "wrong_rows": wrong, "max_distance_error_m": float(off.max())}
            right = wrong == 0 and off.max() < 1e-5
            yield Finding(f"find_neighbors {operation}", name, "scipy cKDTree", right, figures)


def expected_rows(tree, queries, k, limit):
    if k is None:
        return tree.query_ball_point(queries.astype(float), limit)
    _, rows = tree.query(queries.astype(float), k, distance_upper_bound=limit or np.inf)
    return [row[row < tree.n] for row in rows]


def truth_distances(points, queries, found):
    of_query = np.repeat(np.arange(len(queries)), np.diff(found.offsets.astype(int)))
    return np.linalg.norm(points[found.indices].astype(float) - queries[of_query], axis=1)


def same_row(points, query, ours, theirs):
    """The same neighbours; equal distances (to float32) may be exchanged."""
    if set(ours.tolist()) == set(np.asarray(theirs).tolist()):
        return True

    def distances(rows):
        return np.sort(np.linalg.norm(points[rows].astype(float) - query, axis=1))

    a, b = distances(ours), distances(np.asarray(theirs, int))
    return len(a) == len(b) and np.allclose(a, b, rtol=1e-6, atol=0)


def outliers(toolbox):
    """Statistical and radius outliers against Open3D; its neighbours count the point itself.

    Each place once: Open3D throws out points that have all their neighbours at their own place, as 5,032
    points of the lidar's cloud, which lie at one; ours keeps them.
    """
    for name, points in data.clouds().items():
        points = np.unique(points, axis=0)
        cloud = legacy(points)
        radius = 1.0 if name == "lidar" else 0.02
        _, expected = cloud.remove_statistical_outlier(21, 2.0)
        found = toolbox.remove_statistical_outliers(points, num_neighbours=20, std_ratio=2.0)
        yield same_indices("remove_statistical_outliers", name, found.indices, expected, len(points))
        _, expected = cloud.remove_radius_outlier(16, radius)
        found = toolbox.remove_radius_outliers(points, radius_m=radius, min_neighbours=16)
        yield same_indices("remove_radius_outliers", name, found.indices, expected, len(points))


def same_indices(operation, name, ours, theirs, total):
    differ = len(np.setxor1d(ours, np.asarray(theirs)))
    figures = {"points": total, "kept": len(ours), "differ": differ}
    return Finding(operation, name, "Open3D", differ == 0, figures)


def voxels(toolbox):
    """Centroids of voxels against Open3D's, on the same grid (ours stands on the origin).

    Not 5 cm: depths are whole millimetres, many of them on borders, where Open3D's shifted grid rounds
    otherwise.
    """
    for name, points in data.clouds().items():
        size = 0.5 if name == "lidar" else 0.05037
        low = np.floor(points.min(0).astype(float) / size) * size
        expected, _, _ = legacy(points).voxel_down_sample_and_trace(size, low, points.max(0).astype(float))
        expected = np.asarray(expected.points)
        found = toolbox.downsample_voxels(points, voxel_size_m=size).points
        from scipy.spatial import cKDTree

        off, _ = cKDTree(expected).query(found.astype(float))
        figures = {"voxels": len(found), "expected": len(expected)}
        figures |= {"equal_share": float((off < 1e-5).mean()), "max_off_m": float(off.max())}
        right = len(found) == len(expected) and off.max() < 1e-5
        yield Finding("downsample_voxels", name, "Open3D", right, figures)


def subsets(toolbox):
    """Transforms, crops and samples against numpy and Open3D."""
    points = data.indoor()
    turn = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    t_a_b = np.eye(4)
    t_a_b[:3] = np.hstack([turn, [[1.0], [-2.0], [0.5]]])
    moved = toolbox.transform_cloud(points, t_a_b=t_a_b).points
    off = np.abs(moved - (points.astype(float) @ turn.T + t_a_b[:3, 3])).max()
    yield Finding("transform_cloud", "redwood", "numpy", bool(off < 1e-6), {"max_off_m": float(off)})
    for low, high in ((1.0, 2.0), (0.0, 1.5)):
        found = toolbox.crop_cloud(points, range_m=(low, high)).indices
        away = np.linalg.norm(points.astype(float), axis=1)
        yield same_indices_numpy("crop_cloud range", found, np.flatnonzero((away >= low) & (away <= high)), away)
    yield from crops(toolbox, points)
    with_nan = points.copy()
    with_nan[::7, 1] = np.nan
    kept = toolbox.remove_non_finite(with_nan).points
    same = np.array_equal(kept, with_nan[np.isfinite(with_nan).all(1)])
    yield Finding("remove_non_finite", "redwood", "numpy", same, {"kept": len(kept)})
    every = toolbox.sample_points(points, every=9).indices
    yield Finding("sample_points every", "redwood", "numpy", np.array_equal(every, np.arange(0, len(points), 9)), {})
    yield farthest(toolbox, points)


def crops(toolbox, points):
    """Boxes against Open3D, polygons against matplotlib's rule as OpenCV has it."""
    import cv2
    import open3d as o3d
    from percept import OrientedBox, Pose

    box = OrientedBox(t_frame_box=Pose.from_xyz(0.2, 0.1, 1.4, yaw_rad=0.6), size_m=(0.8, 0.7, 0.9))
    pose = box.t_frame_box.matrix
    theirs = o3d.geometry.OrientedBoundingBox(pose[:3, 3], pose[:3, :3], box.size_m)
    expected = theirs.get_point_indices_within_bounding_box(legacy(points).points)
    found = toolbox.crop_cloud(points, box=box).indices
    yield same_indices("crop_cloud box", "redwood", found, expected, len(points))
    corners = np.array([[-0.5, -0.4], [0.6, -0.5], [0.2, 0.1], [0.7, 0.5], [-0.6, 0.4]])
    found = toolbox.crop_cloud(points, polygon=corners).indices
    contour = corners.astype(np.float32).reshape(-1, 1, 2)
    inside = [cv2.pointPolygonTest(contour, (float(x), float(y)), False) >= 0 for x, y in points[:, :2]]
    yield same_indices_numpy("crop_cloud polygon", found, np.flatnonzero(inside), points, "OpenCV")


def same_indices_numpy(operation, ours, expected, points, reference="numpy"):
    differ = len(np.setxor1d(ours, expected))
    figures = {"points": len(points), "kept": len(ours), "differ": differ}
    return Finding(operation, "redwood", reference, differ == 0, figures)


def farthest(toolbox, points):
    """Each sample is as far from those before it as Open3D's, which starts at the same point."""
    found = toolbox.sample_points(points, farthest=200).indices
    theirs = legacy(points).farthest_point_down_sample(200, int(found[0]))
    from scipy.spatial import cKDTree

    def cover(samples):
        return cKDTree(samples).query(points.astype(float))[0].max()

    ours, other = cover(points[found].astype(float)), cover(np.asarray(theirs.points))
    figures = {"farthest_point_m": float(ours), "reference_m": float(other)}
    return Finding("sample_points farthest", "redwood", "Open3D", bool(abs(ours / other - 1) < 1e-4), figures)


CHECKS = [neighbours, outliers, voxels, subsets]
