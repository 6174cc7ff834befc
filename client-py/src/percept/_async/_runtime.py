"""What asyncio does differently from threads. `_sync` has a file of its own in this place; all others there
are written from those beside this one."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Callable, Coroutine
from typing import Any

import grpc
import grpc.aio

from .._access import Access

Lock = asyncio.Lock
#: What a call raises that was cancelled here, or with its channel.
Cancelled = asyncio.CancelledError
#: What a stream of answers reads at its end.
EOF = grpc.aio.EOF
#: What a call raises whose channel is closed.
ChannelClosed = grpc.aio.UsageError


async def _in_time(event: asyncio.Event, timeout_s: float | None) -> bool:
    """Waits for an event; False if it did not happen in time. Before Python 3.12 asyncio.wait_for forgets a
    cancellation that comes together with what it waits for."""
    if timeout_s is None:
        return await event.wait()
    task = asyncio.ensure_future(event.wait())
    try:
        done, _ = await asyncio.wait([task], timeout=timeout_s)
    finally:
        task.cancel()
    return bool(done)


class Changed:
    """A lock, and word that what it guards has changed."""

    def __init__(self) -> None:
        self._lock = asyncio.Lock()
        self._word = asyncio.Event()

    async def __aenter__(self) -> None:
        await self._lock.acquire()

    async def __aexit__(self, *raised: object) -> None:
        self._lock.release()

    async def wait(self, timeout_s: float | None = None) -> bool:
        """Waits for word; False if none came in time."""
        word = self._word
        self._lock.release()
        try:
            return await _in_time(word, timeout_s)
        finally:
            await self._lock_again()

    def notify_all(self) -> None:
        """Gives word."""
        self._word.set()
        self._word = asyncio.Event()

    async def _lock_again(self) -> None:
        """Whoever waited holds the lock, also when it was cancelled."""
        cancelled = None
        while True:
            try:
                await self._lock.acquire()
                break
            except asyncio.CancelledError as cancellation:
                cancelled = cancellation
        if cancelled is not None:
            raise cancelled


class Signal:
    """Something that happens once."""

    def __init__(self) -> None:
        self._event = asyncio.Event()

    def set(self) -> None:
        """It has happened."""
        self._event.set()

    def is_set(self) -> bool:
        """Whether it has."""
        return self._event.is_set()

    async def wait(self, timeout_s: float) -> bool:
        """Waits for it; False if it did not happen in time."""
        return await _in_time(self._event, timeout_s)


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


def begin_now(begin: Callable[[], Coroutine[Any, Any, None]]) -> None:
    """Where waiting is possible: begins before it is asked for."""


def is_cancelled() -> bool:
    """Whether it is the running task that was cancelled; Python 3.10 does not know."""
    task = asyncio.current_task()
    return task is not None and sys.version_info >= (3, 11) and task.cancelling() > 0


async def is_over(call: Any, within_s: float) -> bool:  # noqa: ANN401
    """Whether a call has ended, or does so in time."""
    over = Signal()
    call.add_done_callback(lambda _: over.set())
    return await over.wait(within_s)


async def next_of(call: Any) -> Any:  # noqa: ANN401
    """The next of a stream of answers, or EOF."""
    return await call.read()
