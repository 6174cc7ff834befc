"""Metrics against ground truth."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from .. import _rpc
from .._arrays import Array, checked, same_length
from .._call import Call
from ..types.evaluation import (
    DetectionMetrics,
    ErrorStatistics,
    LabelledBox,
    TrajectoryAlignment,
    TrajectoryMetrics,
)
from ..types.geometry import Pose
from ..types.sessions import Trajectory
from ..v1 import evaluation_pb2
from ..v1 import evaluation_service_pb2 as service
from . import geometry, scene, words


def _poses(field: str, trajectory: Trajectory | tuple[Array, Array]) -> Iterable[evaluation_pb2.StampedPose]:
    """Of a trajectory, or of stamps (N,) int64 ns with poses (N, 4, 4) or (N, 7)."""
    if isinstance(trajectory, Trajectory):
        stamps, rows = trajectory.stamps_ns, np.hstack([trajectory.positions, trajectory.rotations])
    else:
        stamps = checked(f"{field} stamps", trajectory[0], ("N",), np.int64)
        rows = np.asarray(trajectory[1])
        if rows.ndim == 3:
            rows = checked(f"{field} poses", rows, ("N", 4, 4), np.float64)
        else:
            rows = checked(f"{field} poses", rows, ("N", 7), np.float64)
        same_length(f"{field} poses", rows, len(stamps))
    for stamp, row in zip(stamps.tolist(), rows, strict=True):
        pose = Pose.from_matrix(row) if row.ndim == 2 else Pose(row[:3], row[3:])
        yield evaluation_pb2.StampedPose(stamp_ns=stamp, pose=geometry.pose_to(pose))


def _statistics(m: evaluation_pb2.ErrorStatistics) -> ErrorStatistics:
    return ErrorStatistics(rmse=m.rmse, mean=m.mean, median=m.median, std=m.std, min=m.min, max=m.max)


def _trajectory_metrics(m: evaluation_pb2.TrajectoryMetrics) -> TrajectoryMetrics:
    return TrajectoryMetrics(
        num_pairs=m.num_pairs,
        ate_m=_statistics(m.ate_m),
        rpe_trans_m=_statistics(m.rpe_trans_m),
        rpe_rot_deg=_statistics(m.rpe_rot_deg),
        path_length_m=m.path_length_m,
        drift_percent=m.drift_percent,
        scale=m.scale,
    )


def _detection_metrics(m: evaluation_pb2.DetectionMetrics) -> DetectionMetrics:
    return DetectionMetrics(
        true_positives=m.true_positives,
        false_positives=m.false_positives,
        false_negatives=m.false_negatives,
        precision=m.precision,
        recall=m.recall,
        mean_iou=m.mean_iou,
        class_accuracy=m.class_accuracy,
    )


def _box_to(labelled: LabelledBox) -> evaluation_pb2.LabelledBox:
    return evaluation_pb2.LabelledBox(
        object_class=scene.class_to("object_class", labelled.object_class),
        box=geometry.box_to(labelled.box),
        confidence=labelled.confidence,
    )


def trajectory(
    reference: Trajectory | tuple[Array, Array],
    estimate: Trajectory | tuple[Array, Array],
    alignment: TrajectoryAlignment | str,
    max_stamp_difference_s: float | None,
) -> Call[service.EvaluateTrajectoryRequest, service.EvaluateTrajectoryResponse, TrajectoryMetrics]:
    request = service.EvaluateTrajectoryRequest(
        reference=_poses("reference", reference),
        estimate=_poses("estimate", estimate),
        alignment=words.number("alignment", evaluation_pb2.TrajectoryAlignment, alignment),
        max_stamp_difference_s=max_stamp_difference_s,
    )
    return Call(_rpc.EVALUATE_TRAJECTORY, request, lambda a: _trajectory_metrics(a.metrics))


def detections(
    truth: Sequence[LabelledBox], found: Sequence[LabelledBox], min_iou: float | None
) -> Call[service.EvaluateDetectionsRequest, service.EvaluateDetectionsResponse, DetectionMetrics]:
    request = service.EvaluateDetectionsRequest(
        truth=[_box_to(b) for b in truth], detections=[_box_to(b) for b in found], min_iou=min_iou
    )
    return Call(_rpc.EVALUATE_DETECTIONS, request, lambda a: _detection_metrics(a.metrics))
