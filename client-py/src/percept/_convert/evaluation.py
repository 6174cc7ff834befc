"""Metrics against ground truth."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from .. import _rpc
from .._arrays import Array, checked, same_length
from .._call import Call
from ..types.evaluation import (
    DeltaUnit,
    DetectionMetrics,
    ErrorStatistics,
    LabelledBox,
    PosePairs,
    RelationMetrics,
    SegmentDrift,
    TrajectoryAlignment,
    TrajectoryMetrics,
)
from ..types.geometry import Pose
from ..types.sessions import Trajectory
from ..v1 import evaluation_pb2
from ..v1 import evaluation_service_pb2 as service
from ..v1 import geometry_pb2 as g
from . import geometry, scene, words


def _rows(field: str, poses: Array, count: int) -> list[g.Pose]:
    """Poses (N, 4, 4) or (N, 7) as messages."""
    rows = np.asarray(poses)
    rows = checked(field, rows, ("N", 4, 4) if rows.ndim == 3 else ("N", 7), np.float64)
    same_length(field, rows, count)
    if rows.ndim == 3:
        return [geometry.pose_to(Pose.from_matrix(row)) for row in rows]
    return [geometry.pose_to(Pose(translation=row[:3], rotation=row[3:])) for row in rows]


def _poses(field: str, trajectory: Trajectory | tuple[Array, Array]) -> Iterable[evaluation_pb2.StampedPose]:
    """Of a trajectory, or of stamps (N,) int64 ns with poses (N, 4, 4) or (N, 7)."""
    if isinstance(trajectory, Trajectory):
        stamps, rows = trajectory.stamps_ns, np.hstack([trajectory.positions, trajectory.rotations])
    else:
        stamps, rows = checked(f"{field} stamps", trajectory[0], ("N",), np.int64), trajectory[1]
    poses = _rows(f"{field} poses", rows, len(stamps))
    for stamp, pose in zip(stamps.tolist(), poses, strict=True):
        yield evaluation_pb2.StampedPose(stamp_ns=stamp, pose=pose)


def _relations(relations: tuple[Array, Array, Array]) -> Iterable[evaluation_pb2.TrajectoryRelation]:
    """Of stamps (N,) int64 ns, stamps (N,) and poses (N, 4, 4) or (N, 7)."""
    first = checked("relations first stamps", relations[0], ("N",), np.int64)
    second = checked("relations second stamps", relations[1], ("N",), np.int64)
    same_length("relations second stamps", second, len(first))
    poses = _rows("relations poses", relations[2], len(first))
    for stamp_1, stamp_2, pose in zip(first.tolist(), second.tolist(), poses, strict=True):
        yield evaluation_pb2.TrajectoryRelation(stamp_1_ns=stamp_1, stamp_2_ns=stamp_2, t_1_2=pose)


def _statistics(m: evaluation_pb2.ErrorStatistics) -> ErrorStatistics:
    return ErrorStatistics(rmse=m.rmse, mean=m.mean, median=m.median, std=m.std, min=m.min, max=m.max)


def _pairs(messages: Sequence[evaluation_pb2.PosePair]) -> PosePairs:
    def row(message: g.Pose) -> list[float]:
        t, q = message.translation, message.rotation
        return [t.x, t.y, t.z, q.x, q.y, q.z, q.w]

    return PosePairs(
        stamps_ns=np.array([m.stamp_ns for m in messages], dtype=np.int64),
        reference=np.array([row(m.reference) for m in messages], dtype=np.float64).reshape(-1, 7),
        estimate=np.array([row(m.estimate) for m in messages], dtype=np.float64).reshape(-1, 7),
    )


def _trajectory_metrics(answer: service.EvaluateTrajectoryResponse, with_pairs: bool) -> TrajectoryMetrics:
    m = answer.metrics
    d = m.segment_drift
    drift = SegmentDrift(
        translation_percent=d.translation_percent,
        rotation_deg_per_m=d.rotation_deg_per_m,
        num_segments=d.num_segments,
    )
    return TrajectoryMetrics(
        num_pairs=m.num_pairs,
        ate_m=_statistics(m.ate_m),
        ate_rot_deg=_statistics(m.ate_rot_deg),
        rpe_trans_m=_statistics(m.rpe_trans_m) if m.HasField("rpe_trans_m") else None,
        rpe_rot_deg=_statistics(m.rpe_rot_deg) if m.HasField("rpe_rot_deg") else None,
        path_length_m=m.path_length_m,
        drift_percent=m.drift_percent if m.HasField("drift_percent") else None,
        segment_drift=drift if m.HasField("segment_drift") else None,
        scale=m.scale,
        t_reference_estimate=geometry.pose(m.t_reference_estimate),
        pairs=_pairs(answer.pairs) if with_pairs else None,
    )


def _relation_metrics(m: evaluation_pb2.RelationMetrics) -> RelationMetrics:
    loops = m.num_loops > 0
    return RelationMetrics(
        num_relations=m.num_relations,
        num_missed=m.num_missed,
        translation_m=_statistics(m.translation_m),
        rotation_deg=_statistics(m.rotation_deg),
        num_loops=m.num_loops,
        loop_translation_m=_statistics(m.loop_translation_m) if loops else None,
        loop_rotation_deg=_statistics(m.loop_rotation_deg) if loops else None,
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
    estimate_offset_s: float,
    delta: float,
    delta_unit: DeltaUnit | str,
    all_pairs: bool,
    segment_lengths_m: Sequence[float],
    return_pairs: bool,
) -> Call[service.EvaluateTrajectoryRequest, service.EvaluateTrajectoryResponse, TrajectoryMetrics]:
    request = service.EvaluateTrajectoryRequest(
        reference=_poses("reference", reference),
        estimate=_poses("estimate", estimate),
        alignment=words.number("alignment", evaluation_pb2.TrajectoryAlignment, alignment),
        max_stamp_difference_s=max_stamp_difference_s,
        estimate_offset_s=estimate_offset_s,
        delta=delta,
        delta_unit=words.number("delta_unit", evaluation_pb2.DeltaUnit, delta_unit),
        all_pairs=all_pairs,
        segment_lengths_m=segment_lengths_m,
        return_pairs=return_pairs,
    )
    return Call(_rpc.EVALUATE_TRAJECTORY, request, lambda a: _trajectory_metrics(a, return_pairs))


def relations(
    trajectory: Trajectory | tuple[Array, Array],
    relations: tuple[Array, Array, Array],
    max_gap_s: float | None,
) -> Call[service.EvaluateRelationsRequest, service.EvaluateRelationsResponse, RelationMetrics]:
    request = service.EvaluateRelationsRequest(
        trajectory=_poses("trajectory", trajectory),
        relations=_relations(relations),
        max_gap_s=max_gap_s,
    )
    return Call(_rpc.EVALUATE_RELATIONS, request, lambda a: _relation_metrics(a.metrics))


def detections(
    truth: Sequence[LabelledBox], found: Sequence[LabelledBox], min_iou: float | None
) -> Call[service.EvaluateDetectionsRequest, service.EvaluateDetectionsResponse, DetectionMetrics]:
    request = service.EvaluateDetectionsRequest(
        truth=[_box_to(b) for b in truth], detections=[_box_to(b) for b in found], min_iou=min_iou
    )
    return Call(_rpc.EVALUATE_DETECTIONS, request, lambda a: _detection_metrics(a.metrics))
