"""Several views of one scene, against cameras that were put there."""

from __future__ import annotations

import numpy as np
import pytest
from percept import CameraIntrinsics, InvalidArgument, Pose, PosedView, Ransac

CAMERA = CameraIntrinsics(width_px=640, height_px=480, fx_px=520.0, fy_px=515.0, cx_px=318.0, cy_px=242.0)
NOISE_PX = 0.3


@pytest.fixture
def rng():
    return np.random.default_rng(3)


def turn(axis, angle, translation):
    axis = np.asarray(axis, float) / np.linalg.norm(axis)
    return Pose(
        translation=np.asarray(translation, float), rotation=np.append(axis * np.sin(angle / 2), np.cos(angle / 2))
    )


def seen(points, t_world_camera, rng, noise=NOISE_PX):
    inverse = np.linalg.inv(t_world_camera.matrix)
    p = points @ inverse[:3, :3].T + inverse[:3, 3]
    pixels = np.column_stack(
        [
            CAMERA.fx_px * p[:, 0] / p[:, 2] + CAMERA.cx_px,
            CAMERA.fy_px * p[:, 1] / p[:, 2] + CAMERA.cy_px,
        ]
    )
    return pixels + rng.normal(0, noise, pixels.shape)


def scene(rng, n=400):
    return rng.uniform((-2, -1.5, 3), (2, 1.5, 8), (n, 3))


def angle_between(a, b):
    trace = np.trace(a[:3, :3].T @ b[:3, :3])
    return np.degrees(np.arccos(np.clip((trace - 1) / 2, -1, 1)))


A, B = Pose(), turn((0.2, 1, 0.1), 0.12, (0.6, 0.05, 0.1))


@pytest.fixture
def pair(rng):
    """Pixels in two images; every fifth pair is wrong."""
    points = scene(rng)
    a, b = seen(points, A, rng), seen(points, B, rng)
    b[::5] = rng.uniform((0, 0), (640, 480), b[::5].shape)
    return a, b


def test_the_relative_pose_is_that_of_the_cameras(client, pair):
    found = client.toolbox.estimate_essential(*pair, camera_a=CAMERA, ransac=Ransac(seed=4))
    t_b_a = np.linalg.inv(B.matrix)
    assert angle_between(found.t_b_a.matrix, t_b_a) < 0.3
    direction = t_b_a[:3, 3] / np.linalg.norm(t_b_a[:3, 3])
    assert found.t_b_a.translation @ direction > 0.999
    good = np.flatnonzero(np.arange(400) % 5)
    # A wrong pair may lie on its epipolar line by chance.
    assert np.isin(good, found.inliers).mean() > 0.97
    assert np.isin(found.inliers, good).mean() > 0.95
    assert np.linalg.norm(found.essential) == pytest.approx(1)
    again = client.toolbox.estimate_essential(*pair, camera_a=CAMERA, ransac=Ransac(seed=4))
    assert again == found
    both = client.toolbox.estimate_two_view(*pair, camera_a=CAMERA, ransac=Ransac(seed=4))
    assert (both.model, both.outcome) == ("essential", "pose")
    assert both.essential == found


def test_a_plane_is_told_by_its_homography(client, rng):
    points = scene(rng)
    points[:, 2] = 5 + 0.2 * points[:, 0]
    a, b = seen(points, A, rng), seen(points, B, rng)
    found = client.toolbox.estimate_homography(a, b)
    mapped = np.column_stack([a, np.ones(len(a))]) @ found.homography.T
    assert np.median(np.linalg.norm(mapped[:, :2] / mapped[:, 2:] - b, axis=1)) < 3 * NOISE_PX
    both = client.toolbox.estimate_two_view(a, b, camera_a=CAMERA)
    assert (both.model, both.outcome) == ("homography", "planar")


def test_triangulated_points_lie_where_they_were_put(client, rng):
    points = scene(rng, 200)
    poses = [A, B, turn((1, 0, 0), -0.1, (-0.4, 0.6, 0.2))]
    pixels = [seen(points, pose, rng) for pose in poses]
    # Seen by two, and by one.
    pixels[0][:10] = np.nan
    pixels[1][:5] = np.nan
    views = [PosedView(camera=CAMERA, t_world_camera=t, pixels=p) for t, p in zip(poses, pixels)]
    found = client.toolbox.triangulate_points(views)
    assert np.isnan(found.positions[:5]).all()
    assert not found.in_front[:5].any()
    error = found.positions[5:] - points[5:]
    assert np.linalg.norm(error, axis=1).max() < 0.2
    # Errors are as large as the covariance says for the noise put in: three degrees of freedom a point.
    inverse = np.linalg.inv(found.covariances[5:] * NOISE_PX**2)
    mahalanobis = np.einsum("ni,nij,nj->n", error, inverse, error).mean()
    assert mahalanobis == pytest.approx(3, rel=0.35)
    assert found.in_front[5:].all()


def test_a_camera_is_found_among_known_points(client, rng):
    points = scene(rng, 150)
    pixels = seen(points, B, rng)
    pixels[::4] = rng.uniform((0, 0), (640, 480), pixels[::4].shape)
    found = client.toolbox.solve_pnp(points, pixels, camera=CAMERA)
    assert angle_between(found.t_world_camera.matrix, B.matrix) < 0.2
    assert np.linalg.norm(found.t_world_camera.translation - B.translation) < 0.02
    assert found.rmse_px == pytest.approx(NOISE_PX * 2**0.5, rel=0.3)
    assert found.covariance.shape == (6, 6)


def test_what_cannot_be_estimated_is_refused_precisely(client, rng, pair):
    a, b = pair
    cases = [
        (lambda t: t.estimate_essential(a[:5], b[:5], camera_a=CAMERA), "CORRESPONDENCES_TOO_FEW", ""),
        (lambda t: t.estimate_homography(a, b[:-1]), "SIZE_MISMATCH", "points_b"),
        (
            lambda t: t.estimate_homography(a, b, ransac=Ransac(threshold_px=-1)),
            "OUT_OF_RANGE",
            "threshold_px",
        ),
        (lambda t: t.estimate_homography(a, b, ransac=Ransac(confidence=1.0)), "OUT_OF_RANGE", "confidence"),
        (lambda t: t.triangulate_points([]), "VIEWS_INVALID", "views"),
        (lambda t: t.estimate_homography(a[:, :1], b), "ARRAY_INVALID", "points_a"),
        (lambda t: t.solve_pnp(np.zeros((9, 3)), a[:9], camera=CAMERA), "NO_MODEL", ""),
    ]
    for call, reason, field in cases:
        with pytest.raises(InvalidArgument) as error:
            call(client.toolbox)
        assert (error.value.reason, error.value.field) == (reason, field)
