"""What asyncio does differently from threads. `_sync` has a file of its own in this place; all others there
are written from those beside this one."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any

import grpc
import grpc.aio

from .._access import Access

sleep = asyncio.sleep
Lock = asyncio.Lock
#: What a call raises that was cancelled here, or with its channel.
Cancelled = asyncio.CancelledError
#: What a stream of answers reads at its end.
EOF = grpc.aio.EOF
#: What a call raises whose channel is closed.
ChannelClosed = grpc.aio.UsageError


class Changed:
    """A lock, and word that what it guards has changed."""

    def __init__(self) -> None:
        self._condition = asyncio.Condition()

    async def __aenter__(self) -> None:
        await self._condition.acquire()

    async def __aexit__(self, *raised: object) -> None:
        self._condition.release()

    async def wait(self, timeout_s: float | None = None) -> bool:
        """Waits for word; False if none came in time."""
        try:
            await asyncio.wait_for(self._condition.wait(), timeout_s)
        except asyncio.TimeoutError:
            return False
        return True

    def notify_all(self) -> None:
        """Gives word."""
        self._condition.notify_all()


class Task:
    """Work beside the caller's."""

    def __init__(self, work: Callable[[], Coroutine[Any, Any, None]], name: str) -> None:
        self._task = asyncio.create_task(work(), name=name)

    async def join(self) -> None:
        """Waits until it is done."""
        await asyncio.wait([self._task])


def open_channel(access: Access, options: list[tuple[str, int | str]]) -> Any:  # noqa: ANN401
    """A channel; it connects when it is used."""
    if access.credentials is None:
        return grpc.aio.insecure_channel(access.target, options)
    return grpc.aio.secure_channel(access.target, access.credentials, options)


def begun(call: Any) -> None:  # noqa: ANN401
    """Where waiting is possible: waits until the server has taken the call up."""


async def next_of(call: Any) -> Any:  # noqa: ANN401
    """The next of a stream of answers, or EOF."""
    return await call.read()
