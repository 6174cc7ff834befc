# Written by client-py/generate from _async/stream.py; change that.
"""Streams of frames in."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from types import TracebackType
from typing import Any

import grpc

from .. import _rpc
from .._options import LOOK_S, MOMENT_S, Patience, link_broke
from .._sender import FrameSender
from .._stream_state import Connection, StreamState
from ..errors import (
    DeadlineExceeded,
    FailedPrecondition,
    PerceptError,
    StreamBroken,
    Unauthenticated,
    Unavailable,
    client_closed,
    error_of_rpc,
)
from ..types.frames import SensorFrame
from ..types.sensors import FrameAck, StreamSummary
from . import _runtime as runtime
from .transport import Transport


class FrameStream(FrameSender[None]):
    """Sends frames without waiting for each.

        with session.stream() as stream:
            for stamp_ns, depth in camera:
                stream.send_depth("camera", stamp_ns=stamp_ns, depth=depth, metres_per_unit=0.001)
        print(stream.summary)

    A refused frame does not end the stream: it is an acknowledgement with a `rejection`. `send` waits while
    the window is full, and raises what ended the stream. Leaving the block waits until all is acknowledged
    and durable. A link that breaks is mended: see `Session.stream`.
    """

    def __init__(
        self,
        transport: Transport,
        session_id: str,
        *,
        max_in_flight: int,
        resume: bool,
        resume_timeout_s: float,
        buffer_bytes: int,
    ) -> None:
        self._transport = transport
        self._timeout_s = transport.options.timeout_s
        self._max_in_flight = max_in_flight
        self._resume_timeout_s = resume_timeout_s
        self._patience = Patience(resume_timeout_s)
        self._buffer_bytes = buffer_bytes
        self._state = StreamState(session_id, resume=resume)
        self._changed = runtime.Changed()
        self._writing = runtime.Lock()
        self._closing = False
        self._cancelled = False
        #: The link is gone, and waited for.
        self._resuming = False
        #: No room for more until what was sent is durable.
        self._crowded = False
        self._call: Any = None
        #: To which the newest connection was made.
        self._server = transport.here
        self._task = runtime.Task(self._run, "percept-stream")

    def send(self, frame: SensorFrame) -> None:
        """Sends a frame; waits while the window is full."""
        state = self._state
        # One at a time, so that the order of calls is the order of frames.
        with self._writing:
            data = state.encoded(frame)
            with self._changed:
                self._wait(lambda: self._closing or self._has_room(data))
                if self._closing:
                    raise FailedPrecondition("the stream is closed; open another", reason="STREAM_CLOSED")
                if state.ended:
                    raise self._ended_early()
                state.add(frame, data)
                self._changed.notify_all()

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
        return self._state.summary()

    def close(self) -> StreamSummary:
        """Says that no more comes, waits for the last acknowledgement."""
        state = self._state
        with self._changed:
            self._closing = True
            self._changed.notify_all()
            self._wait(lambda: state.ended)
        if state.in_flight or (state.error and state.unsafe):
            raise self._ended_early()
        return state.summary()

    def cancel(self) -> None:
        """Ends the stream at once; frames in flight may or may not have been taken."""
        with self._changed:
            self._closing = self._cancelled = True
            self._changed.notify_all()
        if self._call is not None:
            self._call.cancel()
        self._task.join()

    def __enter__(self) -> FrameStream:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None and not self._closing:
            try:
                self.close()
            except BaseException:
                self.cancel()
                raise
        elif kind is not None or not self._state.ended:
            self.cancel()

    def _has_room(self, data: bytes) -> bool:
        state = self._state
        fits = not state.resume or state.fits(data, self._buffer_bytes)
        if not fits and not self._crowded:
            # What is durable is told with acknowledgements; with none under way, at a connection's end.
            self._crowded = True
            self._changed.notify_all()
        # Sensors do not wait for a server that is away, as long as the buffer holds what they see.
        return fits and (self._resuming or state.in_flight < self._max_in_flight)

    def _run(self) -> None:
        """One connection after another, until the stream ends; work of its own."""
        state = self._state
        try:
            self._carry()
        except PerceptError as error:
            state.error = error
        except runtime.Cancelled:
            # By us, or with its loop.
            pass
        finally:
            state.ended = True
            with self._changed:
                self._changed.notify_all()

    def _carry(self) -> None:
        state = self._state
        known = (0, 0)
        while self._has_work():
            token = self._transport.authorization
            error = self._connect()
            if self._cancelled or (self._closing and not state.unsafe):
                return
            if self._transport.link.closed:
                raise client_closed() from error
            if error is None and not state.resume:
                return
            if error is None and not state.unsafe:
                self._patience.renew()
                continue
            # What is answered a second time moves nothing.
            if known != (state.answered, state.durable):
                known = state.answered, state.durable
                self._patience.renew()
            error = error or Unavailable("the server did not make all frames durable", reason="STREAM_ENDED")
            renewed = isinstance(error, Unauthenticated) and self._transport.authorization != token
            moved = self._transport.after(self._server, error).target != self._server.target
            if not state.resume or not (renewed or self._may_go_on(error)):
                raise error
            wait = self._patience.wait(error, moved=moved)
            if wait is None:
                raise StreamBroken(
                    error, sent=state.sent, durable=state.durable, tried_s=self._resume_timeout_s
                ) from error
            if not state.unsafe:
                # A link that is not needed may be gone for as long as it likes.
                self._patience.renew()
            self._pause(wait)

    def _may_go_on(self, error: PerceptError) -> bool:
        """Whether it is worthwhile to connect again."""
        if error is self._state.turned_away:
            return not isinstance(error, Unauthenticated)
        return link_broke(error)

    def _has_work(self) -> bool:
        """Waits until something is to be sent; False at the end."""
        state = self._state
        with self._changed:
            while not (state.unsafe or self._closing):
                self._changed.wait()
            return state.unsafe and not self._cancelled

    def _connect(self) -> PerceptError | None:
        """One connection from its beginning to its end; what broke it."""
        state = self._state
        with self._changed:
            connection = state.connect()
            self._crowded = False
        self._server = self._transport.here
        outgoing = self._outgoing(connection)
        self._call = self._transport.bidi(_rpc.STREAM_FRAMES, outgoing, self._server)
        try:
            if self._cancelled:
                self._call.cancel()
            # Answered as soon as the server has taken the stream up; a failure shows with the first answer.
            self._call.initial_metadata()
            is_refused = runtime.is_over(self._call, 0.0)
            with self._changed:
                self._resuming, connection.taken_up = False, not is_refused
                self._changed.notify_all()
            for answer in self._call:
                with self._changed:
                    state.answer(connection, answer)
                    self._changed.notify_all()
        except grpc.RpcError as cause:
            return self._error_of(cause)
        except PerceptError as turned_away:
            self._call.cancel()
            return turned_away
        except runtime.Cancelled:
            if self._cancelled or not self._transport.link.closed or runtime.is_cancelled():
                raise
            return client_closed()
        finally:
            with self._changed:
                connection.closed = True
                self._changed.notify_all()
        if connection.complete:
            return None
        return Unavailable(
            f"the server ended the stream after {state.answered} of {state.sent} acknowledgements",
            reason="STREAM_ENDED",
        )

    def _outgoing(self, connection: Connection) -> Iterator[bytes]:
        """What a connection sends."""
        # In grpc.aio a refusal that meets a frame on its way loses what it says.
        until = time.monotonic() + MOMENT_S
        with self._changed:
            while not (connection.taken_up or connection.closed) and (left := until - time.monotonic()) > 0:
                self._changed.wait(left)
        while True:
            with self._changed:
                while not (connection.closed or self._may_write(connection) or self._is_over(connection)):
                    self._changed.wait()
                if connection.closed:
                    return
                if not self._may_write(connection):
                    connection.finished = True
                    return
                data = self._state.write(connection)
            yield data

    def _may_write(self, connection: Connection) -> bool:
        return bool(connection.to_write) and len(connection.unanswered) < self._max_in_flight

    def _is_over(self, connection: Connection) -> bool:
        return (self._closing or self._crowded) and not connection.to_write

    def _pause(self, seconds: float) -> None:
        """Waits before the next connection, or until the stream is cancelled or the client closed."""
        until = time.monotonic() + seconds
        with self._changed:
            self._resuming = True
            self._changed.notify_all()
            while not (self._cancelled or self._transport.link.closed) and time.monotonic() < until:
                # The link gives no word when it is closed.
                self._changed.wait(min(max(until - time.monotonic(), 0.0), LOOK_S))

    def _error_of(self, cause: grpc.RpcError) -> PerceptError:
        error = error_of_rpc(cause, self._server.target)
        # When a write meets the end of the call, grpc.aio may put an error of its own in place of the
        # server's, which would have had a reason.
        if error.code == "INTERNAL" and not error.reason:
            return Unavailable("the server ended the stream", reason="STREAM_ENDED")
        return error

    def _wait(self, ready: Callable[[], bool]) -> None:
        """Waits under the lock until ready, for as long as something comes back, or the link is awaited."""
        state = self._state
        since, seen = time.monotonic(), (state.progress, self._resuming)
        while not (ready() or state.error or state.ended):
            if seen != (state.progress, self._resuming):
                since, seen = time.monotonic(), (state.progress, self._resuming)
            # A link that is awaited is given up in _carry, unless a connection gets no word at all.
            patience = self._timeout_s + (self._resume_timeout_s if self._resuming else 0.0)
            left = since + patience - time.monotonic()
            if left <= 0:
                message = f"no acknowledgement for {patience:g} s with {state.in_flight} frames in flight"
                raise DeadlineExceeded(message, reason="STREAM_STALLED")
            self._changed.wait(left)
        if state.error and not ready():
            raise state.error

    def _ended_early(self) -> Exception:
        state = self._state
        if state.error:
            return state.error
        message = f"the server ended the stream after {state.answered} of {state.sent} acknowledgements"
        return Unavailable(message, reason="STREAM_ENDED")
