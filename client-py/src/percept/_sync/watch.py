# Written by client-py/generate from _async/watch.py; change that.
"""Streams of events out."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Sequence
from types import TracebackType
from typing import Any, Generic, TypeVar

import grpc

from .. import _rpc
from .._access import Access
from .._convert import navigation, sessions
from .._options import LOOK_S, MOMENT_S, MOST_MOVES, Patience, backoff, link_broke, wait_before_retry
from ..errors import PerceptError, Unauthenticated, client_closed, error_of_rpc
from ..types.navigation import PathUpdate
from ..types.sessions import FleetEvent, FleetEventKind, SessionEvent
from ..v1 import navigation_service_pb2, sessions_service_pb2
from . import _runtime as runtime
from .transport import Transport

#: Header in which the server tells the token of its newest event when it takes a watch up.
RESUME_TOKEN = "percept-resume-token"
#: A watch that held so long was well.
STEADY_S = 5.0

E = TypeVar("E")
W = TypeVar("W", bound="Events[Any]")


class Events(ABC, Generic[E]):
    """A stream of events that goes on by itself: `for` within `with`, from whose beginning on
    nothing is missed.

    `token` belongs to the newest event: watch(resume_token=token) goes on after it.
    """

    def __init__(self, transport: Transport, resume_token: int | None, resume_timeout_s: float) -> None:
        self.token = resume_token
        self._transport = transport
        self._patience = Patience(resume_timeout_s)
        self._closed = runtime.Signal()
        self._has_begun = False
        #: When the server answered the call, if it did.
        self._answered_s: float | None = None
        self._subscribe()
        runtime.begin_now(self._begin)

    def __iter__(self: W) -> W:
        return self

    def __next__(self) -> E:
        self._begin()
        while not self._closed.is_set():
            answer, error = self._next()
            if error is not None:
                self._recover(error)
            elif answer is runtime.EOF:
                break
            else:
                self.token = self._token_of(answer)
                self._patience.renew()
                return self._read(answer)
        raise StopIteration

    def close(self) -> None:
        """Ends the watch."""
        self._closed.set()
        self._call.cancel()

    def __enter__(self: W) -> W:
        try:
            self._begin()
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @abstractmethod
    def _call_from(self, token: int | None, server: Access) -> Any:  # noqa: ANN401
        """A call that watches from a token on."""

    def _token_of(self, answer: Any) -> int:  # noqa: ANN401
        """What a call goes on from after that answer."""
        token: int = answer.event.token
        return token

    @abstractmethod
    def _read(self, answer: Any) -> E:  # noqa: ANN401
        """The event of an answer."""

    def _subscribe(self) -> None:
        self._answered_s, self._ahead = None, None
        self._server, self._authorization = self._transport.here, self._transport.authorization
        self._call = self._call_from(self.token, self._server)
        if self._closed.is_set():
            # Meanwhile, by somebody else.
            self._call.cancel()

    def _begin(self) -> None:
        """Waits until the server watches, so that nothing that happens from now on is missed. Until then it
        is a call as any, tried again as often and as long."""
        if self._has_begun:
            return
        options = self._transport.options
        deadline, waits = time.monotonic() + options.timeout_s, backoff(options.retries)
        moves_left = MOST_MOVES
        self._greet()
        while self.token is None and runtime.is_over(self._call, MOMENT_S):
            answer, error = self._next()
            if error is None:
                self._ahead = answer
                break
            moved = self._follow(error)
            if error.server and moved and moves_left > 0:
                moves_left -= 1
            else:
                wait = wait_before_retry(error, waits, moved=moved)
                if wait is None or time.monotonic() + wait > deadline:
                    raise error
                self._pause(wait)
            self._subscribe()
            self._greet()
        self._has_begun = True

    def _greet(self) -> None:
        """Waits for the call's headers, and goes on from the token in them if there is none yet."""
        headers = self._call.initial_metadata()
        self._answered_s = time.monotonic()
        for name, value in headers or ():
            if name == RESUME_TOKEN and self.token is None and value.isdecimal():
                self.token = int(value)

    def _next(self) -> tuple[Any, PerceptError | None]:
        """The next answer, or what broke the call; EOF when it was closed here."""
        if self._ahead is not None:
            answer, self._ahead = self._ahead, None
            return answer, None
        error: PerceptError
        try:
            if self._answered_s is None:
                self._greet()
            return runtime.next_of(self._call), None
        except grpc.RpcError as cause:
            error = error_of_rpc(cause, self._server.target)
        except runtime.Cancelled:
            ours = self._closed.is_set() or self._transport.link.closed
            if not ours or runtime.is_cancelled():
                raise
            error = client_closed()
        if self._closed.is_set():
            return runtime.EOF, None
        return None, client_closed() if self._transport.link.closed else error

    def _follow(self, error: PerceptError) -> bool:
        """Whether another server is the one to ask after that."""
        return self._transport.after(self._server, error).target != self._server.target

    def _recover(self, error: PerceptError) -> None:
        """Calls again once that is worthwhile; raises if it is not, or not any more."""
        moved = self._follow(error)
        renewed = isinstance(error, Unauthenticated) and self._transport.authorization != self._authorization
        if self.token is None or self._transport.link.closed or not (renewed or link_broke(error)):
            raise error
        if self._answered_s is not None and time.monotonic() - self._answered_s > STEADY_S:
            self._patience.renew()
        wait = self._patience.wait(error, moved=moved)
        if wait is None:
            # Whoever reads on all the same has it tried as long again.
            self._patience.renew()
            raise error
        self._pause(wait)
        if not self._closed.is_set():
            self._subscribe()

    def _pause(self, seconds: float) -> None:
        """Waits before the next call, or until the watch or its client is closed."""
        until = time.monotonic() + seconds
        while not self._transport.link.closed and (left := until - time.monotonic()) > 0:
            if self._closed.wait(min(left, LOOK_S)):
                return


class Watch(Events[SessionEvent]):
    """Events of a session: `for` within `with`, from whose beginning on nothing is missed.

    When the link breaks or the server stops it goes on by itself once the server is back, with a Resync where
    events are missing. It ends when the session is deleted, or it was closed.
    """

    def __init__(
        self,
        transport: Transport,
        request: sessions_service_pb2.WatchSessionRequest,
        resume_token: int | None,
        resume_timeout_s: float,
    ) -> None:
        self._request = request
        super().__init__(transport, resume_token, resume_timeout_s)

    def _call_from(self, token: int | None, server: Access) -> Any:  # noqa: ANN401
        request = sessions_service_pb2.WatchSessionRequest()
        request.CopyFrom(self._request)
        if token is not None:
            request.resume_token = token
        return self._transport.subscribe(_rpc.WATCH_SESSION, request, server)

    def _read(self, answer: Any) -> SessionEvent:  # noqa: ANN401
        return sessions.event(answer.event)


class PathWatch(Events[PathUpdate]):
    """A path that is kept: `for` within `with`. The first answer comes at once, others when the
    map breaks the path or a clearly better one opens.

    When the link breaks it goes on by itself, beginning with what holds then. It ends when the session is
    deleted, or it was closed.
    """

    def __init__(
        self,
        transport: Transport,
        request: navigation_service_pb2.WatchPathRequest,
        resume_timeout_s: float,
    ) -> None:
        self._wanted = request
        super().__init__(transport, None, resume_timeout_s)

    def _call_from(self, token: int | None, server: Access) -> Any:  # noqa: ANN401
        return self._transport.subscribe(_rpc.WATCH_PATH, self._wanted, server)

    def _token_of(self, answer: Any) -> int:  # noqa: ANN401
        return 0

    def _read(self, answer: Any) -> PathUpdate:  # noqa: ANN401
        return navigation.update(answer)


class FleetWatch(Events[FleetEvent]):
    """Events of all sessions of a server: `for` within `with`, from whose beginning on nothing is
    missed. It goes on by itself as a session's does."""

    def __init__(
        self,
        transport: Transport,
        pattern: str,
        kinds: Sequence[FleetEventKind | str],
        resume_token: int | None,
        resume_timeout_s: float,
    ) -> None:
        self._wanted = sessions.watch_sessions(pattern, kinds, None)
        super().__init__(transport, resume_token, resume_timeout_s)

    def _call_from(self, token: int | None, server: Access) -> Any:  # noqa: ANN401
        request = sessions_service_pb2.WatchSessionsRequest()
        request.CopyFrom(self._wanted)
        if token is not None:
            request.resume_token = token
        return self._transport.subscribe(_rpc.WATCH_SESSIONS, request, server)

    def _read(self, answer: Any) -> FleetEvent:  # noqa: ANN401
        return sessions.fleet_event(answer.event)
