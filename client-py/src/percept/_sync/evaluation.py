# Written by client-py/generate from _async/evaluation.py; change that.
"""Evaluation: metrics against ground truth."""

from __future__ import annotations

from collections.abc import Sequence

from .._arrays import Array
from .._convert import evaluation as convert
from ..types.evaluation import (
    DeltaUnit,
    DetectionMetrics,
    LabelledBox,
    RelationMetrics,
    TrajectoryAlignment,
    TrajectoryMetrics,
)
from ..types.sessions import Trajectory
from .bound import Bound


class Evaluation(Bound):
    """Metrics, computed by the server."""

    def trajectory(
        self,
        reference: Trajectory | tuple[Array, Array],
        *,
        estimate: Trajectory | tuple[Array, Array],
        alignment: TrajectoryAlignment | str = TrajectoryAlignment.SE3,
        max_stamp_difference_s: float | None = None,
        estimate_offset_s: float = 0.0,
        delta: float = 1.0,
        delta_unit: DeltaUnit | str = DeltaUnit.FRAMES,
        all_pairs: bool = False,
        segment_lengths_m: Sequence[float] = (),
        return_pairs: bool = False,
    ) -> TrajectoryMetrics:
        """ATE and RPE as evo computes them, drift over segments as KITTI does (100, 200, ..., 800 m if no
        lengths are given). A trajectory is a Trajectory, or its stamps (N,) int64 ns with its poses
        (N, 4, 4) or (N, 7): x, y, z, quaternion x, y, z, w; float64. `delta` is the stretch of the RPE;
        with `all_pairs` one begins at every pose. `return_pairs` sends back what was compared, for
        `percept.plot`."""
        call = convert.trajectory(
            reference,
            estimate,
            alignment,
            max_stamp_difference_s,
            estimate_offset_s,
            delta,
            delta_unit,
            all_pairs,
            segment_lengths_m,
            return_pairs,
        )
        return self._transport.call(call)

    def relations(
        self,
        trajectory: Trajectory | tuple[Array, Array],
        *,
        relations: tuple[Array, Array, Array],
        max_gap_s: float | None = None,
    ) -> RelationMetrics:
        """A trajectory judged by motions that were checked by hand (Kuemmerle et al. 2009): stamps (N,)
        int64 ns, stamps (N,) int64 ns, and the body at the second seen from the first, (N, 4, 4) or
        (N, 7) float64. Poses are interpolated between two that are at most `max_gap_s` (2 s) apart."""
        return self._transport.call(convert.relations(trajectory, relations, max_gap_s))

    def detections(
        self,
        truth: Sequence[LabelledBox],
        *,
        detections: Sequence[LabelledBox],
        min_iou: float | None = None,
    ) -> DetectionMetrics:
        """Precision and recall of boxes; a pair matches at this 3D intersection over union."""
        return self._transport.call(convert.detections(truth, detections, min_iou))
