"""A call as a value: what to send, and how to read what comes back. Both clients carry the same calls out."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Generic, TypeVar

from ._rpc import A, Q, Rpc

T = TypeVar("T")


@dataclass(frozen=True)
class Call(Generic[Q, A, T]):
    """One request, one answer."""

    rpc: Rpc[Q, A]
    request: Q
    read: Callable[[A], T]


@dataclass(frozen=True)
class ChunkedCall(Generic[Q, A, T]):
    """One request, an answer in chunks that are read as a whole."""

    rpc: Rpc[Q, A]
    request: Q
    read: Callable[[list[A]], T]


@dataclass(frozen=True)
class StreamedCall(Generic[Q, A, T]):
    """A request in parts, one answer; never tried again."""

    rpc: Rpc[Q, A]
    parts: Callable[[], Iterator[Q]]
    read: Callable[[A], T]


@dataclass(frozen=True)
class PagedCall(Generic[Q, A, T]):
    """A list that comes in pages; `read` gives the elements of one."""

    rpc: Rpc[Q, A]
    request: Q
    read: Callable[[A], list[T]]
