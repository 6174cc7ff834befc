# Written by client-py/generate from _async/watch.py; change that.
"""Streams of events out."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from types import TracebackType
from typing import Any, Generic, TypeVar

import grpc

from .. import _rpc
from .._convert import sessions
from .._options import backoff, wait_before_retry
from ..errors import error_of_rpc
from ..types.sessions import FleetEvent, FleetEventKind, SessionEvent
from ..v1 import sessions_service_pb2
from . import _runtime as runtime
from .transport import Transport

E = TypeVar("E")
W = TypeVar("W", bound="Events[Any]")


class Events(ABC, Generic[E]):
    """A stream of events that goes on by itself: `for` within `with`, from whose beginning on
    nothing is missed.

    `token` belongs to the newest event: watch(resume_token=token) goes on after it.
    """

    def __init__(self, transport: Transport, resume_token: int | None) -> None:
        self.token = resume_token
        self._transport = transport
        self._closed = False
        self._waits = backoff(transport.options.retries)
        self._call: Any = self._subscribe()
        runtime.begun(self._call)

    def __iter__(self: W) -> W:
        return self

    def __next__(self) -> E:
        while not self._closed:
            try:
                answer = runtime.next_of(self._call)
            except grpc.RpcError as cause:
                self._recover(cause)
                continue
            if answer is runtime.EOF:
                break
            self.token = answer.event.token
            self._waits = backoff(self._transport.options.retries)
            return self._read(answer)
        raise StopIteration

    def close(self) -> None:
        """Ends the watch."""
        self._closed = True
        self._call.cancel()

    def __enter__(self: W) -> W:
        # Answered as soon as the server watches: nothing that happens from now on is missed.
        self._call.initial_metadata()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @abstractmethod
    def _subscribe(self) -> Any:  # noqa: ANN401
        """Begins the call."""

    @abstractmethod
    def _read(self, answer: Any) -> E:  # noqa: ANN401
        """The event of an answer."""

    def _recover(self, cause: grpc.RpcError) -> None:
        if self._closed:
            return
        error = error_of_rpc(cause)
        self._transport.moved(error)
        wait = wait_before_retry(error, self._waits)
        if wait is None or self.token is None:
            raise error from cause
        runtime.sleep(wait)
        self._call = self._subscribe()


class Watch(Events[SessionEvent]):
    """Events of a session: `for` within `with`, from whose beginning on nothing is missed.

    When the link breaks or the server stops it goes on by itself once the server is back, with a Resync where
    events are missing. It ends when the session is deleted.
    """

    def __init__(self, transport: Transport, session_id: str, resume_token: int | None) -> None:
        self._session_id = session_id
        super().__init__(transport, resume_token)

    def _subscribe(self) -> Any:  # noqa: ANN401
        request = sessions_service_pb2.WatchSessionRequest(
            session_id=self._session_id, resume_token=self.token
        )
        return self._transport.subscribe(_rpc.WATCH_SESSION, request)

    def _read(self, answer: Any) -> SessionEvent:  # noqa: ANN401
        return sessions.event(answer.event)


class FleetWatch(Events[FleetEvent]):
    """Events of all sessions of a server: `for` within `with`, from whose beginning on nothing is
    missed. It goes on by itself as a session's does."""

    def __init__(
        self,
        transport: Transport,
        pattern: str,
        kinds: Sequence[FleetEventKind | str],
        resume_token: int | None,
    ) -> None:
        self._wanted = sessions.watch_sessions(pattern, kinds, None)
        super().__init__(transport, resume_token)

    def _subscribe(self) -> Any:  # noqa: ANN401
        request = sessions_service_pb2.WatchSessionsRequest()
        request.CopyFrom(self._wanted)
        if self.token is not None:
            request.resume_token = self.token
        return self._transport.subscribe(_rpc.WATCH_SESSIONS, request)

    def _read(self, answer: Any) -> FleetEvent:  # noqa: ANN401
        return sessions.fleet_event(answer.event)
