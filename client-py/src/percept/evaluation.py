"""Evaluation: metrics against ground truth."""

from __future__ import annotations

from collections.abc import Sequence

from ._aio_transport import AsyncTransport
from ._arrays import Array
from ._convert import evaluation as convert
from ._transport import Transport
from .types.evaluation import DetectionMetrics, LabelledBox, TrajectoryAlignment, TrajectoryMetrics
from .types.sessions import Trajectory


class Evaluation:
    """Metrics, computed by the server."""

    def __init__(self, transport: Transport) -> None:
        self._transport = transport

    def trajectory(
        self,
        reference: Trajectory | tuple[Array, Array],
        *,
        estimate: Trajectory | tuple[Array, Array],
        alignment: TrajectoryAlignment | str = TrajectoryAlignment.SE3,
        max_stamp_difference_s: float | None = None,
    ) -> TrajectoryMetrics:
        """ATE and RPE as evo computes them. A trajectory is a Trajectory, or its stamps (N,) int64 ns with
        its poses (N, 4, 4) or (N, 7): x, y, z, quaternion x, y, z, w; float64."""
        call = convert.trajectory(reference, estimate, alignment, max_stamp_difference_s)
        return self._transport.call(call)

    def detections(
        self,
        truth: Sequence[LabelledBox],
        *,
        detections: Sequence[LabelledBox],
        min_iou: float | None = None,
    ) -> DetectionMetrics:
        """Precision and recall of boxes; a pair matches at this 3D intersection over union."""
        return self._transport.call(convert.detections(truth, detections, min_iou))


class AsyncEvaluation:
    """Metrics, computed by the server."""

    def __init__(self, transport: AsyncTransport) -> None:
        self._transport = transport

    async def trajectory(
        self,
        reference: Trajectory | tuple[Array, Array],
        *,
        estimate: Trajectory | tuple[Array, Array],
        alignment: TrajectoryAlignment | str = TrajectoryAlignment.SE3,
        max_stamp_difference_s: float | None = None,
    ) -> TrajectoryMetrics:
        """ATE and RPE as evo computes them. A trajectory is a Trajectory, or its stamps (N,) int64 ns with
        its poses (N, 4, 4) or (N, 7): x, y, z, quaternion x, y, z, w; float64."""
        call = convert.trajectory(reference, estimate, alignment, max_stamp_difference_s)
        return await self._transport.call(call)

    async def detections(
        self,
        truth: Sequence[LabelledBox],
        *,
        detections: Sequence[LabelledBox],
        min_iou: float | None = None,
    ) -> DetectionMetrics:
        """Precision and recall of boxes; a pair matches at this 3D intersection over union."""
        return await self._transport.call(convert.detections(truth, detections, min_iou))
