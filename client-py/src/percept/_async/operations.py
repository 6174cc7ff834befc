"""Operations: work at the server that goes on whoever hangs up."""

from __future__ import annotations

import time
from collections.abc import AsyncIterator
from typing import Any, Generic, TypeVar

from .._call import Call, ChunkedCall
from .._convert import operations as convert
from .._rpc import A, Q
from ..errors import DeadlineExceeded, error_of
from ..types.operations import OperationInfo, OperationState
from .bound import AsyncBound
from .pages import AsyncPages
from .transport import AsyncTransport

T = TypeVar("T")
#: Longest that one call waits; many are made of a longer wait.
_ONE_WAIT_S = 30.0


class AsyncOperation(AsyncBound, Generic[T]):
    """One operation. It is found again by `operation_id`, from any connection of who started it, for as long
    as the server keeps it and runs."""

    def __init__(self, transport: AsyncTransport, info: OperationInfo) -> None:
        super().__init__(transport)
        #: As it was when the server was last asked.
        self.info = info

    def __repr__(self) -> str:
        return f"AsyncOperation({self.operation_id!r}, {self.info.state!r})"

    @property
    def operation_id(self) -> str:
        """Names it."""
        return self.info.operation_id

    async def refresh(self) -> OperationInfo:
        """How it stands now."""
        self.info = await self._transport.call(convert.get(self.operation_id))
        return self.info

    async def wait(self, timeout_s: float | None = None) -> OperationInfo:
        """How it stands once it has ended, or after timeout_s if that is sooner. None: waits for its end."""
        end = None if timeout_s is None else time.monotonic() + timeout_s
        # The answer has to be here before the call's own time is over.
        longest = min(_ONE_WAIT_S, self._transport.options.timeout_s / 2)
        while True:
            left = longest if end is None else max(end - time.monotonic(), 0.0)
            call = convert.wait(self.operation_id, min(left, longest))
            self.info = await self._transport.call(call)
            if self.info.has_ended or (end is not None and time.monotonic() >= end):
                return self.info

    async def watch(self, *, every_s: float = 0.5) -> AsyncIterator[OperationInfo]:
        """How it stands, now, every so often, and at its end: for a bar of its `fraction` and `stage`."""
        yield await self.refresh()
        while not self.info.has_ended:
            yield await self.wait(every_s)

    async def cancel(self) -> OperationInfo:
        """Ends it at once if it waits, at its next step if it runs; wait() tells which end it came to."""
        self.info = await self._transport.call(convert.cancel(self.operation_id))
        return self.info

    async def result(self, *, timeout_s: float | None = None) -> T:
        """What the plain call would have given, once it has ended; raises what that would have raised.
        DeadlineExceeded if it has not ended after timeout_s; it goes on all the same."""
        if not self.info.has_ended:
            await self.wait(timeout_s)
        if not self.info.has_ended:
            message = f"the operation is {self.info.state} after {timeout_s} s; wait longer, or cancel it"
            raise DeadlineExceeded(message, reason="OPERATION_NOT_DONE")
        fault = self.info.fault
        if fault is not None:
            raise error_of(fault.code, fault.message, reason=fault.reason, field=fault.field)
        answer: T = await self._transport.chunks(convert.result(self.operation_id))
        return answer

    async def delete(self) -> None:
        """Makes the server forget it; it must have ended."""
        await self._transport.call(convert.delete(self.operation_id))


class AsyncOperations(AsyncBound):
    """The caller's operations. They are started where the plain call is: `session.map.start_export()`,
    `session.map.start_optimise()`, `toolbox.start_pipeline()`, `toolbox.start_register_clouds_globally()`."""

    async def get(self, operation_id: str) -> AsyncOperation[Any]:
        """One that was started, here or elsewhere."""
        return AsyncOperation(self._transport, await self._transport.call(convert.get(operation_id)))

    def list(
        self,
        *,
        state: OperationState | str | None = None,
        session_pattern: str = "",
        page_size: int = 0,
    ) -> AsyncPages[OperationInfo]:
        """Oldest first; only those in a state, or about sessions whose id fits (robot-*)."""
        return self._transport.pages(convert.list_operations(state, session_pattern, page_size))


async def started(
    transport: AsyncTransport,
    call: Call[Q, A, T] | ChunkedCall[Q, A, T],
    request_id: str | None,
) -> AsyncOperation[T]:
    """What the call would do, as an operation."""
    return AsyncOperation(transport, await transport.call(convert.start(call, request_id)))
