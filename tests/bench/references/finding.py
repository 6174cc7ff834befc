"""What a check finds, and the measures that checks share."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Finding:
    """Ours against a reference, on one input."""

    operation: str
    data: str
    reference: str
    #: Within the bar.
    right: bool
    #: What was measured, by name.
    figures: dict[str, float]


def angles_deg(a, b, *, signed=True):
    """Between rows of two arrays of unit vectors; unsigned: of the lines along them."""
    dot = (a.astype(float) * b.astype(float)).sum(-1)
    cross = np.linalg.norm(np.cross(a.astype(float), b.astype(float)), axis=-1)
    return np.degrees(np.arctan2(cross, dot if signed else np.abs(dot)))


def pose_error(found, truth):
    """Metres and degrees from one (4, 4) transform to another."""
    off = np.linalg.inv(truth) @ found
    turn = np.linalg.norm(off[:3, :3] - np.eye(3)) / (2 * np.sqrt(2))
    return float(np.linalg.norm(off[:3, 3])), float(np.degrees(2 * np.arcsin(min(turn, 1.0))))


def same_partition(a, b):
    """Whether two labellings say the same, up to numbers; negative is no label."""
    if not np.array_equal(a < 0, b < 0):
        return False
    pairs = np.unique(np.stack([a[a >= 0], b[a >= 0]]), axis=1)
    return len(np.unique(pairs[0])) == len(np.unique(pairs[1])) == pairs.shape[1]
