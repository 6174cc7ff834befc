"""Recordings of sessions."""

from __future__ import annotations

from .. import _rpc
from .._call import Call, PagedCall
from ..types.recordings import (
    RecordedFile,
    Recording,
    RecordingDrops,
    RecordingEnd,
    RecordingState,
    StoredRecording,
)
from ..v1 import recording_pb2
from ..v1 import sessions_service_pb2 as service
from . import words


def recording(message: recording_pb2.Recording) -> Recording:
    """How one stands."""
    return Recording(
        recording_id=message.recording_id,
        folder=message.folder,
        state=words.word(RecordingState, recording_pb2.RecordingState, message.state),
        end=words.word(RecordingEnd, recording_pb2.RecordingEnd, message.end),
        end_message=message.end_message,
        start_time_ns=message.start_time_ns,
        num_frames=message.num_frames,
        num_bytes=message.num_bytes,
        num_files=message.num_files,
        dropped=RecordingDrops(
            num_too_slow=message.dropped.num_too_slow,
            num_no_shared_room=message.dropped.num_no_shared_room,
            num_unwritable=message.dropped.num_unwritable,
            unwritable_message=message.dropped.unwritable_message,
            num_after_end=message.dropped.num_after_end,
        ),
    )


def stored(message: recording_pb2.StoredRecording) -> StoredRecording:
    """What there is of one."""
    return StoredRecording(
        recording_id=message.recording_id,
        num_bytes=message.num_bytes,
        num_files=message.num_files,
        files=tuple(RecordedFile(name=f.name, num_bytes=f.num_bytes) for f in message.files),
        last_write_time_ns=message.last_write_time_ns if message.HasField("last_write_time_ns") else None,
        open=message.open,
    )


def start(
    session_id: str,
) -> Call[service.StartRecordingRequest, service.StartRecordingResponse, Recording]:
    request = service.StartRecordingRequest(session_id=session_id)
    return Call(_rpc.START_RECORDING, request, lambda a: recording(a.recording))


def stop(
    session_id: str,
) -> Call[service.StopRecordingRequest, service.StopRecordingResponse, Recording | None]:
    request = service.StopRecordingRequest(session_id=session_id)
    return Call(
        _rpc.STOP_RECORDING, request, lambda a: recording(a.recording) if a.HasField("recording") else None
    )


def list_recordings(
    session_id: str, page_size: int
) -> PagedCall[service.ListRecordingsRequest, service.ListRecordingsResponse, StoredRecording]:
    request = service.ListRecordingsRequest(session_id=session_id, page_size=page_size)
    return PagedCall(_rpc.LIST_RECORDINGS, request, lambda a: [stored(r) for r in a.recordings])


def delete(
    session_id: str, recording_id: str
) -> Call[service.DeleteRecordingRequest, service.DeleteRecordingResponse, None]:
    request = service.DeleteRecordingRequest(session_id=session_id, recording_id=recording_id)
    return Call(_rpc.DELETE_RECORDING, request, lambda _: None)
