"""Sessions: poses, trajectories, keyframes, events."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from .._optional import needed
from ._show import png
from ._value import Name, Value
from .geometry import Floats, Pose, rotation_matrices
from .maps import Loop
from .navigation import Zone, ZoneMask
from .poses import PoseEstimate, Scale, TrackingState
from .recordings import Recording
from .scene import ObjectChange
from .sensors import SensorStatus, StreamNote


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


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class SessionFault(Value):
    """Why a session was set apart."""

    #: Stable, upper-case.
    reason: str
    #: What happened, for people.
    message: str


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class SessionInfo(Value):
    """A session as it was when asked. One that sleeps has the numbers with which it fell asleep."""

    _columns = (
        "session_id",
        "display_name",
        "state",
        "mode",
        "num_keyframes",
        "num_objects",
        "map_version",
        "last_stamp_ns",
    )

    #: Its name.
    session_id: str
    #: For people; empty if none was given.
    display_name: str
    mode: SessionMode
    #: By the server's clock.
    create_time_ns: int
    #: Every parameter in force, nested; None in lists.
    params: Mapping[str, object] | None = field(repr=False)
    #: None are told in lists.
    sensors: tuple[SensorStatus, ...]
    #: None before the first frame, and while it sleeps.
    pose: PoseEstimate | None
    #: Keyframes of its map.
    num_keyframes: int
    #: Objects that are tracked.
    num_objects: int
    #: Grows with each change of the map.
    map_version: int
    #: Frames that wait to be processed.
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
    #: Areas that every path through its map keeps to; empty in lists.
    zones: tuple[Zone, ...]
    #: The same cell by cell, without the cells; empty in lists.
    zone_masks: tuple[ZoneMask, ...]
    #: What is to be said of streams that are no sensors of it; empty in lists.
    stream_notes: tuple[StreamNote, ...]
    #: Whether the frames that it takes are recorded.
    recorded: bool
    #: Its newest recording since the server began; None if there is none.
    recording: Recording | None


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
    #: Of the map whose corrections are in it.
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

    def to_pandas(self) -> Any:  # noqa: ANN401
        """A pandas.DataFrame with a row a frame: stamp_ns, x_m, y_m, z_m, qx, qy, qz, qw (base in map),
        state, keyframe_id (missing where it became none), scale. ImportError without pandas."""
        pandas = needed("pandas", "to_pandas()", "pandas")
        numbers = np.hstack([self.positions, self.rotations])
        names = ("x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")
        return pandas.DataFrame(
            {
                "stamp_ns": self.stamps_ns,
                **dict(zip(names, numbers.T, strict=True)),
                "state": [str(state) for state in self.states],
                "keyframe_id": pandas.array(self.keyframe_ids, dtype="Int64"),
                "scale": [str(scale) for scale in self.scales],
            }
        )

    def _repr_png_(self) -> bytes | None:
        return png(lambda plot: plot.trajectory(self))

    def __len__(self) -> int:
        return len(self.stamps_ns)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Keyframe(Value):
    """A frame kept by SLAM."""

    keyframe_id: int
    stamp_ns: int
    sensor_id: str
    #: Base in map, with all corrections so far.
    t_map_base: Pose
    #: Of its scan.
    num_points: int


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class MapChanged(Value):
    """The map has a new version."""

    #: The new one.
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
