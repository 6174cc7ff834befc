"""What threads do differently from asyncio; written by hand, the counterpart of `_async/_runtime.py`."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import grpc

from .._access import Access

Lock = threading.Lock
Signal = threading.Event
Changed = threading.Condition
#: What a stream of answers reads at its end.
EOF = object()
#: What a call raises whose channel is closed.
ChannelClosed = ValueError


class Cancelled(Exception):
    """What a call raises that was cancelled here; never, for here that is an RpcError."""


class Task:
    """Work beside the caller's."""

    def __init__(self, work: Callable[[], None], name: str) -> None:
        self._thread = threading.Thread(target=work, name=name, daemon=True)
        self._thread.start()

    def join(self) -> None:
        """Waits until it is done."""
        self._thread.join()


def open_channel(access: Access, options: list[tuple[str, int | str]]) -> Any:  # noqa: ANN401
    """A channel; it connects when it is used."""
    if access.credentials is None:
        return grpc.insecure_channel(access.target, options)
    return grpc.secure_channel(access.target, access.credentials, options)


def begin_now(begin: Callable[[], None]) -> None:
    """Where waiting is possible: begins before it is asked for."""
    begin()


def is_cancelled() -> bool:
    """Whether it is the running thread that was cancelled; threads are not."""
    return False


def is_over(call: Any, within_s: float) -> bool:  # noqa: ANN401
    """Whether a call has ended, or does so in time."""
    over = threading.Event()
    return not call.add_callback(over.set) or over.wait(within_s)


def next_of(call: Any) -> Any:  # noqa: ANN401
    """The next of a stream of answers, or EOF."""
    return next(call, EOF)
