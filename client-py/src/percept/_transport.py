"""Carries calls over a blocking gRPC channel: deadlines, retries, errors as our own."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any, TypeVar

import grpc

from ._call import Call, ChunkedCall, PagedCall, StreamedCall
from ._rpc import A, Q, Rpc
from ._transport_options import HEALTH_PATH, HEALTH_REQUEST, Options, backoff, is_serving
from .errors import Unavailable, error_of_rpc

T = TypeVar("T")


class Transport:
    """A channel to one server."""

    def __init__(self, options: Options) -> None:
        self.options = options
        if options.credentials is None:
            self.channel = grpc.insecure_channel(options.address, options.channel())
        else:
            self.channel = grpc.secure_channel(options.address, options.credentials, options.channel())

    def close(self) -> None:
        """Ends all calls."""
        self.channel.close()

    def call(self, call: Call[Q, A, T], timeout_s: float | None = None) -> T:
        """One answer."""
        method = self._unary(call.rpc)
        return call.read(
            self._tried(call.rpc.repeatable, timeout_s, lambda t: method(call.request, timeout=t))
        )

    def chunks(self, call: ChunkedCall[Q, A, T]) -> T:
        """An answer in chunks, tried again as a whole."""
        method = self._server_stream(call.rpc)
        read = lambda t: list(method(call.request, timeout=t))  # noqa: E731
        return call.read(self._tried(call.rpc.repeatable, None, read))

    def parts(self, call: StreamedCall[Q, A, T]) -> T:
        """A request in parts; one answer."""
        method: Any = self.channel.stream_unary(
            call.rpc.path,
            request_serializer=call.rpc.request.SerializeToString,
            response_deserializer=call.rpc.answer.FromString,
        )
        return call.read(self._tried(False, None, lambda t: method(call.parts(), timeout=t)))

    def pages(self, call: PagedCall[Q, A, T]) -> Iterator[T]:
        """The elements of all pages, asked for as they are used."""
        method = self._unary(call.rpc)
        request: Any = type(call.request)()
        request.CopyFrom(call.request)
        while True:
            answer: Any = self._tried(True, None, lambda t: method(request, timeout=t))
            yield from call.read(answer)
            if not answer.next_page_token:
                return
            request.page_token = answer.next_page_token

    def subscribe(self, rpc: Rpc[Q, A], request: Q) -> Any:  # noqa: ANN401
        """A stream of answers without an end; its failures come as grpc.RpcError."""
        return self._server_stream(rpc)(request)

    def bidi(self, rpc: Rpc[Q, A], requests: Iterator[Q]) -> Any:  # noqa: ANN401
        """A stream both ways; its failures come as grpc.RpcError."""
        method = self.channel.stream_stream(
            rpc.path,
            request_serializer=rpc.request.SerializeToString,
            response_deserializer=rpc.answer.FromString,
        )
        return method(requests)

    def serving(self, timeout_s: float) -> bool:
        """Whether the server says that it serves; False if it cannot be reached."""
        check: Any = self.channel.unary_unary(HEALTH_PATH)
        try:
            return is_serving(check(HEALTH_REQUEST, timeout=timeout_s))
        except grpc.RpcError:
            return False

    def _unary(self, rpc: Rpc[Q, A]) -> Callable[..., A]:
        return self.channel.unary_unary(
            rpc.path,
            request_serializer=rpc.request.SerializeToString,
            response_deserializer=rpc.answer.FromString,
        )

    def _server_stream(self, rpc: Rpc[Q, A]) -> Any:  # noqa: ANN401
        return self.channel.unary_stream(
            rpc.path,
            request_serializer=rpc.request.SerializeToString,
            response_deserializer=rpc.answer.FromString,
        )

    def _tried(self, repeatable: bool, timeout_s: float | None, attempt: Callable[[float], T]) -> T:
        """One deadline over all tries."""
        deadline = time.monotonic() + (self.options.timeout_s if timeout_s is None else timeout_s)
        waits = backoff(self.options.retries if repeatable else 0)
        while True:
            try:
                return attempt(max(deadline - time.monotonic(), 0.001))
            except grpc.RpcError as cause:
                error = error_of_rpc(cause)
                wait = next(waits, None)
                too_late = wait is None or time.monotonic() + wait > deadline
                if not isinstance(error, Unavailable) or wait is None or too_late:
                    raise error from cause
            time.sleep(wait)
