"""Metrics against ground truth."""

from __future__ import annotations

from dataclasses import dataclass

from ._value import Name, Value
from .geometry import OrientedBox
from .scene import ObjectClass


class TrajectoryAlignment(Name):
    """How the estimate is laid over the reference."""

    SE3 = "se3"
    SIM3 = "sim3"
    NONE = "none"


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class ErrorStatistics(Value):
    """Summary of a list of errors."""

    rmse: float
    mean: float
    median: float
    std: float
    min: float
    max: float


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class TrajectoryMetrics(Value):
    """How good a trajectory is."""

    num_pairs: int
    ate_m: ErrorStatistics
    #: Over one frame.
    rpe_trans_m: ErrorStatistics
    #: Over one frame, degrees.
    rpe_rot_deg: ErrorStatistics
    path_length_m: float
    drift_percent: float
    scale: float


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class LabelledBox(Value):
    """A box with a class, for judging detections."""

    object_class: ObjectClass | str
    box: OrientedBox
    #: Detections only.
    confidence: float = 0.0


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class DetectionMetrics(Value):
    """How good a set of detections is."""

    true_positives: int
    false_positives: int
    false_negatives: int
    precision: float
    recall: float
    mean_iou: float
    class_accuracy: float
