"""Metrics against ground truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ._value import Name, Value
from .geometry import OrientedBox, Pose
from .scene import ObjectClass


class TrajectoryAlignment(Name):
    """How the estimate is laid over the reference."""

    SE3 = "se3"
    SIM3 = "sim3"
    NONE = "none"
    #: The first poses onto each other.
    ORIGIN = "origin"


class DeltaUnit(Name):
    """What a stretch of the relative error is counted in."""

    FRAMES = "frames"
    METRES = "metres"
    SECONDS = "seconds"
    DEGREES = "degrees"


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class ErrorStatistics(Value):
    """Summary of a list of errors."""

    #: Root of the mean square, in the unit of what it is of.
    rmse: float
    mean: float
    median: float
    std: float
    min: float
    max: float


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class SegmentDrift(Value):
    """KITTI's drift, averaged over segments of fixed lengths."""

    #: Error at the end of a segment over its length, mean of all.
    translation_percent: float
    rotation_deg_per_m: float
    num_segments: int


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class PosePairs(Value):
    """True poses and the estimates of them, the latter laid over the reference."""

    #: (N,) int64, of the reference.
    stamps_ns: npt.NDArray[np.int64]
    #: (N, 7) float64: x, y, z, quaternion x, y, z, w.
    reference: npt.NDArray[np.float64]
    #: (N, 7) float64.
    estimate: npt.NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.stamps_ns)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class TrajectoryMetrics(Value):
    """How good a trajectory is."""

    #: Poses of the estimate with one of the truth at their time.
    num_pairs: int
    #: Distance between positions after alignment, metres.
    ate_m: ErrorStatistics
    #: Angle between rotations after alignment, degrees.
    ate_rot_deg: ErrorStatistics
    #: Over the stretch asked for; None if no poses are as far apart.
    rpe_trans_m: ErrorStatistics | None
    #: Over the stretch, degrees.
    rpe_rot_deg: ErrorStatistics | None
    #: Of the truth, metres.
    path_length_m: float
    #: Error of the last pose, first poses laid over each other; None for a path without length.
    drift_percent: float | None
    #: None for paths shorter than the shortest segment.
    segment_drift: SegmentDrift | None
    #: By which the estimate was multiplied; 1 unless the alignment has one.
    scale: float
    #: The alignment: estimate's frame, once scaled, to the reference's.
    t_reference_estimate: Pose
    #: What was compared, if it was asked for.
    pairs: PosePairs | None = None


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class RelationMetrics(Value):
    """How well a trajectory agrees with motions that were checked by hand."""

    num_relations: int
    #: Relations that the trajectory has no poses for.
    num_missed: int
    translation_m: ErrorStatistics
    rotation_deg: ErrorStatistics
    #: Of those relations over more than a minute.
    num_loops: int
    loop_translation_m: ErrorStatistics | None
    loop_rotation_deg: ErrorStatistics | None


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class LabelledBox(Value):
    """A box with a class, for judging detections."""

    object_class: ObjectClass | str
    #: In a frame that all boxes share.
    box: OrientedBox
    #: Detections only.
    confidence: float = 0.0


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class DetectionMetrics(Value):
    """How good a set of detections is."""

    true_positives: int
    false_positives: int
    false_negatives: int
    #: 0 to 1.
    precision: float
    #: 0 to 1.
    recall: float
    #: Intersection over union of the pairs, 0 to 1.
    mean_iou: float
    #: Share of the pairs with the right class, 0 to 1.
    class_accuracy: float
