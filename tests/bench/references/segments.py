"""Planes, clusters, ground: Open3D, scikit-learn, scipy and Patchwork++."""

from __future__ import annotations

import numpy as np

from . import data
from .finding import Finding, angles_deg, same_partition
from .points import legacy


def planes(toolbox):
    """Planes in turn against Open3D's RANSAC refined on its inliers, among the same points.

    Where both are at rest on other points, as on what is left of curved things, the one with the lower sum of
    squared distances, cut off at the distance, is the better.
    """
    import open3d as o3d

    for name, points in data.clouds().items():
        distance = 0.1 if name == "lidar" else 0.02
        params = {"max_iterations": 5000, "early_stop": False, "min_points": 1000}
        found = toolbox.segment_planes(points, distance_m=distance, max_planes=3, **params)
        o3d.utility.random.seed(1)
        rest = points.astype(float)
        for number, segment in enumerate(found):
            model, _ = legacy(rest).segment_plane(distance, 3, 5000, probability=1.0)
            theirs = refined(rest, np.array(model), distance)
            ours = np.append(segment.plane.normal, segment.plane.offset_m)
            off_m, off_deg = plane_off(rest, ours, theirs, distance)
            moves_m, moves_deg = plane_off(rest, ours, refined(rest, ours, distance), distance)
            figures = {
                "points": len(segment.indices),
                "expected": int(within(rest, theirs, distance).sum()),
                "off_m": off_m,
                "off_deg": off_deg,
                "numpy_moves_m": moves_m,
                "numpy_moves_deg": moves_deg,
                "cost_of_reference": cost(rest, ours, distance) / cost(rest, theirs, distance),
            }
            rests = moves_m < 0.002 and moves_deg < 0.2
            right = rests and ((off_m < 0.002 and off_deg < 0.2) or figures["cost_of_reference"] < 1)
            yield Finding(f"segment_planes {number + 1}", name, "Open3D, refined", right, figures)
            keep = np.ones(len(points), bool)
            keep[np.concatenate([s.indices for s in found[: number + 1]])] = False
            rest = points[keep].astype(float)


def heights(points, plane):
    return points @ plane[:3] + plane[3]


def within(points, plane, distance):
    return np.abs(heights(points, plane)) <= distance


def cost(points, plane, distance):
    return float(np.minimum(heights(points, plane) ** 2, distance**2).sum())


def plane_off(points, ours, theirs, distance):
    """Metres in the middle of their points, and degrees."""
    center = points[within(points, theirs, distance)].mean(0)
    degrees = angles_deg(ours[None, :3], theirs[None, :3], signed=False)[0]
    return float(abs(heights(center[None], ours)[0])), float(degrees)


def refined(points, plane, distance):
    """Least squares on the points within the distance, until these stay."""
    plane, before = plane / np.linalg.norm(plane[:3]), None
    for _ in range(100):
        near = within(points, plane, distance)
        if before is not None and np.array_equal(near, before):
            break
        before, center = near, points[near].mean(0)
        normal = np.linalg.eigh(np.cov(points[near].T))[1][:, 0]
        plane = np.append(normal, -normal @ center)
    return plane


def objects():
    """Points without their largest planes, thinned to 1 cm."""
    for name, count in (("redwood", 2), ("table", 1)):
        rest = np.asarray(legacy(data.clouds()[name]).voxel_down_sample(0.01).points)
        for _ in range(count):
            _, inliers = legacy(rest).segment_plane(0.02, 3, 1000)
            rest = np.delete(rest, inliers, axis=0)
        yield name, np.ascontiguousarray(rest.astype(np.float32))
    scan = np.asarray(legacy(data.kitti()[:, :3]).voxel_down_sample(0.1).points).astype(np.float32)
    yield "kitti", np.ascontiguousarray(scan[scan[:, 2] > -1.4])


def clusters(toolbox):
    """DBSCAN against scikit-learn, connected components against scipy."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree
    from sklearn.cluster import DBSCAN

    for name, points in objects():
        eps = 0.3 if name == "kitti" else 0.05
        wide = points.astype(float)
        reference = DBSCAN(eps=eps, min_samples=10).fit(wide)
        core = np.zeros(len(points), bool)
        core[reference.core_sample_indices_] = True
        found = toolbox.cluster_points(points, method="dbscan", eps_m=eps, min_points=10).labels
        yield dbscan(name, wide, eps, found, reference.labels_, core)
        pairs = cKDTree(wide).query_pairs(eps, output_type="ndarray")
        links = coo_matrix((np.ones(len(pairs), bool), pairs.T), (len(points),) * 2)
        expected = connected_components(links, directed=False)[1]
        expected = np.where(np.bincount(expected)[expected] >= 10, expected, -1)
        found = toolbox.cluster_points(points, method="euclidean", eps_m=eps, min_points=10).labels
        figures = {"points": len(points), "clusters": int(found.max() + 1)}
        figures["expected"] = len(np.unique(expected[expected >= 0]))
        right = same_partition(found, expected)
        yield Finding("cluster_points euclidean", name, "scipy components", right, figures)


def dbscan(name, points, eps, found, expected, core):
    """Cores and noise agree exactly; a border point is of a cluster that has a core in its reach."""
    from scipy.spatial import cKDTree

    border = ~core & (found >= 0)
    near = cKDTree(points[core]).query_ball_point(points[border], eps)
    owners = found[core]
    strangers = sum(label not in owners[n] for label, n in zip(found[border], near))
    figures = {
        "points": len(points),
        "clusters": int(found.max() + 1),
        "expected": int(expected.max() + 1),
        "labels_that_differ": int((~equal_up_to_numbers(found, expected)).sum()),
        "border_points": int(border.sum()),
        "of_no_cluster_in_reach": strangers,
    }
    cores = np.where(core, found, -1), np.where(core, expected, -1)
    noise = np.array_equal(found < 0, expected < 0)
    right = same_partition(*cores) and noise and strangers == 0
    return Finding("cluster_points dbscan", name, "scikit-learn", right, figures)


def equal_up_to_numbers(ours, theirs):
    """Which points have the same label once ours are named after theirs by their commonest."""
    names = {-1: -1}
    for label in np.unique(ours[ours >= 0]):
        values, counts = np.unique(theirs[ours == label], return_counts=True)
        names[label] = values[counts.argmax()]
    return np.array([names[label] for label in ours]) == theirs


def ground(toolbox):
    """Against Patchwork++: the share of points on which both agree, and whose ground lies flatter."""
    import pypatchworkpp

    for number in (0, 1, 2, 94, 95):
        scan = data.kitti(number)
        params = pypatchworkpp.Parameters()
        params.verbose = False
        peer = pypatchworkpp.patchworkpp(params)
        peer.estimateGround(scan)
        theirs = np.zeros(len(scan), bool)
        theirs[np.asarray(peer.getGroundIndices()).astype(int)] = True
        ours = np.zeros(len(scan), bool)
        ours[toolbox.segment_ground(np.ascontiguousarray(scan[:, :3])).indices] = True
        height_ours, height_theirs = roughness(scan, ours), roughness(scan, theirs)
        figures = {
            "points": len(scan),
            "ground": int(ours.sum()),
            "expected": int(theirs.sum()),
            "agree_share": float((ours == theirs).mean()),
            "iou": float((ours & theirs).sum() / (ours | theirs).sum()),
            "roughness_m": height_ours,
            "reference_roughness_m": height_theirs,
        }
        right = figures["agree_share"] > 0.9 and height_ours < height_theirs * 1.1
        yield Finding("segment_ground", f"kitti {number}", "Patchwork++", right, figures)


def roughness(scan, ground):
    """Spread of the heights of what is called ground in a cell of 2 m (90th less 10th percentile), median."""
    points = scan[ground, :3]
    cells = np.floor(points[:, :2] / 2).astype(int)
    _, cell = np.unique(cells, axis=0, return_inverse=True)
    order = np.argsort(cell, kind="stable")
    groups = np.split(points[order, 2], np.cumsum(np.bincount(cell))[:-1])
    return float(np.median([np.quantile(g, 0.9) - np.quantile(g, 0.1) for g in groups if len(g) >= 10]))


CHECKS = [planes, clusters, ground]
