"""What threads do differently from asyncio; written by hand, the counterpart of `_async/_runtime.py`."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

import grpc

from .._access import Access

sleep = time.sleep
Lock = threading.Lock
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


def begun(call: Any) -> None:  # noqa: ANN401
    """Where waiting is possible: waits until the server has taken the call up."""
    call.initial_metadata()


def next_of(call: Any) -> Any:  # noqa: ANN401
    """The next of a stream of answers, or EOF."""
    return next(call, EOF)
