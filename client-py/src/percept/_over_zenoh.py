"""Carries calls about a session over zenoh, each as one query; what goes on or comes in parts needs gRPC."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any, NoReturn, TypeVar

from ._access import Access
from ._call import Call, ChunkedCall, PagedCall, StreamedCall
from ._options import Options
from ._rpc import A, Q, Rpc
from ._sync.transport import Transport
from .errors import FailedPrecondition

T = TypeVar("T")

#: Asks one rpc with an encoded request, for so many seconds; gives the encoded answer.
Ask = Callable[[Rpc[Any, Any], bytes, float], bytes]


def _needs_grpc(what: str) -> NoReturn:
    raise FailedPrecondition(
        f"{what} does not travel over zenoh; use percept.Client, or poses() and events() of MapReader",
        reason="NEEDS_GRPC",
    )


class OverZenoh(Transport):
    """Calls by one peer of zenoh."""

    def __init__(self, ask: Ask, options: Options) -> None:
        self._ask = ask
        self.options = options

    def following(self) -> Transport:
        """The same: where a session is, zenoh knows."""
        return self

    def with_options(
        self,
        timeout_s: float | None,
        retries: int | None,
        metadata: Mapping[str, str | bytes] | None,
    ) -> Transport:
        """The same with other options; of these zenoh has the time-out alone."""
        return OverZenoh(self._ask, self.options.but(timeout_s, retries, metadata))

    def call(self, call: Call[Q, A, T]) -> T:
        """One answer; zenoh carries it whole."""
        return call.read(self._answer(call.rpc, call.request))

    def chunks(self, call: ChunkedCall[Q, A, T]) -> T:
        """An answer that comes in one chunk."""
        return call.read([self._answer(call.rpc, call.request)])

    def _elements(self, call: PagedCall[Q, A, T]) -> Iterator[T]:
        request: Any = type(call.request)()
        request.CopyFrom(call.request)
        while True:
            answer: Any = self._answer(call.rpc, request)
            yield from call.read(answer)
            if not answer.next_page_token:
                return
            request.page_token = answer.next_page_token

    def _answer(self, rpc: Rpc[Q, A], request: Q) -> A:
        return rpc.answer.FromString(self._ask(rpc, request.SerializeToString(), self.options.timeout_s))

    @property
    def here(self) -> Access:
        """Asked for by what goes on."""
        _needs_grpc("a stream of frames or events")

    def parts(self, call: StreamedCall[Q, A, T]) -> T:
        """A request in parts is none of zenoh's."""
        _needs_grpc(call.rpc.method)

    def subscribe(self, rpc: Rpc[Q, A], request: Q, server: Access) -> Any:  # noqa: ANN401
        """What goes on is none of zenoh's."""
        _needs_grpc(rpc.method)

    def bidi(self, rpc: Rpc[Q, A], requests: Iterator[bytes], server: Access) -> Any:  # noqa: ANN401
        """What goes on is none of zenoh's."""
        _needs_grpc(rpc.method)
