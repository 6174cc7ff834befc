"""Streams of frames in, and of events out; blocking."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable, Iterator
from types import TracebackType
from typing import Any

import grpc

from . import _rpc
from ._convert import sessions
from ._sender import FrameSender
from ._stream_state import StreamState
from ._transport import Transport
from ._transport_options import backoff
from .errors import DeadlineExceeded, FailedPrecondition, Unavailable, error_of_rpc
from .types.frames import SensorFrame
from .types.sensors import FrameAck, StreamSummary
from .types.sessions import SessionEvent
from .v1 import sensors_service_pb2 as service
from .v1 import sessions_service_pb2


class FrameStream(FrameSender[None]):
    """Sends frames without waiting for each, at most `max_in_flight` ahead of their acknowledgements.

        with session.stream() as stream:
            for stamp_ns, depth in camera:
                stream.send_depth("camera", stamp_ns=stamp_ns, depth=depth, metres_per_unit=0.001)
        print(stream.summary)

    A refused frame does not end the stream: it is an acknowledgement with a `rejection`. `send` waits while
    the window is full, and raises what ended the stream. Leaving the block waits until all is acknowledged.
    """

    def __init__(self, transport: Transport, session_id: str, max_in_flight: int) -> None:
        self._timeout_s = transport.options.timeout_s
        self._max_in_flight = max_in_flight
        self._state = StreamState(session_id)
        self._changed = threading.Condition()
        self._requests: queue.SimpleQueue[service.StreamFramesRequest | None] = queue.SimpleQueue()
        self._closing = False
        self._call = transport.bidi(_rpc.STREAM_FRAMES, self._outgoing())
        self._reader = threading.Thread(target=self._read, name="percept-acks", daemon=True)
        self._reader.start()

    def send(self, frame: SensorFrame) -> None:
        """Sends a frame; waits while the window is full."""
        state = self._state
        with self._changed:
            self._wait(lambda: state.in_flight < self._max_in_flight)
            if self._closing:
                raise FailedPrecondition("the stream is closed; open another", reason="STREAM_CLOSED")
            if state.ended:
                raise self._ended_early()
            self._requests.put(state.message(frame))
            state.sent += 1

    def acks(self) -> Iterator[FrameAck]:
        """Acknowledgements not yet read, in the order of sending; ends when none is outstanding.

        Those that nobody reads are kept up to 4096, then the oldest go; `summary` counts them all.
        """
        state = self._state
        while True:
            with self._changed:
                self._wait(lambda: bool(state.unread) or state.in_flight == 0)
                if not state.unread:
                    return
                ack = state.unread.popleft()
            yield ack

    @property
    def summary(self) -> StreamSummary:
        """What became of the stream so far."""
        with self._changed:
            return self._state.summary()

    def close(self) -> StreamSummary:
        """Says that no more comes, waits for the last acknowledgement."""
        self._closing = True
        self._requests.put(None)
        with self._changed:
            self._wait(lambda: self._state.ended)
            if self._state.in_flight:
                raise self._ended_early()
            return self._state.summary()

    def cancel(self) -> None:
        """Ends the stream at once; frames in flight may or may not have been taken."""
        self._closing = True
        self._requests.put(None)
        self._call.cancel()
        self._reader.join()

    def __enter__(self) -> FrameStream:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is not None:
            self.cancel()
        elif not self._closing:
            self.close()

    def _outgoing(self) -> Iterator[service.StreamFramesRequest]:
        return iter(self._requests.get, None)

    def _read(self) -> None:
        try:
            for answer in self._call:
                with self._changed:
                    self._state.answer(answer)
                    self._changed.notify_all()
        except grpc.RpcError as cause:
            with self._changed:
                self._state.error = error_of_rpc(cause)
        finally:
            with self._changed:
                self._state.ended = True
                self._changed.notify_all()
            self._requests.put(None)

    def _wait(self, ready: Callable[[], bool]) -> None:
        """Waits under the lock until ready, for as long as acknowledgements keep coming."""
        state = self._state
        while not (ready() or state.error or state.ended):
            answered = state.answered
            if not self._changed.wait(self._timeout_s) and state.answered == answered:
                message = (
                    f"no acknowledgement for {self._timeout_s:g} s with {state.in_flight} frames in flight"
                )
                raise DeadlineExceeded(message, reason="STREAM_STALLED")
        if state.error and not ready():
            raise state.error

    def _ended_early(self) -> Exception:
        state = self._state
        if state.error:
            return state.error
        message = f"the server ended the stream after {state.answered} of {state.sent} acknowledgements"
        return Unavailable(message, reason="STREAM_ENDED")


class Watch:
    """Events of a session, as an iterator; a context manager.

    When the link breaks or the server stops it goes on by itself once the server is back, with a Resync where
    events are missing. It ends when the session is deleted.

    `token` belongs to the newest event: watch(resume_token=token) goes on after it.
    """

    def __init__(self, transport: Transport, session_id: str, resume_token: int | None) -> None:
        self.token = resume_token
        self._transport = transport
        self._session_id = session_id
        self._closed = False
        self._waits = backoff(transport.options.retries)
        self._call: Any = self._subscribe()
        # Answered as soon as the server watches: nothing that happens from now on is missed.
        self._call.initial_metadata()

    def __iter__(self) -> Watch:
        return self

    def __next__(self) -> SessionEvent:
        while not self._closed:
            try:
                event = sessions.event(next(self._call).event)
            except grpc.RpcError as cause:
                self._recover(cause)
                continue
            self.token = event.token
            self._waits = backoff(self._transport.options.retries)
            return event
        raise StopIteration

    def close(self) -> None:
        """Ends the watch, from any thread."""
        self._closed = True
        self._call.cancel()

    def __enter__(self) -> Watch:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _subscribe(self) -> Any:  # noqa: ANN401
        request = sessions_service_pb2.WatchSessionRequest(
            session_id=self._session_id, resume_token=self.token
        )
        return self._transport.subscribe(_rpc.WATCH_SESSION, request)

    def _recover(self, cause: grpc.RpcError) -> None:
        if self._closed:
            return
        error = error_of_rpc(cause)
        wait = next(self._waits, None)
        if not isinstance(error, Unavailable) or self.token is None or wait is None:
            raise error from cause
        time.sleep(wait)
        self._call = self._subscribe()
