"""Client: the blocking front door."""

from __future__ import annotations

from types import TracebackType

import grpc

from ._convert import sensors as convert
from ._transport import Transport
from ._transport_options import Options
from .evaluation import Evaluation
from .session import Session, Sessions
from .toolbox import Toolbox
from .types.sensors import ClockOffset


class Client:
    """A percept server.

        with Client("127.0.0.1:50051") as client:
            session = client.sessions.create("robot-7", sensors=[SensorSpec("laser", kind="lidar2d")])

    May be shared by threads. Failures are `PerceptError`s.
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
        self._transport = Transport(
            Options(
                address=address,
                timeout_s=timeout_s,
                retries=retries,
                max_message_bytes=max_message_bytes,
                credentials=credentials,
            )
        )
        self.sessions = Sessions(self._transport)
        self.toolbox = Toolbox(self._transport)
        self.evaluation = Evaluation(self._transport)

    def __repr__(self) -> str:
        return f"Client({self._transport.options.address!r})"

    def session(self, session_id: str) -> Session:
        """A session by its name, without asking whether it exists."""
        return Session(self._transport, session_id)

    def health(self, *, timeout_s: float = 2.0) -> bool:
        """Whether the server says that it serves; False if it cannot be reached."""
        return self._transport.serving(timeout_s)

    def sync_time(self) -> ClockOffset:
        """The server's clock against this machine's; the quickest of five measurements."""
        offsets = [self._transport.call(convert.sync_time()) for _ in range(5)]
        return min(offsets, key=lambda o: o.round_trip_ns)

    def close(self) -> None:
        """Ends all calls and streams."""
        self._transport.close()

    def __enter__(self) -> Client:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
