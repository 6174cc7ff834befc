"""Sensors: their declarations and what the server sees of their streams."""

from __future__ import annotations

import re
from dataclasses import dataclass, field

import numpy as np

from .._arrays import number
from ..errors import InvalidArgument, WrongType
from ._value import Name, Value, one_of
from .geometry import CameraIntrinsics, Pose, as_pose
from .poses import FrameResult


class SensorKind(Name):
    """What a sensor measures."""

    UNSPECIFIED = "unspecified"
    DEPTH = "depth"
    RGBD = "rgbd"
    CAMERA = "camera"
    LIDAR3D = "lidar3d"
    LIDAR2D = "lidar2d"
    IMU = "imu"
    ODOMETRY = "odometry"


class OverloadPolicy(Name):
    """What to do when frames come faster than they are processed; gRPC streams always block."""

    UNSPECIFIED = "unspecified"
    BLOCK = "block"
    DROP_OLDEST = "drop_oldest"


@dataclass(frozen=True, eq=False, repr=False)
class SensorSpec(Value):
    """A sensor of a session. Checked when made, by the server's rules: raises InvalidArgument, which is a
    ValueError, with field, value and remedy."""

    #: Unique in its session: 1 to 64 characters of a-z A-Z 0-9 _ -.
    sensor_id: str
    kind: SensorKind | str = field(kw_only=True)
    #: Sensor (optical frame for cameras: z forward, x right) to base, at most 10 km away; a pose or its
    #: (4, 4) matrix.
    t_base_sensor: Pose = field(default_factory=Pose, kw_only=True)
    #: Required for depth, rgbd and camera.
    intrinsics: CameraIntrinsics | None = field(default=None, kw_only=True)
    #: Finite, seconds to add to this sensor's stamps to get the session's clock.
    time_offset_s: float = field(default=0.0, kw_only=True)
    #: How far it sees, metres, above 0 and at most 10000; the preset "auto" of a session that is created
    #: with it goes by that.
    range_max_m: float | None = field(default=None, kw_only=True)
    #: Left unspecified, zenoh drops the oldest.
    overload_policy: OverloadPolicy | str = field(default=OverloadPolicy.UNSPECIFIED, kw_only=True)

    def __post_init__(self) -> None:
        is_word = isinstance(self.sensor_id, str) and re.fullmatch(r"[a-zA-Z0-9_-]{1,64}", self.sensor_id)
        if not is_word:
            message = f"sensor_id is {self.sensor_id!r:.80}; use 1 to 64 characters of a-z A-Z 0-9 _ -"
            raise InvalidArgument(message, reason="ID_INVALID", field="sensor_id")
        one_of("kind", self.kind, SensorKind)
        one_of("overload_policy", self.overload_policy, OverloadPolicy, or_unspecified=True)
        self._check_mount()
        self._check_intrinsics()
        number("time_offset_s", self.time_offset_s, must="a finite number of seconds")
        if self.range_max_m is not None:
            must = "above 0 and at most 10000 m; send metres, or leave it out"
            number("range_max_m", self.range_max_m, low=0, high=1e4, must=must)

    def _check_mount(self) -> None:
        mount = as_pose("t_base_sensor", self.t_base_sensor)
        object.__setattr__(self, "t_base_sensor", mount)
        for value in (*mount.translation.tolist(), *mount.rotation.tolist()):
            number("t_base_sensor", value, must="finite")
        norm = float(np.linalg.norm(mount.rotation))
        if abs(norm - 1) > 1e-3:
            message = f"t_base_sensor has a quaternion of norm {norm:.6g}; normalise it (order x, y, z, w)"
            raise InvalidArgument(message, reason="QUATERNION_NOT_UNIT", field="t_base_sensor")
        for value in np.abs(mount.translation).tolist():
            must = "at most 10 km from base; send metres"
            number("t_base_sensor.translation", value, high=1e4, must=must)

    def _check_intrinsics(self) -> None:
        lens = self.intrinsics
        if lens is None and str(self.kind).lower() in ("depth", "rgbd", "camera"):
            message = f"intrinsics is missing; a sensor of kind {self.kind} needs CameraIntrinsics"
            raise InvalidArgument(message, reason="FIELD_MISSING", field="intrinsics")
        if not (lens is None or isinstance(lens, CameraIntrinsics)):
            message = f"intrinsics is {lens!r}; give CameraIntrinsics(width_px=, height_px=, fx_px=, ...)"
            raise WrongType(message, reason="ARGUMENT_INVALID", field="intrinsics")


class StreamVerdict(Name):
    """How a sensor's stream fares."""

    UNSPECIFIED = "unspecified"
    NO_FRAME = "no_frame"
    GOOD = "good"
    #: `troubles` says what is wrong.
    TROUBLED = "troubled"


class StreamTroubleKind(Name):
    """What may be wrong with a sensor's stream."""

    UNSPECIFIED = "unspecified"
    REJECTED = "rejected"
    DROPPED = "dropped"
    GAPS = "gaps"
    CLOCK_OFFSET = "clock_offset"
    MOUNT_OFFSET = "mount_offset"
    #: An IMU is not used: its samples do not cover the time between frames.
    SAMPLES_MISSING = "samples_missing"
    #: An IMU's forces are not used: their mean is not as large as gravity.
    FORCE_UNLIKE_GRAVITY = "force_unlike_gravity"
    #: An IMU is not used: it turns otherwise than the robot.
    TURNS_UNLIKE = "turns_unlike"
    #: An IMU is not used: frames are predicted better without it.
    MISLEADING = "misleading"
    #: No pose comes of the session's sensors.
    NO_POSE = "no_pose"
    #: Nothing comes any more, though other sensors go on.
    SILENT = "silent"
    #: Its stamps are ahead of the server's clock.
    CLOCK_AHEAD = "clock_ahead"
    #: Its distances are in another unit than metres.
    RANGE_UNIT = "range_unit"
    #: Hardly any beam or pixel measures something.
    SEES_LITTLE = "sees_little"
    #: A camera's mount is that of a body frame: it would look straight up.
    OPTICAL_FRAME = "optical_frame"
    #: A camera's intrinsics are hardly those of its images.
    INTRINSICS = "intrinsics"
    #: Wheels tell another motion than the pose sensor sees.
    WHEELS_UNLIKE = "wheels_unlike"
    #: Its stamps are in another unit than nanoseconds.
    STAMP_UNIT = "stamp_unit"
    #: Its mount is farther from the robot's base than any robot reaches.
    MOUNT_FAR = "mount_far"
    #: Its stamps are far from those of another sensor that come at the same time.
    CLOCK_APART = "clock_apart"
    #: Most returns of a planar lidar stand alone, as from dust or rain.
    STRAY_RETURNS = "stray_returns"


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class StreamTrouble(Value):
    """Something that is wrong with a sensor's stream."""

    kind: StreamTroubleKind
    #: With figures and remedy, for an operator.
    message: str


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Refusal(Value):
    """Frames that were refused for one reason."""

    #: As errors have it: STAMP_NOT_INCREASING.
    reason: str
    count: int
    #: What the newest of them was told.
    message: str


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class StreamFigures(Value):
    """How a stream has come in of late: its newest 50 frames. None where too few came, or there is none."""

    #: Mean rate of arrival by the server's clock, hertz.
    arrival_rate_hz: float | None
    #: Standard deviation of the times between stamps, seconds.
    jitter_s: float | None
    #: Longest time between two stamps, seconds.
    longest_interval_s: float | None
    #: From stamp to arrival by the server's clock, median, seconds; negative if the sensor's clock is ahead.
    delay_s: float | None
    #: Since the newest frame came, seconds.
    quiet_s: float | None
    #: Bytes of a frame, mean, packing aside.
    frame_bytes: float | None
    #: From arrival until a frame was worked in, waiting included, seconds: median and 95th percentile.
    latency_p50_s: float | None
    latency_p95_s: float | None
    #: Share of beams or pixels that measured something, mean, 0 to 1.
    measured_ratio: float | None
    #: Median distance measured, metres.
    median_range_m: float | None


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class StreamNote(Value):
    """What is to be said of a stream that is no sensor, or not as it came: a topic that is not used."""

    stream: str
    #: In words, for an operator.
    message: str
    #: Server's clock, nanoseconds since the Unix epoch.
    time_ns: int


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class SensorStatus(Value):
    """What the server sees of a sensor's stream."""

    _columns = (
        "spec_sensor_id",
        "spec_kind",
        "accepted",
        "rejected",
        "dropped",
        "gaps",
        "rate_hz",
        "verdict",
        "verdict_message",
    )

    spec: SensorSpec
    #: Frames taken since the session was created.
    accepted: int
    #: Frames refused as bad input.
    rejected: int
    #: Frames dropped because the queue was full (DROP_OLDEST).
    dropped: int
    #: Numbers missing in the sender's sequence.
    gaps: int
    #: Mean rate over the last frames, hertz; None before two.
    rate_hz: float | None
    #: Newest accepted frame; None before the first.
    last_stamp_ns: int | None
    verdict: StreamVerdict
    #: Empty unless troubled.
    troubles: tuple[StreamTrouble, ...]
    #: Verdict and troubles in words, for an operator.
    verdict_message: str
    #: Names this state of `spec`, for `sensors.update`.
    etag: str
    #: Seconds by which its stamps are late behind the pose sensor's, beyond time_offset_s; None until known.
    clock_offset_s: float | None
    #: The newest frames in figures.
    figures: StreamFigures
    #: Why frames were refused, the most frequent reason first.
    refusals: tuple[Refusal, ...]


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Rejection(Value):
    """Why a frame was refused; the session is unharmed."""

    #: Stable, upper-case.
    reason: str
    #: Field, value and remedy.
    message: str
    #: The offending field, or empty.
    field: str
    #: Name of the gRPC code.
    code: str


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class FrameAck(Value):
    """What became of one frame of a stream: `result`, or `rejection`; neither, if it was taken in over a link
    that broke before the answer came."""

    sensor_id: str
    #: The sender's running number for this sensor; 0: not numbered.
    sequence: int
    stamp_ns: int
    result: FrameResult | None
    rejection: Rejection | None
    #: So many of the stream's first frames survive a crash.
    durable_count: int

    @property
    def accepted(self) -> bool:
        """Whether the frame was taken."""
        return self.rejection is None


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class StreamSummary(Value):
    """What became of a stream."""

    #: Frames that were handed over.
    sent: int
    #: Of them, frames that were taken.
    accepted: int
    #: Of them, frames that were refused.
    rejected: int
    #: So many of the first frames survive a crash.
    durable: int
    #: The first rejections, 100 at most.
    rejections: tuple[FrameAck, ...]


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class ClockOffset(Value):
    """Server's clock against this machine's (Cristian 1989)."""

    #: Add it to this machine's nanoseconds to get the server's.
    offset_ns: int
    #: The offset is right within half of it.
    round_trip_ns: int
