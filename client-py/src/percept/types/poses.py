"""Where a robot is, and what a frame did."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ._show import flat, table
from ._value import Name, Value
from .geometry import Floats, Pose


class TrackingState(Name):
    """Whether a pose can be trusted."""

    UNSPECIFIED = "unspecified"
    INITIALISING = "initialising"
    TRACKING = "tracking"
    LOST = "lost"


class Scale(Name):
    """Whether lengths are metres. One camera alone does not tell."""

    UNSPECIFIED = "unspecified"
    #: Positions are in a unit of their own, and no map is built.
    UNKNOWN = "unknown"
    METRIC = "metric"


class LostReason(Name):
    """Why a frame could not be placed; `lost_message` says what to do."""

    #: Not lost.
    UNSPECIFIED = "unspecified"
    TOO_FEW_POINTS = "too_few_points"
    TOO_FEW_CORRESPONDENCES = "too_few_correspondences"
    RESIDUAL_TOO_LARGE = "residual_too_large"
    MOTION_TOO_LARGE = "motion_too_large"
    DEGENERATE = "degenerate"
    TIME_GAP = "time_gap"
    UNSUITABLE_SCAN = "unsuitable_scan"
    NO_TEXTURE = "no_texture"
    BAD_EXPOSURE = "bad_exposure"
    INTRINSICS_MISMATCH = "intrinsics_mismatch"
    #: Nothing ties this place to the map yet.
    ADRIFT = "adrift"


class ScaleSource(Name):
    """What tells that lengths are metres."""

    UNSPECIFIED = "unspecified"
    NONE = "none"
    #: It measures lengths itself.
    SENSOR = "sensor"
    ODOMETRY = "odometry"
    DEPTH = "depth"
    BASELINE = "baseline"


class WaitingFor(Name):
    """What an odometry that needs several frames to begin is waiting for."""

    #: Nothing.
    UNSPECIFIED = "unspecified"
    SECOND_VIEW = "second_view"
    PARALLAX = "parallax"
    MATCHES = "matches"


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class PoseEstimate(Value):
    """Where the robot is, how sure we are, or that we are lost."""

    #: Of the frame.
    stamp_ns: int
    state: TrackingState
    #: Base in map, metres; moved by corrections. Where lost: a prediction.
    t_map_base: Pose
    #: Of a right perturbation in base, (6, 6): x, y, z, rotation x, y, z.
    covariance: Floats
    #: Continuous, never corrected.
    t_odom_base: Pose
    #: Unspecified unless lost.
    lost_reason: LostReason
    #: The same in words, with a remedy; empty unless lost.
    lost_message: str
    #: Share of the frame's points that fit the local model, 0 to 1.
    inlier_ratio: float
    #: Root mean square residual of those, metres.
    rmse_m: float
    #: Axes of base (x, y, z, rotation x, y, z) that the surroundings do not fix.
    degenerate_axes: tuple[bool, ...]
    map_version: int
    #: Unknown: positions are in a unit of their own, and no path begins there.
    scale: Scale
    scale_source: ScaleSource
    #: The same in words, or what would tell the scale.
    scale_message: str
    #: Unspecified unless initialising.
    waiting_for: WaitingFor
    #: The same in words, with a remedy.
    waiting_message: str
    #: The robot was lost, and this frame found it again.
    relocalised: bool
    #: The robot was found here, and may be in another place that looks alike: nothing that it sees enters the
    #: map until other surroundings agree. Where they contradict the map it is lost again.
    tentative: bool
    #: The second sensor that measured this pose, because the one that moves it is silent or sees nothing;
    #: None if that one did.
    led_by: str | None

    def _repr_html_(self) -> str:
        sigmas = np.sqrt(np.abs(np.diag(self.covariance)))
        row = {
            "state": self.state,
            **flat(self.t_map_base),
            "sigma_xy_m": float(np.hypot(*sigmas[:2])),
            "sigma_yaw_rad": float(sigmas[5]),
            "scale": self.scale,
            "stamp_ns": self.stamp_ns,
        }
        words = self.lost_message or self.waiting_message
        return table([row], caption="t_map_base" + (f": {words}" if words else ""))

    @property
    def lost(self) -> bool:
        """Whether the pose is a mere prediction. A camera alone whose scale is unknown is not lost: see
        `scale`."""
        return self.state == TrackingState.LOST


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class PoseAt(Value):
    """Where the robot was at a time, as the map has it now: between two frames."""

    #: As asked for.
    stamp_ns: int
    #: Base in map, between the two frames.
    t_map_base: Pose
    #: Continuous, never corrected; None if the scale is unknown.
    t_odom_base: Pose | None
    #: Lost if one of the two frames was: the pose is a guess then.
    state: TrackingState
    scale: Scale
    #: Stamp of the frame before, or at, that time.
    before_ns: int
    #: Stamp of the frame after, or at, that time.
    after_ns: int
    map_version: int

    @property
    def gap_s(self) -> float:
        """Time between the two frames: the longer, the less is known of what lies between."""
        return (self.after_ns - self.before_ns) / 1e9


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Transform(Value):
    """Where one frame is, seen from another."""

    target_frame: str
    source_frame: str
    #: Source coordinates to target coordinates.
    t_target_source: Pose
    #: None if it holds for all times: between base and sensors.
    stamp_ns: int | None
    #: Lost: a guess; unspecified if it holds for all times.
    state: TrackingState
    #: Unspecified if it holds for all times.
    scale: Scale
    map_version: int


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class FrameResult(Value):
    """What an accepted frame did."""

    #: None for sensors that do not move the pose, and in ingest_only.
    pose: PoseEstimate | None
    #: Number of the keyframe that it became; None if it became none.
    keyframe_id: int | None
    #: In the queue and in the pipeline, seconds.
    latency_s: float
    #: The frame had been taken in before; nothing was done with it this time.
    duplicate: bool
