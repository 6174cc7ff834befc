"""What both transports share: channel options, patience, the health check's two messages."""

from __future__ import annotations

import random
from collections.abc import Iterator
from dataclasses import dataclass

import grpc


@dataclass(frozen=True, kw_only=True)
class Options:
    """How to reach a server."""

    address: str
    timeout_s: float
    retries: int
    max_message_bytes: int
    credentials: grpc.ChannelCredentials | None

    def channel(self) -> list[tuple[str, int]]:
        """gRPC's own options."""
        return [
            ("grpc.max_send_message_length", self.max_message_bytes),
            ("grpc.max_receive_message_length", self.max_message_bytes),
            ("grpc.keepalive_time_ms", 30_000),
            ("grpc.keepalive_timeout_ms", 10_000),
            # A server that came back is found within a second, not after minutes of backoff.
            ("grpc.initial_reconnect_backoff_ms", 100),
            ("grpc.min_reconnect_backoff_ms", 100),
            ("grpc.max_reconnect_backoff_ms", 1_000),
            ("grpc.use_local_subchannel_pool", 1),
            # Retries are ours: only calls that can be repeated, and within the deadline.
            ("grpc.enable_retries", 0),
        ]


def backoff(retries: int) -> Iterator[float]:
    """Seconds to wait before each further try: 0.1, 0.2, 0.4 ... up to 2, each shortened by up to a half,
    so that clients which lost the same server do not come back in step."""
    for attempt in range(retries):
        yield min(0.1 * 2**attempt, 2.0) * random.uniform(0.5, 1.0)


HEALTH_PATH = "/grpc.health.v1.Health/Check"
#: HealthCheckRequest for the server as a whole: no field set.
HEALTH_REQUEST = b""


def is_serving(response: bytes) -> bool:
    """Whether a HealthCheckResponse says SERVING: field 1, varint 1."""
    return response == b"\x08\x01"
