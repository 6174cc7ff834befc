"""What carries the calls."""

from __future__ import annotations

from .._aio_transport import AsyncTransport
from .._transport import Transport


class Sync:
    """Over a blocking channel."""

    def __init__(self, transport: Transport) -> None:
        self._transport = transport


class Async:
    """Over an asyncio channel."""

    def __init__(self, transport: AsyncTransport) -> None:
        self._transport = transport
