"""AsyncClient: the front door for asyncio. The twin of client.py."""

from __future__ import annotations

from types import TracebackType

import grpc

from ._aio_transport import AsyncTransport
from ._convert import sensors as convert
from ._transport_options import Options
from .aio_session import AsyncSession, AsyncSessions
from .evaluation import AsyncEvaluation
from .toolbox import AsyncToolbox
from .types.sensors import ClockOffset


class AsyncClient:
    """A percept server; make it inside the running event loop.

    async with AsyncClient("127.0.0.1:50051") as client:
        session = await client.sessions.create("robot-7")
    """

    def __init__(
        self,
        address: str = "127.0.0.1:50051",
        *,
        timeout_s: float = 30.0,
        retries: int = 5,
        max_message_bytes: int = 64 << 20,
        credentials: grpc.ChannelCredentials | None = None,
    ) -> None:
        """`timeout_s` bounds every call, tries included; calls that can be repeated without harm are tried
        again up to `retries` times while the server is away; `credentials` turn TLS on."""
        self._transport = AsyncTransport(
            Options(
                address=address,
                timeout_s=timeout_s,
                retries=retries,
                max_message_bytes=max_message_bytes,
                credentials=credentials,
            )
        )
        self.sessions = AsyncSessions(self._transport)
        self.toolbox = AsyncToolbox(self._transport)
        self.evaluation = AsyncEvaluation(self._transport)

    def __repr__(self) -> str:
        return f"AsyncClient({self._transport.options.address!r})"

    def session(self, session_id: str) -> AsyncSession:
        """A session by its name, without asking whether it exists."""
        return AsyncSession(self._transport, session_id)

    async def health(self, *, timeout_s: float = 2.0) -> bool:
        """Whether the server says that it serves; False if it cannot be reached."""
        return await self._transport.serving(timeout_s)

    async def sync_time(self) -> ClockOffset:
        """The server's clock against this machine's; the quickest of five measurements."""
        offsets = [await self._transport.call(convert.sync_time()) for _ in range(5)]
        return min(offsets, key=lambda o: o.round_trip_ns)

    async def close(self) -> None:
        """Ends all calls and streams."""
        await self._transport.close()

    async def __aenter__(self) -> AsyncClient:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()
