"""Recordings: what a session is sent and its poses, as MCAP files on the server."""

from __future__ import annotations

from dataclasses import dataclass

from ._value import Name, Value


class RecordingState(Name):
    """Where a recording is in its life."""

    UNSPECIFIED = "unspecified"
    #: The session's next frame begins it.
    WAITING = "waiting"
    RUNNING = "running"
    #: It takes nothing more; what waits is still being written.
    ENDING = "ending"
    #: Its files are not written any more.
    ENDED = "ended"


class RecordingEnd(Name):
    """Why a recording ended."""

    #: It has not.
    UNSPECIFIED = "unspecified"
    STOPPED = "stopped"
    #: The session fell asleep; if it is recorded still, its next frame begins another.
    SLEPT = "slept"
    #: Make room, then start it again.
    DISK_FULL = "disk_full"
    #: The server's log has the cause.
    FAILED = "failed"


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class RecordingDrops(Value):
    """Frames and poses that a recording lacks, by why."""

    #: The disk was slower than the sensors.
    num_too_slow: int
    #: What waits of all sessions of the server took all that it may.
    num_no_shared_room: int
    #: ROS 2's messages cannot say them.
    num_unwritable: int
    #: Why the first of those could not be said.
    unwritable_message: str
    #: They came after the disk was full or had refused.
    num_after_end: int


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Recording(Value):
    """How a recording stood when asked."""

    _columns = ("recording_id", "state", "end", "num_frames", "num_bytes", "num_files")

    #: Milliseconds since 1970 when it was begun, by the server's clock.
    recording_id: str
    #: Below the server's folder of recordings: TENANT/SESSION/ID.
    folder: str
    state: RecordingState
    #: Unspecified before it ends.
    end: RecordingEnd
    #: `end` in words, with a remedy; empty before.
    end_message: str
    #: By the server's clock.
    start_time_ns: int
    #: Frames in the files.
    num_frames: int
    num_bytes: int
    num_files: int
    #: What is not in the files.
    dropped: RecordingDrops


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class RecordedFile(Value):
    """A file of a recording."""

    name: str
    num_bytes: int


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class StoredRecording(Value):
    """What there is of a recording in the server's folder."""

    _columns = ("recording_id", "num_files", "num_bytes", "last_write_time_ns", "open")

    #: Milliseconds since 1970 when it was begun, by the server's clock.
    recording_id: str
    num_bytes: int
    num_files: int
    #: The first 100 of them, in their order.
    files: tuple[RecordedFile, ...]
    #: By the server's clock; None if there are no files.
    last_write_time_ns: int | None
    #: It has not ended: stop it before it is deleted.
    open: bool
