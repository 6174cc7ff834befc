"""Carries calls over a gRPC channel: deadlines, headers, retries, errors as our own."""

from __future__ import annotations

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
    Metadata,
    Options,
    backoff,
    channel_options,
    is_serving,
    wait_before_retry,
)
from .._parts import joined
from .._rpc import A, Q, Rpc
from ..errors import error_of_rpc
from . import _runtime as runtime

T = TypeVar("T")


class AsyncLink:
    """A channel to one server, shared by all that ask over it."""

    def __init__(self, access: Access, server_name: str | None) -> None:
        self.access = access
        self.closed = False
        self.channel = runtime.open_channel(access, channel_options(server_name))

    async def close(self) -> None:
        """Ends all calls."""
        self.closed = True
        await self.channel.close()


class AsyncTransport:
    """Calls over a link, made as the options say."""

    def __init__(self, link: AsyncLink, options: Options) -> None:
        self.link = link
        self.options = options

    def with_options(
        self,
        timeout_s: float | None,
        retries: int | None,
        metadata: Mapping[str, str | bytes] | None,
    ) -> AsyncTransport:
        """The same link with other options."""
        return AsyncTransport(self.link, self.options.but(timeout_s, retries, metadata))

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
        method = self._method("unary_unary", call.rpc)

        async def attempt(timeout_s: float) -> A:
            answer: A = await method(call.request, timeout=timeout_s, metadata=self._metadata())
            return answer

        return call.read(await self._tried(call.rpc.repeatable, attempt))

    async def chunks(self, call: ChunkedCall[Q, A, T]) -> T:
        """An answer in chunks, tried again as a whole."""
        method = self._method("unary_stream", call.rpc)

        async def attempt(timeout_s: float) -> list[A]:
            answers = method(call.request, timeout=timeout_s, metadata=self._metadata())
            return [answer async for answer in answers]

        return call.read(await self._tried(call.rpc.repeatable, attempt))

    async def parts(self, call: StreamedCall[Q, A, T]) -> T:
        """A request in parts; one answer."""
        method = self._method("stream_unary", call.rpc)

        async def attempt(timeout_s: float) -> A:
            answer: A = await method(call.parts(), timeout=timeout_s, metadata=self._metadata())
            return answer

        return call.read(await self._tried(False, attempt))

    async def pages(self, call: PagedCall[Q, A, T]) -> AsyncIterator[T]:
        """The elements of all pages, asked for as they are used."""
        method = self._method("unary_unary", call.rpc)
        request: Any = type(call.request)()
        request.CopyFrom(call.request)

        async def attempt(timeout_s: float) -> Any:  # noqa: ANN401
            return await method(request, timeout=timeout_s, metadata=self._metadata())

        while True:
            answer = await self._tried(True, attempt)
            for element in call.read(answer):
                yield element
            if not answer.next_page_token:
                return
            request.page_token = answer.next_page_token

    def subscribe(self, rpc: Rpc[Q, A], request: Q) -> Any:  # noqa: ANN401
        """A stream of answers without an end; its failures come as grpc.RpcError."""
        return self._method("unary_stream", rpc)(request, metadata=self._metadata())

    def bidi(self, rpc: Rpc[Q, A], requests: AsyncIterator[bytes]) -> Any:  # noqa: ANN401
        """A stream both ways, of requests that are bytes already; its failures come as grpc.RpcError."""
        method = self.link.channel.stream_stream(rpc.path, response_deserializer=rpc.answer.FromString)
        return method(requests, metadata=self._metadata())

    async def serving(self) -> bool:
        """Whether the server says that it serves; False if it cannot be reached."""
        check = self.link.channel.unary_unary(HEALTH_PATH)
        timeout_s = min(self.options.timeout_s, HEALTH_S)
        try:
            return is_serving(await check(HEALTH_REQUEST, timeout=timeout_s, metadata=self._metadata()))
        except grpc.RpcError:
            return False

    def _method(self, kind: str, rpc: Rpc[Q, A]) -> Any:  # noqa: ANN401
        return getattr(self.link.channel, kind)(
            rpc.path,
            request_serializer=rpc.request.SerializeToString,
            response_deserializer=rpc.answer.FromString,
        )

    def _metadata(self) -> Metadata:
        said, authorization = self.options.metadata, self.authorization
        return said if authorization is None else (*said, ("authorization", authorization))

    async def _tried(self, repeatable: bool, attempt: Callable[[float], Awaitable[T]]) -> T:
        """One deadline over all tries."""
        deadline = time.monotonic() + self.options.timeout_s
        waits = backoff(self.options.retries if repeatable else 0)
        while True:
            try:
                return await attempt(max(deadline - time.monotonic(), 0.001))
            except grpc.RpcError as cause:
                error = error_of_rpc(cause)
                wait = wait_before_retry(error, waits)
                if wait is None or time.monotonic() + wait > deadline:
                    raise error from cause
            await runtime.sleep(wait)
