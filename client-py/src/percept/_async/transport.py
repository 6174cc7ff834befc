"""Carries calls over a gRPC channel: deadlines, headers, retries, errors as our own."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from typing import Any, TypeVar

import grpc

from .._access import Access
from .._call import Call, ChunkedCall, PagedCall, StreamedCall
from .._options import (
    HEALTH_PATH,
    HEALTH_REQUEST,
    HEALTH_S,
    MOST_MOVES,
    Metadata,
    Options,
    backoff,
    channel_options,
    is_away,
    is_serving,
    wait_before_retry,
)
from .._parts import joined
from .._rpc import A, Q, Rpc
from ..errors import PerceptError, client_closed, error_of_rpc
from . import _runtime as runtime
from .pages import AsyncPages

T = TypeVar("T")


class AsyncLink:
    """Channels to the servers of a store, mostly one, shared by all that ask over them."""

    def __init__(self, accesses: tuple[Access, ...], server_name: str | None) -> None:
        self.access = accesses[0]
        #: The server that is asked for all that is nowhere in particular.
        self.here = self.access
        self._closed = runtime.Signal()
        self._known = accesses
        self._options = channel_options(server_name)
        self._opening = threading.Lock()
        self._channels: dict[str, Any] = {}
        self.channel(self.access)

    @property
    def closed(self) -> bool:
        """Whether its client was closed."""
        return self._closed.is_set()

    def channel(self, access: Access) -> Any:  # noqa: ANN401
        """The channel to a server; raises once the link is closed."""
        with self._opening:
            if self.closed:
                raise client_closed()
            if access.target not in self._channels:
                self._channels[access.target] = runtime.open_channel(access, self._options)
            return self._channels[access.target]

    async def pause(self, seconds: float) -> None:
        """Waits before another try, or until the link is closed."""
        await self._closed.wait(seconds)

    def next(self, here: Access, error: PerceptError) -> Access:
        """Where to ask after a server answered so, or did not answer."""
        if error.server:
            return here.at(error.server) or here
        if not is_away(error):
            return here
        targets = [access.target for access in self._known]
        at = targets.index(here.target) + 1 if here.target in targets else 0
        return self._known[at % len(targets)]

    def leave(self, server: Access, following: Access) -> None:
        """Asks another server from now on, unless somebody was quicker."""
        if self.here.target == server.target:
            self.here = following

    async def close(self) -> None:
        """Ends all calls."""
        with self._opening:
            self._closed.set()
            channels = list(self._channels.values())
        for channel in channels:
            await channel.close()


class AsyncTransport:
    """Calls over a link, made as the options say."""

    def __init__(
        self, link: AsyncLink, options: Options, *, found: Access | None = None, follows: bool = False
    ) -> None:
        self.link = link
        self.options = options
        #: The server that was told to have the session.
        self._found = found
        self._follows = follows

    def following(self) -> AsyncTransport:
        """The same for one session, which is asked for where it was found last."""
        return AsyncTransport(self.link, self.options, found=self._found, follows=True)

    @property
    def here(self) -> Access:
        """The server that is asked next."""
        return self._found or self.link.here

    def after(self, server: Access, error: PerceptError) -> Access:
        """Where to ask after a server answered so, or did not answer; later calls ask there, too."""
        following = self.link.next(server, error)
        # Others who share this may have gone on meanwhile, and know better.
        if error.server:
            # A session moves alone.
            if self._follows and self.here.target == server.target:
                self._found = following
            return following
        if self._found is not None and self._found.target == server.target:
            self._found = following
        self.link.leave(server, following)
        return following

    def with_options(
        self,
        timeout_s: float | None,
        retries: int | None,
        metadata: Mapping[str, str | bytes] | None,
    ) -> AsyncTransport:
        """The same link with other options."""
        options = self.options.but(timeout_s, retries, metadata)
        return AsyncTransport(self.link, options, found=self._found, follows=self._follows)

    @property
    def authorization(self) -> str | None:
        """What calls made now say about who asks."""
        token = self.link.access.token
        return None if token is None else token.header()

    async def call(self, call: Call[Q, A, T]) -> T:
        """One answer, in one message or in parts."""
        if call.rpc.in_parts:
            return await self.chunks(
                ChunkedCall(call.rpc, call.request, lambda parts: call.read(joined(parts)))
            )

        async def attempt(server: Access, timeout_s: float) -> A:
            method = self._method("unary_unary", call.rpc, server)
            answer: A = await method(call.request, timeout=timeout_s, metadata=self._metadata())
            return answer

        return call.read(await self._tried(call.rpc.repeatable, attempt))

    async def chunks(self, call: ChunkedCall[Q, A, T]) -> T:
        """An answer in chunks, tried again as a whole."""

        async def attempt(server: Access, timeout_s: float) -> list[A]:
            method = self._method("unary_stream", call.rpc, server)
            answers = method(call.request, timeout=timeout_s, metadata=self._metadata())
            return [answer async for answer in answers]

        return call.read(await self._tried(call.rpc.repeatable, attempt))

    async def parts(self, call: StreamedCall[Q, A, T]) -> T:
        """A request in parts; one answer."""

        async def attempt(server: Access, timeout_s: float) -> A:
            method = self._method("stream_unary", call.rpc, server)
            answer: A = await method(call.parts(), timeout=timeout_s, metadata=self._metadata())
            return answer

        return call.read(await self._tried(False, attempt))

    def pages(self, call: PagedCall[Q, A, T]) -> AsyncPages[T]:
        """The elements of all pages, asked for as they are used."""
        return AsyncPages(self._elements(call))

    async def _elements(self, call: PagedCall[Q, A, T]) -> AsyncIterator[T]:
        request: Any = type(call.request)()
        request.CopyFrom(call.request)

        async def attempt(server: Access, timeout_s: float) -> Any:  # noqa: ANN401
            method = self._method("unary_unary", call.rpc, server)
            return await method(request, timeout=timeout_s, metadata=self._metadata())

        while True:
            answer = await self._tried(True, attempt)
            for element in call.read(answer):
                yield element
            if not answer.next_page_token:
                return
            request.page_token = answer.next_page_token

    def subscribe(self, rpc: Rpc[Q, A], request: Q, server: Access) -> Any:  # noqa: ANN401
        """A stream of answers without an end; its failures come as grpc.RpcError."""
        method = self._method("unary_stream", rpc, server)
        return self._begun(lambda: method(request, metadata=self._metadata()))

    def bidi(self, rpc: Rpc[Q, A], requests: AsyncIterator[bytes], server: Access) -> Any:  # noqa: ANN401
        """A stream both ways, of requests that are bytes already; its failures come as grpc.RpcError."""
        channel = self.link.channel(server)
        method = channel.stream_stream(rpc.path, response_deserializer=rpc.answer.FromString)
        return self._begun(lambda: method(requests, metadata=self._metadata()))

    async def serving(self) -> bool:
        """Whether the server says that it serves; False if it cannot be reached."""

        async def attempt(server: Access, timeout_s: float) -> bytes:
            check = self.link.channel(server).unary_unary(HEALTH_PATH)
            answer: bytes = await check(HEALTH_REQUEST, timeout=timeout_s, metadata=self._metadata())
            return answer

        try:
            return is_serving(await self._tried(False, attempt, HEALTH_S))
        except PerceptError:
            if self.link.closed:
                raise
            return False

    def _method(self, kind: str, rpc: Rpc[Q, A], server: Access) -> Any:  # noqa: ANN401
        return getattr(self.link.channel(server), kind)(
            rpc.path,
            request_serializer=rpc.request.SerializeToString,
            response_deserializer=rpc.answer.FromString,
        )

    def _begun(self, begin: Callable[[], Any]) -> Any:  # noqa: ANN401
        try:
            return begin()
        except runtime.ChannelClosed:
            if not self.link.closed:
                raise
            raise client_closed() from None

    def _metadata(self) -> Metadata:
        said, authorization = self.options.metadata, self.authorization
        return said if authorization is None else (*said, ("authorization", authorization))

    async def _tried(
        self, repeatable: bool, attempt: Callable[[Access, float], Awaitable[T]], most_s: float = math.inf
    ) -> T:
        """One deadline over all tries."""
        deadline = time.monotonic() + min(self.options.timeout_s, most_s)
        waits = backoff(self.options.retries if repeatable else 0)
        server, moves_left = self.here, MOST_MOVES
        while True:
            try:
                return await attempt(server, max(deadline - time.monotonic(), 0.001))
            except grpc.RpcError as cause:
                error = error_of_rpc(cause, server.target)
                if self.link.closed and error.code == "CANCELLED":
                    raise client_closed() from None
                before, server = server, self.after(server, error)
                moved = server.target != before.target
                if error.server and moved and moves_left > 0:
                    # Nothing was done where the session is not: it is asked for elsewhere at once.
                    moves_left -= 1
                    continue
                wait = wait_before_retry(error, waits, moved=moved)
                if wait is None or time.monotonic() + wait > deadline:
                    # What gRPC said is in it; its own words before it are a page that helps nobody.
                    raise error from None
            except (runtime.Cancelled, runtime.ChannelClosed):
                if not self.link.closed or runtime.is_cancelled():
                    raise
                raise client_closed() from None
            await self.link.pause(wait)
