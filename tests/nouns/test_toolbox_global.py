"""Features of points and registration with no first guess, against a made scene whose truth is known."""

from __future__ import annotations

import numpy as np
import pytest
from percept import GlobalRegistrationOutcome, InvalidArgument


def boxes(rng, count=20):
    """Faces of boxes of many sizes on a floor, (N, 3) float32."""
    parts = []
    for _ in range(count):
        size = rng.uniform(0.2, 1.6, 3)
        p = rng.uniform(0, 1, (600, 3)) * size
        face = rng.integers(0, 3, 600)
        p[np.arange(600), face] = np.where(rng.integers(0, 2, 600) == 1, size[face], 0)
        turn = rng.uniform(0, 3)
        c, s = np.cos(turn), np.sin(turn)
        parts.append(p @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]).T + np.append(rng.uniform(-4, 4, 2), 0))
    return np.concatenate(parts).astype(np.float32)


def rotation(rng):
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q if np.linalg.det(q) > 0 else -q


@pytest.mark.parametrize("method", ["consistency", "ransac"])
def test_a_cloud_is_laid_over_another_from_anywhere(client, method):
    rng = np.random.default_rng(3)
    scene = boxes(rng)
    turn, shift = rotation(rng), rng.uniform(-10, 10, 3)
    source = (scene[scene[:, 0] > -2] @ turn.T + shift).astype(np.float32)
    target = scene[scene[:, 0] < 2]
    found = client.toolbox.register_clouds_globally(source, target=target, voxel_size_m=0.1, method=method)
    assert found.outcome == GlobalRegistrationOutcome.FOUND
    moved = found.t_target_source.matrix @ np.vstack([source.T, np.ones(len(source))])
    off = np.linalg.norm(moved[:3].T - scene[scene[:, 0] > -2], axis=1)
    assert off.max() < 0.05
    assert found.rival_overlap < found.overlap
    assert found.num_agreeing <= found.num_pairs


def test_clouds_of_different_places_are_not_said_to_match(client):
    source, target = boxes(np.random.default_rng(1)), boxes(np.random.default_rng(2))
    found = client.toolbox.register_clouds_globally(source, target=target, voxel_size_m=0.1)
    assert found.outcome != GlobalRegistrationOutcome.FOUND


def test_features_do_not_change_when_the_cloud_moves(client):
    rng = np.random.default_rng(4)
    scene = boxes(rng, 3)
    features = client.toolbox.compute_point_features(scene, radius_m=0.3)
    assert features.shape == (len(scene), 33)
    sums = features.reshape(-1, 3, 11).sum(2)
    assert np.allclose(sums[sums > 0], 200, atol=0.1)
    alone = client.toolbox.compute_point_features(np.array([[0, 0, 0], [9, 0, 0]], np.float32), radius_m=0.3)
    assert not alone.any()


def test_bad_parameters_are_named(client):
    points = np.zeros((50, 3), np.float32)
    with pytest.raises(InvalidArgument, match="voxel_size_m"):
        client.toolbox.register_clouds_globally(points, target=points, voxel_size_m=-1.0)
    with pytest.raises(InvalidArgument, match="radius_m"):
        client.toolbox.compute_point_features(points, radius_m=float("nan"))
    # Fifty equal points are one place.
    with pytest.raises(InvalidArgument, match="source"):
        client.toolbox.register_clouds_globally(points, target=points)
