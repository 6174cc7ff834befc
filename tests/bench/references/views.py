"""Features of images and several views of one scene: OpenCV answers the same question on the same matches."""

from __future__ import annotations

import numpy as np
from percept import CameraIntrinsics, PosedView, Ransac

from . import data
from .finding import Finding, pose_error
from .images import PINHOLE, K

CAMERA = CameraIntrinsics(**PINHOLE)


def grays():
    import cv2

    return [cv2.cvtColor(data.color(i), cv2.COLOR_RGB2GRAY) for i in (0, 2)]


def features(toolbox):
    """Keypoints where OpenCV has them, and matches that agree with the motion of the camera."""
    import cv2
    from scipy.spatial import cKDTree

    images = grays()
    for method, peer in (("orb", cv2.ORB_create(1000)), ("sift", cv2.SIFT_create(1000))):
        ours = [toolbox.extract_features(np.ascontiguousarray(g), method=method) for g in images]
        theirs = [peer.detectAndCompute(g, None) for g in images]
        points = np.array([k.pt for k in theirs[0][0]])
        away, _ = cKDTree(points).query(ours[0].points.astype(float))
        hamming = method == "orb"
        kept = toolbox.match_features(ours[0].descriptors, ours[1].descriptors, ratio=0.8).pairs
        other = matcher(hamming, theirs[0][1], theirs[1][1], 0.8)
        a, b = ours[0].points[kept[:, 0]], ours[1].points[kept[:, 1]]
        pa = points[other[:, 0]]
        pb = np.array([k.pt for k in theirs[1][0]])[other[:, 1]]
        figures = {
            "features": len(ours[0].points),
            "expected": len(points),
            "near_a_reference_share": float((away < 2).mean()),
            "matches": len(kept),
            "reference_matches": len(other),
            "right_share": epipolar_share(a, b),
            "reference_right_share": epipolar_share(pa, pb),
        }
        right = figures["right_share"] >= figures["reference_right_share"] - 0.05
        yield Finding(f"extract_features {method}", "redwood 0-2", "OpenCV", right, figures)
        expected = matcher(hamming, ours[0].descriptors, ours[1].descriptors, 0.8)
        same = set(map(tuple, kept.tolist())) ^ set(map(tuple, expected.tolist()))
        figures = {"matches": len(kept), "differ": len(same)}
        yield Finding(f"match_features {method}", "redwood 0-2", "OpenCV", len(same) == 0, figures)


def matcher(hamming, query, train, ratio):
    import cv2

    norm = cv2.NORM_HAMMING if hamming else cv2.NORM_L2
    if not hamming:
        query, train = query.astype(np.float32), train.astype(np.float32)
    pairs = cv2.BFMatcher(norm).knnMatch(query, train, 2)
    return np.array([[m.queryIdx, m.trainIdx] for m, second in pairs if m.distance < ratio * second.distance])


def true_motion():
    """t_2_0 of the trajectory: frame 0 in frame 2."""
    from .align import redwood_pose

    return redwood_pose(2, 0)


def epipolar_share(a, b):
    """Share of matches within 3 pixels of the epipolar line that the true motion gives."""
    t = true_motion()
    skew = np.array([[0, -t[2, 3], t[1, 3]], [t[2, 3], 0, -t[0, 3]], [-t[1, 3], t[0, 3], 0]])
    inverse = np.linalg.inv(K)
    fundamental = inverse.T @ skew @ t[:3, :3] @ inverse
    ha, hb = (np.column_stack([p.astype(float), np.ones(len(p))]) for p in (a, b))
    lines = ha @ fundamental.T
    return float((np.abs((lines * hb).sum(1)) / np.linalg.norm(lines[:, :2], axis=1) < 3).mean())


def matched():
    """Pixels of frames 0 and 2 that look alike, by OpenCV's SIFT."""
    import cv2

    found = [cv2.SIFT_create(2000).detectAndCompute(g, None) for g in grays()]
    pairs = matcher(False, found[0][1], found[1][1], 0.8)
    return [np.array([k.pt for k in found[i][0]])[pairs[:, i]] for i in (0, 1)]


def two_views(toolbox):
    """Essential matrix and homography against OpenCV's, triangulation against its rays."""
    import cv2

    a, b = matched()
    truth = true_motion()
    ours = toolbox.estimate_essential(a, b, camera_a=CAMERA, ransac=Ransac(threshold_px=1.0))
    essential, mask = cv2.findEssentialMat(a, b, K, cv2.RANSAC, 0.999, 1.0)
    _, r, t, _ = cv2.recoverPose(essential, a, b, K, mask=mask.copy())
    peer = np.eye(4)
    peer[:3, :3], peer[:3, 3] = r, t[:, 0]
    figures = direction_error("", ours.t_b_a.matrix, truth) | direction_error("reference_", peer, truth)
    figures |= {"inliers": len(ours.inliers), "reference_inliers": int(mask.sum())}
    right = figures["turn_deg"] < max(0.5, figures["reference_turn_deg"]) and (
        figures["heading_deg"] < max(3.0, figures["reference_heading_deg"])
    )
    yield Finding("estimate_essential", "redwood 0-2", "trajectory; OpenCV", bool(right), figures)
    ours = toolbox.estimate_homography(a, b, ransac=Ransac(threshold_px=3.0))
    h, mask = cv2.findHomography(a, b, cv2.RANSAC, 3.0, maxIters=10_000, confidence=0.9999)
    corners = np.array([[[0, 0]], [[639, 0]], [[639, 479]], [[0, 479]]], float)
    off = np.linalg.norm(
        cv2.perspectiveTransform(corners, ours.homography) - cv2.perspectiveTransform(corners, h), axis=2
    )
    figures = {
        "inliers": len(ours.inliers),
        "reference_inliers": int(mask.sum()),
        "corners_off_px": float(off.max()),
    }
    right = figures["inliers"] >= 0.98 * figures["reference_inliers"]
    yield Finding("estimate_homography", "redwood 0-2", "OpenCV", right, figures)
    yield from known_views(toolbox, a, b, truth)


def direction_error(prefix, found, truth):
    turn = pose_error(
        np.block([[found[:3, :3], np.zeros((3, 1))], [np.eye(4)[3:]]]),
        np.block([[truth[:3, :3], np.zeros((3, 1))], [np.eye(4)[3:]]]),
    )[1]
    u, v = (m[:3, 3] / np.linalg.norm(m[:3, 3]) for m in (found, truth))
    return {
        f"{prefix}turn_deg": turn,
        f"{prefix}heading_deg": float(np.degrees(np.arccos(np.clip(u @ v, -1, 1)))),
    }


def known_views(toolbox, a, b, truth):
    """Triangulation and PnP with the camera's true motion."""
    import cv2
    from percept import Pose

    views = [
        PosedView(camera=CAMERA, t_world_camera=Pose(), pixels=a),
        PosedView(camera=CAMERA, t_world_camera=Pose.from_matrix(np.linalg.inv(truth)), pixels=b),
    ]
    found = toolbox.triangulate_points(views)
    rays = cv2.triangulatePoints(K @ np.eye(4)[:3], K @ truth[:3], a.T, b.T)
    theirs = (rays[:3] / rays[3]).T
    usable = (found.rmse_px < 1.0) & found.in_front & (found.parallax_rad > np.radians(1))
    away = np.linalg.norm(found.positions - theirs, axis=1)[usable] / theirs[usable, 2]
    ours_px, theirs_px = (reprojection(p[usable], truth, a[usable], b[usable]) for p in (found.positions, theirs))
    figures = {"points": int(usable.sum()), "median_off_of_depth": float(np.median(away))}
    figures |= {"rmse_px": ours_px, "reference_rmse_px": theirs_px}
    right = ours_px <= theirs_px + 1e-6 and figures["median_off_of_depth"] < 0.02
    yield Finding("triangulate_points", "redwood 0-2", "OpenCV", bool(right), figures)
    depth = data.depth()[a[:, 1].round().astype(int), a[:, 0].round().astype(int)] / 1000.0
    seen = depth > 0
    rays = np.column_stack([a, np.ones(len(a))]) @ np.linalg.inv(K).T
    world, pixels = (rays * depth[:, None])[seen], b[seen]
    ours = toolbox.solve_pnp(world, pixels, camera=CAMERA, ransac=Ransac(threshold_px=2.0))
    _, r, t, inliers = cv2.solvePnPRansac(world, pixels, K, None, reprojectionError=2.0, iterationsCount=2000)
    r, t = cv2.solvePnPRefineLM(world[inliers[:, 0]], pixels[inliers[:, 0]], K, None, r, t)
    peer = np.eye(4)
    peer[:3, :3], peer[:3, 3] = cv2.Rodrigues(r)[0], t[:, 0]
    off_m, off_deg = pose_error(np.linalg.inv(ours.t_world_camera.matrix), truth)
    peer_m, peer_deg = pose_error(peer, truth)
    figures = {"off_m": off_m, "off_deg": off_deg, "reference_off_m": peer_m, "reference_off_deg": peer_deg}
    figures |= {"inliers": len(ours.inliers), "reference_inliers": len(inliers)}
    right = off_m < max(0.02, 1.2 * peer_m) and off_deg < max(0.5, 1.2 * peer_deg)
    yield Finding("solve_pnp", "redwood 0-2", "trajectory; OpenCV", right, figures)


def reprojection(points, t_b_a, a, b):
    """Root mean square over both images, pixels."""
    moved = points @ t_b_a[:3, :3].T + t_b_a[:3, 3]
    errors = []
    for p, pixels in ((points, a), (moved, b)):
        projected = p @ K.T
        errors.append(projected[:, :2] / projected[:, 2:] - pixels)
    return float(np.sqrt((np.concatenate(errors) ** 2).sum(1).mean()))


CHECKS = [features, two_views]
