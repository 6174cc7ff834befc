"""How calls are made: channel options, patience, headers, the health check's two messages."""

from __future__ import annotations

import random
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

from .errors import DeadlineExceeded, PerceptError, ResourceExhausted, Unavailable

#: Headers of a call, as gRPC takes them.
Metadata = tuple[tuple[str, "str | bytes"], ...]

#: How long a health check waits at most.
HEALTH_S = 2.0


@dataclass(frozen=True, kw_only=True)
class Options:
    """How calls are made."""

    timeout_s: float
    retries: int
    metadata: Metadata

    def but(
        self,
        timeout_s: float | None,
        retries: int | None,
        metadata: Mapping[str, str | bytes] | None,
    ) -> Options:
        """The same with other values where they are given; headers are laid over those of before."""
        return replace(
            self,
            timeout_s=self.timeout_s if timeout_s is None else timeout_s,
            retries=self.retries if retries is None else retries,
            metadata=headers({**dict(self.metadata), **(metadata or {})}),
        )


def headers(metadata: Mapping[str, str | bytes] | None) -> Metadata:
    """Headers with names in lower case, as HTTP/2 has them."""
    return tuple((key.lower(), value) for key, value in (metadata or {}).items())


def channel_options(server_name: str | None) -> list[tuple[str, int | str]]:
    """gRPC's own options."""
    options: list[tuple[str, int | str]] = [
        # A server that has gone without a word is found out before a call is given up. How long it
        # has for a ping older gRPC takes from the second, newer from the third.
        ("grpc.keepalive_time_ms", 10_000),
        ("grpc.keepalive_timeout_ms", 5_000),
        ("grpc.http2.ping_timeout_ms", 5_000),
        # A server that came back is found within a second, not after minutes of backoff.
        ("grpc.initial_reconnect_backoff_ms", 100),
        ("grpc.max_reconnect_backoff_ms", 1_000),
        # gRPC's name for how long one attempt may take; a distant server's handshakes need their time.
        ("grpc.min_reconnect_backoff_ms", 5_000),
        ("grpc.use_local_subchannel_pool", 1),
        # Retries are ours: only calls that can be repeated, and within the deadline.
        ("grpc.enable_retries", 0),
    ]
    return [*options, ("grpc.ssl_target_name_override", server_name)] if server_name else options


def backoff(retries: int | None) -> Iterator[float]:
    """Seconds to wait before each further try: 0.1, 0.2, 0.4 ... up to 2, each shortened by up to a half,
    so that clients which lost the same server do not come back in step. None: without an end."""
    attempt = 0
    while retries is None or attempt < retries:
        yield min(0.1 * 2 ** min(attempt, 5), 2.0) * random.uniform(0.5, 1.0)
        attempt += 1


def wait_before_retry(error: PerceptError, waits: Iterator[float]) -> float | None:
    """Seconds to wait before a call that failed so is tried again; None: it is not.

    A limit is waited for only if the server says for how long. What it asks for comes on top of our own
    wait, which keeps clients out of step.
    """
    asked = error.retry_after_s
    if not isinstance(error, Unavailable) and not (
        isinstance(error, ResourceExhausted) and asked is not None
    ):
        return None
    wait = next(waits, None)
    return None if wait is None else wait + (asked or 0.0)


def link_broke(error: PerceptError) -> bool:
    """Whether a stream that ended so may be taken up again: the server went away, waited in vain for a slow
    link (a stream has no deadline of ours), is full for a stated time, or gRPC tells in its own words,
    without a reason of the server's, that the link is gone."""
    if isinstance(error, ResourceExhausted):
        return error.retry_after_s is not None
    return isinstance(error, (Unavailable, DeadlineExceeded)) or (
        not error.reason and error.code in ("INTERNAL", "CANCELLED", "UNKNOWN")
    )


HEALTH_PATH = "/grpc.health.v1.Health/Check"
#: HealthCheckRequest for the server as a whole: no field set.
HEALTH_REQUEST = b""


def is_serving(response: bytes) -> bool:
    """Whether a HealthCheckResponse says SERVING: field 1, varint 1."""
    return response == b"\x08\x01"
