"""Streams of frames in, and of events out; for asyncio. The twin of stream.py."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from types import TracebackType
from typing import Any

import grpc

from . import _rpc
from ._aio_transport import AsyncTransport
from ._convert import sessions
from ._sender import FrameSender
from ._stream_state import StreamState
from ._transport_options import backoff
from .errors import DeadlineExceeded, FailedPrecondition, Internal, PerceptError, Unavailable, error_of_rpc
from .types.frames import SensorFrame
from .types.sensors import FrameAck, StreamSummary
from .types.sessions import SessionEvent
from .v1 import sessions_service_pb2


class AsyncFrameStream(FrameSender[Awaitable[None]]):
    """As FrameStream; `async with`, and every `send_*` is awaited."""

    def __init__(self, transport: AsyncTransport, session_id: str, max_in_flight: int) -> None:
        self._timeout_s = transport.options.timeout_s
        self._max_in_flight = max_in_flight
        self._state = StreamState(session_id)
        self._changed = asyncio.Condition()
        self._writing = asyncio.Lock()
        self._closing = False
        self._call = transport.bidi(_rpc.STREAM_FRAMES)
        self._reader = asyncio.create_task(self._read())

    async def send(self, frame: SensorFrame) -> None:
        """Sends a frame; waits while the window is full."""
        state = self._state
        # One writer at a time, so that the order of calls is the order of frames.
        async with self._writing:
            async with self._changed:
                await self._wait(lambda: state.in_flight < self._max_in_flight)
                if self._closing:
                    raise FailedPrecondition("the stream is closed; open another", reason="STREAM_CLOSED")
                if state.ended:
                    raise self._ended_early()
                message = state.message(frame)
                state.sent += 1
            try:
                await self._call.write(message)
            except (grpc.RpcError, asyncio.InvalidStateError) as cause:
                await asyncio.wait([self._reader], timeout=self._timeout_s)
                raise self._ended_early() from cause

    async def acks(self) -> AsyncIterator[FrameAck]:
        """Acknowledgements not yet read, in the order of sending; ends when none is outstanding."""
        state = self._state
        while True:
            async with self._changed:
                await self._wait(lambda: bool(state.unread) or state.in_flight == 0)
                if not state.unread:
                    return
                ack = state.unread.popleft()
            yield ack

    @property
    def summary(self) -> StreamSummary:
        """What became of the stream so far."""
        return self._state.summary()

    async def close(self) -> StreamSummary:
        """Says that no more comes, waits for the last acknowledgement."""
        self._closing = True
        if not self._state.ended:
            await self._call.done_writing()
        async with self._changed:
            await self._wait(lambda: self._state.ended)
        if self._state.in_flight:
            raise self._ended_early()
        return self._state.summary()

    async def cancel(self) -> None:
        """Ends the stream at once; frames in flight may or may not have been taken."""
        self._closing = True
        self._call.cancel()
        await asyncio.wait([self._reader])

    async def __aenter__(self) -> AsyncFrameStream:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is not None:
            await self.cancel()
        elif not self._closing:
            await self.close()

    async def _read(self) -> None:
        try:
            async for answer in self._call:
                async with self._changed:
                    self._state.answer(answer)
                    self._changed.notify_all()
        except grpc.RpcError as cause:
            self._state.error = self._error_of(cause)
        except asyncio.CancelledError:
            # The call was cancelled, by us or with its channel.
            pass
        finally:
            self._state.ended = True
            async with self._changed:
                self._changed.notify_all()

    @staticmethod
    def _error_of(cause: grpc.RpcError) -> PerceptError:
        error = error_of_rpc(cause)
        # When a write meets the end of the call, grpc.aio may put an error of its own in place of the
        # server's, which would have had a reason.
        if isinstance(error, Internal) and not error.reason:
            return Unavailable("the server ended the stream", reason="STREAM_ENDED")
        return error

    async def _wait(self, ready: Callable[[], bool]) -> None:
        """Waits under the lock until ready, for as long as acknowledgements keep coming."""
        state = self._state
        while not (ready() or state.error or state.ended):
            answered = state.answered
            try:
                await asyncio.wait_for(self._changed.wait(), self._timeout_s)
            except asyncio.TimeoutError:
                if state.answered != answered:
                    continue
                message = (
                    f"no acknowledgement for {self._timeout_s:g} s with {state.in_flight} frames in flight"
                )
                raise DeadlineExceeded(message, reason="STREAM_STALLED") from None
        if state.error and not ready():
            raise state.error

    def _ended_early(self) -> Exception:
        state = self._state
        if state.error:
            return state.error
        message = f"the server ended the stream after {state.answered} of {state.sent} acknowledgements"
        return Unavailable(message, reason="STREAM_ENDED")


class AsyncWatch:
    """As Watch; `async with` and `async for`. It watches from the entry of the block on."""

    def __init__(self, transport: AsyncTransport, session_id: str, resume_token: int | None) -> None:
        self.token = resume_token
        self._transport = transport
        self._session_id = session_id
        self._closed = False
        self._waits = backoff(transport.options.retries)
        self._call: Any = None

    def __aiter__(self) -> AsyncWatch:
        return self

    async def __anext__(self) -> SessionEvent:
        while not self._closed:
            self._call = self._call or self._subscribe()
            try:
                answer = await self._call.read()
            except grpc.RpcError as cause:
                await self._recover(cause)
                continue
            if answer is grpc.aio.EOF:
                break
            event = sessions.event(answer.event)
            self.token = event.token
            self._waits = backoff(self._transport.options.retries)
            return event
        raise StopAsyncIteration

    def close(self) -> None:
        """Ends the watch."""
        self._closed = True
        if self._call is not None:
            self._call.cancel()

    async def __aenter__(self) -> AsyncWatch:
        self._call = self._subscribe()
        # Answered as soon as the server watches: nothing that happens from now on is missed.
        await self._call.initial_metadata()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _subscribe(self) -> Any:  # noqa: ANN401
        request = sessions_service_pb2.WatchSessionRequest(
            session_id=self._session_id, resume_token=self.token
        )
        return self._transport.subscribe(_rpc.WATCH_SESSION, request)

    async def _recover(self, cause: grpc.RpcError) -> None:
        if self._closed:
            return
        error = error_of_rpc(cause)
        wait = next(self._waits, None)
        if not isinstance(error, Unavailable) or self.token is None or wait is None:
            raise error from cause
        await asyncio.sleep(wait)
        self._call = self._subscribe()
