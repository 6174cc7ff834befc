"""Sessions: poses, trajectories, keyframes, events."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
import numpy.typing as npt

from ._value import Name, Value
from .geometry import Floats, Pose, rotation_matrices
from .maps import Loop
from .scene import ObjectChange

if TYPE_CHECKING:
    from .sensors import SensorStatus


class SessionMode(Name):
    """What a session does with its frames."""

    UNSPECIFIED = "unspecified"
    MAPPING = "mapping"
    INGEST_ONLY = "ingest_only"


class SessionState(Name):
    """Where a session is in its life."""

    UNSPECIFIED = "unspecified"
    CREATING = "creating"
    #: Stored, not in memory. The first frame or question wakes it.
    ASLEEP = "asleep"
    WAKING = "waking"
    AWAKE = "awake"
    #: Set apart: what of it is whole can be read, frames are refused.
    FAULTED = "faulted"
    DELETING = "deleting"


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

    stamp_ns: int
    state: TrackingState
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
    rmse_m: float
    #: Axes of base (x, y, z, rotation x, y, z) that the surroundings do not fix.
    degenerate_axes: tuple[bool, ...]
    map_version: int
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
    #: The second sensor that measured this pose, because the one that moves it is silent or sees nothing;
    #: None if that one did.
    led_by: str | None

    @property
    def lost(self) -> bool:
        """Whether the pose is a mere prediction."""
        return self.state == TrackingState.LOST


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class PoseAt(Value):
    """Where the robot was at a time, as the map has it now: between two frames."""

    #: As asked for.
    stamp_ns: int
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
    keyframe_id: int | None
    latency_s: float
    #: The frame had been taken in before; nothing was done with it this time.
    duplicate: bool


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class SessionFault(Value):
    """Why a session was set apart."""

    #: Stable, upper-case.
    reason: str
    message: str


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class SessionInfo(Value):
    """A session as it was when asked. One that sleeps has the numbers with which it fell asleep."""

    session_id: str
    display_name: str
    mode: SessionMode
    create_time_ns: int
    #: Every parameter in force, nested; None in lists.
    params: Mapping[str, object] | None = field(repr=False)
    #: None are told in lists.
    sensors: tuple[SensorStatus, ...]
    #: None before the first frame, and while it sleeps.
    pose: PoseEstimate | None
    num_keyframes: int
    num_objects: int
    map_version: int
    queue_length: int
    state: SessionState
    #: None unless it is faulted.
    fault: SessionFault | None
    #: By the server's clock; its start if it was not used since.
    last_used_ns: int
    #: Stamp of the newest frame that moved the pose; None before the first.
    last_stamp_ns: int | None
    #: Whose it is.
    tenant: str
    #: For programs; lists are filtered by them.
    labels: Mapping[str, str]
    #: Names this state of what callers set, for `update`; frames do not change it.
    etag: str


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Trajectory(Value):
    """The registered frames in order of time, with all corrections so far."""

    #: (N,) int64.
    stamps_ns: npt.NDArray[np.int64]
    #: Base in map, metres, (N, 3) float64.
    positions: Floats
    #: x, y, z, w, (N, 4) float64.
    rotations: Floats
    states: tuple[TrackingState, ...]
    #: Number of the keyframe that a frame became.
    keyframe_ids: tuple[int | None, ...]
    #: Unknown: in a unit of its own, and not moved by corrections.
    scales: tuple[Scale, ...]
    map_version: int
    #: Where the next page starts; empty on the last one.
    next_page_token: str = field(default="", repr=False)

    @property
    def t_map_base(self) -> Floats:
        """(N, 4, 4) float64."""
        out = np.tile(np.eye(4), (len(self), 1, 1))
        out[:, :3, :3] = rotation_matrices(self.rotations)
        out[:, :3, 3] = self.positions
        return out

    @property
    def length_m(self) -> float:
        """Length of the path."""
        return float(np.linalg.norm(np.diff(self.positions, axis=0), axis=1).sum())

    def __len__(self) -> int:
        return len(self.stamps_ns)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Keyframe(Value):
    """A frame kept by SLAM."""

    keyframe_id: int
    stamp_ns: int
    sensor_id: str
    t_map_base: Pose
    num_points: int


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class MapChanged(Value):
    """The map has a new version."""

    map_version: int


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Resync(Value):
    """Events were lost: read the state anew."""

    #: How many, 0 if unknown.
    missed: int


Event: TypeAlias = PoseEstimate | Keyframe | ObjectChange | Loop | MapChanged | Resync


class FleetEventKind(Name):
    """Kinds of events, for watching all sessions."""

    UNSPECIFIED = "unspecified"
    POSE = "pose"
    KEYFRAME = "keyframe"
    OBJECT = "object"
    LOOP = "loop"
    MAP = "map"
    #: Created, woken, put to sleep, set apart, deleted.
    LIFE = "life"
    #: Name, labels, parameters or sensors were changed.
    SETTINGS = "settings"


class LifeStep(Name):
    """A step in a session's life."""

    UNSPECIFIED = "unspecified"
    CREATED = "created"
    #: The state is another now.
    MOVED = "moved"
    DELETED = "deleted"


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class SessionLife(Value):
    """A session came, went, or is in another state."""

    step: LifeStep
    #: Unspecified unless moved.
    state: SessionState


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class SessionUpdated(Value):
    """What callers set of a session was changed."""

    #: The new one.
    etag: str


AnyEvent: TypeAlias = Event | SessionLife | SessionUpdated


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class FleetEvent(Value):
    """Something that happened in one of the sessions of a server."""

    #: Give it to watch() to go on after this event.
    token: int
    #: Empty with a Resync that is about all sessions.
    session_id: str
    #: Stamp of the frame that caused it; 0 if none did.
    stamp_ns: int
    #: None for kinds that this client does not know.
    event: AnyEvent | None


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class SessionEvent(Value):
    """Something that happened in a session."""

    #: Give it to watch() to go on after this event.
    token: int
    #: Stamp of the frame that caused it.
    stamp_ns: int
    #: None for kinds that this client does not know.
    event: Event | None
