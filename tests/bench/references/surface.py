"""Normals, local features, FPFH, shapes, boxes and hulls: Open3D, numpy, scipy and OpenCV."""

from __future__ import annotations

import numpy as np

from . import data
from .finding import Finding, angles_deg
from .points import legacy

#: Neighbourhoods of normals: name, and what bounds them.
NEIGHBOURHOODS = [
    ("hybrid", {"radius_m": 0.1, "max_neighbours": 30}),
    ("knn", {"max_neighbours": 20}),
    ("radius", {"radius_m": 0.03}),
]


def normals(toolbox):
    """Lines along the normals against Open3D's, and where they differ against numpy's eigenvectors."""
    for name, points in data.clouds().items():
        for kind, params in NEIGHBOURHOODS:
            if name == "lidar":
                params = {k: v * 10 if k == "radius_m" else v for k, v in params.items()}
            cloud = legacy(points)
            cloud.estimate_normals(search(params))
            found = toolbox.estimate_normals(points, **ours_of(params)).normals
            off = angles_deg(found, np.asarray(cloud.normals), signed=False)
            defined = found.any(1)
            worst = np.flatnonzero(defined & (off > 0.1))
            truth, clear = by_numpy(points, worst, params)
            ours = angles_deg(found[worst], truth, signed=False)[clear]
            off = off[defined]
            figures = {
                "points": len(points),
                "median_deg": float(np.median(off)),
                "p999_deg": float(np.quantile(off, 0.999)),
                "above_1_deg": int((off > 1).sum()),
                "of_these_ours_off_numpy": int((ours > 0.1).sum()),
                "undefined": int((~defined).sum()),
            }
            right = figures["median_deg"] <= 0.1 and figures["of_these_ours_off_numpy"] == 0
            yield Finding(f"estimate_normals {kind}", name, "Open3D", right, figures)


def ours_of(params):
    """The same neighbourhood as ours names it."""
    return {"radius_m": np.inf, "max_neighbours": 0, "min_neighbours": 3} | params


def search(params):
    """The same neighbourhood as Open3D names it."""
    import open3d as o3d

    radius, count = params.get("radius_m"), params.get("max_neighbours")
    if radius is None:
        return o3d.geometry.KDTreeSearchParamKNN(count)
    if count is None:
        return o3d.geometry.KDTreeSearchParamRadius(radius)
    return o3d.geometry.KDTreeSearchParamHybrid(radius, count)


def by_numpy(points, rows, params):
    """Directions of least scatter, and where they are unique: one neighbourhood, one direction."""
    from scipy.spatial import cKDTree

    tree = cKDTree(points.astype(float))
    radius, count = params.get("radius_m", np.inf), params.get("max_neighbours")
    out, clear = np.zeros((len(rows), 3)), np.zeros(len(rows), bool)
    for i, row in enumerate(rows):
        p = points[row].astype(float)
        if count is None:
            near, tie = tree.query_ball_point(p, radius), False
        else:
            away, near = tree.query(p, count + 1)
            # Which of two equally far points is the last one is anyone's choice.
            tie = away[count - 1] <= radius and away[count] - away[count - 1] < 1e-7 * away[count]
            near = near[:count][away[:count] <= radius]
        values, vectors = np.linalg.eigh(np.cov(points[near].T.astype(float), bias=True))
        out[i] = vectors[:, 0]
        clear[i] = not tie and values[1] - values[0] > 1e-4 * values[2]
    return out, clear


def oriented_normals(toolbox):
    """Signs by the spanning tree against Open3D's, of an object seen all around and of a scene."""
    milk = data.pcd(data.folder("cloud-pcl") / "milk.pcd")
    for name, points in {"milk": milk, "redwood": data.indoor()[::10]}.items():
        points = np.ascontiguousarray(points)
        cloud = legacy(points)
        cloud.estimate_normals(search({"max_neighbours": 20}))
        cloud.orient_normals_consistent_tangent_plane(12)
        params = ours_of({"max_neighbours": 20})
        found = toolbox.estimate_normals(points, orientation="spanning_tree", **params).normals
        ours, theirs = discord(points, found), discord(points, np.asarray(cloud.normals))
        same = float(((found * np.asarray(cloud.normals)).sum(1) > 0).mean())
        outward = float(((found * (points - points.mean(0))).sum(1) > 0).mean())
        # Which of both sides is of little account, and Open3D's is the inside of the milk.
        figures = {"points": len(points), "agree_share": max(same, 1 - same), "outward_share": outward}
        figures |= {"neighbours_against": ours, "reference_neighbours_against": theirs}
        yield Finding("estimate_normals orientation", name, "Open3D", ours <= theirs + 1e-3, figures)


def discord(points, normals):
    """Share of pairs of near neighbours with parallel planes whose normals look opposite ways."""
    from scipy.spatial import cKDTree

    _, near = cKDTree(points.astype(float)).query(points.astype(float), 6)
    dot = np.einsum("ij,ikj->ik", normals.astype(float), normals[near[:, 1:]].astype(float))
    return float((dot < -0.9).sum() / max((np.abs(dot) > 0.9).sum(), 1))


def local_features(toolbox):
    """Against numpy's eigenvalues of the 20 nearest, for every 50th point."""
    from scipy.spatial import cKDTree

    for name, points in data.clouds().items():
        found = toolbox.compute_local_features(points, k=20)
        rows = np.arange(0, len(points), 50)
        wide = points.astype(float)
        away, near = cKDTree(wide).query(wide[rows], 21)
        clear = away[:, 20] - away[:, 19] > 1e-7 * away[:, 20]
        off = np.zeros(5)
        for row, neighbours in zip(rows[clear], near[clear, :20]):
            values, vectors = np.linalg.eigh(np.cov(wide[neighbours].T, bias=True))
            l3, l2, l1 = values
            truth = [(l1 - l2) / l1, (l2 - l3) / l1, l3 / l1, 1 - abs(vectors[2, 0]), l3 / values.sum()]
            fields = ("linearity", "planarity", "scattering", "verticality", "curvature")
            ours = [getattr(found, f)[row] for f in fields]
            difference = np.abs(np.subtract(ours, truth))
            # With two nearly equal eigenvalues the normal, so the verticality, is not determined.
            difference[3] *= l2 - l3 > 1e-3 * l1
            off = np.maximum(off, difference)
        figures = {"points": int(clear.sum()), "max_off": float(off.max())}
        yield Finding("compute_local_features", name, "numpy", bool(off.max() < 1e-3), figures)


def point_features(toolbox):
    """FPFH against Open3D's with the same normals and the same neighbours."""
    import open3d as o3d
    from percept import PointCloud

    for name, size, radius in (("lidar", 0.5, 2.5), ("table", 0.01, 0.05), ("redwood", 0.05, 0.25)):
        cloud = legacy(data.clouds()[name]).voxel_down_sample(size)
        points = np.asarray(cloud.points).astype(np.float32)
        cloud = legacy(points)
        cloud.estimate_normals(o3d.geometry.KDTreeSearchParamKNN(20))
        cloud.orient_normals_towards_camera_location(np.zeros(3))
        normals = np.asarray(cloud.normals).astype(np.float32)
        cloud.normals = o3d.utility.Vector3dVector(normals.astype(float))
        for limit in (0, 100):
            params = {"radius_m": radius} | ({"max_neighbours": limit} if limit else {})
            expected = o3d.pipelines.registration.compute_fpfh_feature(cloud, search(params)).data.T
            with_normals = PointCloud(points, normals=normals)
            found = toolbox.compute_point_features(with_normals, radius_m=radius, max_neighbours=limit)
            off = np.linalg.norm(found - expected, axis=1) / np.linalg.norm(expected, axis=1).clip(1e-9)
            figures = {
                "points": len(points),
                "median_off": float(np.median(off)),
                "p99_off": float(np.quantile(off, 0.99)),
                "above_1e-3": int((off > 1e-3).sum()),
                "max_off": float(off.max()),
            }
            right = figures["p99_off"] <= 1e-3
            which = f"{radius} m" + (f", {limit}" if limit else "")
            yield Finding(f"compute_point_features {which}", name, "Open3D", right, figures)


def shapes(toolbox):
    """Centroid, variance, eigenvalues, hull and boxes of whole clouds and of an object."""
    import cv2
    from scipy.spatial import ConvexHull

    milk = data.pcd(data.folder("cloud-pcl") / "milk.pcd")
    for name, points in (data.clouds() | {"milk": milk}).items():
        wide = points.astype(float)
        features = toolbox.compute_shape_features(points).features
        values, vectors = np.linalg.eigh(np.cov(wide.T, bias=True))
        turn = angles_deg(features.eigenvectors, vectors[:, ::-1].T, signed=False)
        figures = {
            "centroid_off_m": float(np.abs(features.centroid - wide.mean(0)).max()),
            "variance_off": float(np.abs(features.variance_m2 / wide.var(0) - 1).max()),
            "eigenvalue_off": float(np.abs(features.eigenvalues_m2 / values[::-1] - 1).max()),
            "eigenvector_deg": float(turn.max()),
            "extent_off_m": float(np.abs(features.extent_m - np.ptp(wide, axis=0)).max()),
        }
        yield Finding("compute_shape_features", name, "numpy", max(figures.values()) < 1e-4, figures)
        truth, hull = ConvexHull(wide), toolbox.compute_convex_hull(points)
        figures = {
            "volume_m3": hull.volume_m3,
            "volume_off": abs(hull.volume_m3 / truth.volume - 1),
            "area_off": abs(hull.area_m2 / truth.area - 1),
            "corners": len(hull.vertices),
            "expected": len(truth.vertices),
        }
        right = max(figures["volume_off"], figures["area_off"]) < 1e-6
        yield Finding("compute_convex_hull", name, "scipy ConvexHull", right, figures)
        boxes = toolbox.fit_boxes(points)
        (_, _), sides, _ = cv2.minAreaRect((points[:, :2] - points[:, :2].mean(0)).astype(np.float32))
        area = float(np.prod(boxes.upright.size_m[:2]))
        off = np.abs(boxes.axis_aligned.size_m - np.ptp(wide, axis=0)).max()
        right = off < 1e-6 and area < np.prod(sides) * (1 + 1e-4)
        figures = {"area_of_reference": float(area / np.prod(sides)), "axis_aligned_off_m": float(off)}
        yield Finding("fit_boxes upright", name, "OpenCV minAreaRect", bool(right), figures)
        minimal = legacy(wide).get_minimal_oriented_bounding_box(robust=True).volume()
        share = float(np.prod(boxes.minimal.size_m) / minimal)
        figures = {"volume_of_reference": share}
        yield Finding("fit_boxes minimal", name, "Open3D", share < 1.001, figures)


CHECKS = [normals, oriented_normals, local_features, point_features, shapes]
