"""Plots of evaluations, with matplotlib: `pip install 'percept[plot]'`.

metrics = client.evaluation.trajectory(truth, estimate=estimate, return_pairs=True)
percept.plot.trajectories(metrics).savefig("trajectories.png")
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from .types.evaluation import PosePairs, TrajectoryMetrics

__all__ = ["trajectories"]

Floats = npt.NDArray[np.float64]


def errors(pairs: PosePairs) -> tuple[Floats, Floats, Floats]:
    """Seconds since the first pose, translation errors (m) and rotation errors (deg), (N,) each."""
    seconds = (pairs.stamps_ns - pairs.stamps_ns[:1]) / 1e9
    translation = np.linalg.norm(pairs.estimate[:, :3] - pairs.reference[:, :3], axis=1)
    # Half the angle between two rotations has this cosine.
    cosine = np.abs(np.sum(pairs.estimate[:, 3:] * pairs.reference[:, 3:], axis=1))
    rotation = np.degrees(2 * np.arccos(np.clip(cosine, 0, 1)))
    return seconds, translation, rotation


def trajectories(metrics: TrajectoryMetrics | PosePairs) -> Any:  # noqa: ANN401
    """A matplotlib figure: both trajectories over each other, seen along the axis on which the truth moves
    least, and translation and rotation error over time. Metrics need to have been asked for with
    `return_pairs`."""
    pairs = metrics if isinstance(metrics, PosePairs) else metrics.pairs
    if pairs is None or len(pairs) == 0:
        raise ValueError("metrics hold no poses: ask for them with return_pairs=True")
    # Not pyplot: no window, no global state.
    from matplotlib.figure import Figure

    extent = np.ptp(pairs.reference[:, :3], axis=0)
    a, b = sorted(set(range(3)) - {int(np.argmin(extent))})
    figure = Figure(figsize=(11, 7), layout="constrained")
    grid = figure.add_gridspec(2, 2)
    paths = figure.add_subplot(grid[:, 0])
    paths.plot(pairs.reference[:, a], pairs.reference[:, b], color="0.5", label="reference")
    paths.plot(pairs.estimate[:, a], pairs.estimate[:, b], color="tab:blue", label="estimate")
    paths.set(xlabel=f"{'xyz'[a]} [m]", ylabel=f"{'xyz'[b]} [m]", aspect="equal", title="Trajectories")
    paths.legend()
    seconds, translation, rotation = errors(pairs)
    for row, (values, label) in enumerate([(translation, "translation [m]"), (rotation, "rotation [deg]")]):
        axes = figure.add_subplot(grid[row, 1])
        axes.plot(seconds, values, color="tab:red")
        rmse = float(np.sqrt(np.mean(values**2)))
        axes.axhline(rmse, color="0.5", linestyle="--", label=f"rmse {rmse:.4g}")
        axes.set(xlabel="time [s]", ylabel=label, ylim=(0, None), title="Absolute error")
        axes.legend()
    return figure
