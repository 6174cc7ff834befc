"""How calls are made: channel options, patience, headers, the health check's two messages."""

from __future__ import annotations

import random
import re
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

from .errors import DeadlineExceeded, InvalidArgument, PerceptError, ResourceExhausted, Unavailable

#: Headers of a call, as gRPC takes them.
Metadata = tuple[tuple[str, "str | bytes"], ...]

_HEADER_NAME = re.compile(r"[0-9a-z_.-]+")
_HEADER_VALUE = re.compile(r"[ -~]*")

#: How long a health check waits at most.
HEALTH_S = 2.0

#: A server that refuses a stream, or takes it up, has mostly said so by then.
MOMENT_S = 0.1

#: How often what waits to be taken up again looks whether its client was closed.
LOOK_S = 0.5

#: A session that moves while it is asked for is followed so often at once.
MOST_MOVES = 3


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
            metadata=tuple({**dict(self.metadata), **dict(headers(metadata))}.items()),
        )


def headers(metadata: Mapping[str, str | bytes] | None) -> Metadata:
    """Headers with names in lower case, as HTTP/2 has them; what gRPC does not carry is refused."""
    checked = {key.lower(): value for key, value in (metadata or {}).items()}
    for key, value in checked.items():
        text = value.decode("latin-1") if isinstance(value, bytes) else value
        if not _HEADER_NAME.fullmatch(key) or not (key.endswith("-bin") or _HEADER_VALUE.fullmatch(text)):
            # The value is not repeated, for messages are logged.
            message = (
                f"metadata {key!r} is no header: names are of a-z 0-9 - _ . and values of printable ASCII; "
                "name what is binary ...-bin"
            )
            raise InvalidArgument(message, reason="METADATA_INVALID", field="metadata")
    return tuple(checked.items())


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


def wait_before_retry(error: PerceptError, waits: Iterator[float], *, moved: bool) -> float | None:
    """Seconds to wait before a call that failed so is tried again; None: it is not.

    A limit is waited for only if the server says for how long. What it asks for comes on top of our own
    wait, which keeps clients out of step; `moved` to another server, it does not matter.
    """
    asked = error.retry_after_s
    if not isinstance(error, Unavailable) and not (
        isinstance(error, ResourceExhausted) and asked is not None
    ):
        return None
    wait = next(waits, None)
    return None if wait is None else wait + (0.0 if moved else asked or 0.0)


class Patience:
    """For how long what broke is to be taken up again, and with which pauses."""

    def __init__(self, budget_s: float) -> None:
        self.budget_s = budget_s
        self._since_s: float | None = None
        self._waits = backoff(None)
        self._moves_left = 0

    def renew(self) -> None:
        """All is well: what breaks next begins anew."""
        self._since_s = None

    def wait(self, error: PerceptError, *, moved: bool) -> float | None:
        """Seconds to wait before the next try, which is made at another server if `moved`; None: too late."""
        now_s = time.monotonic()
        if self._since_s is None:
            self._since_s, self._waits, self._moves_left = now_s, backoff(None), MOST_MOVES
        if moved and error.server and self._moves_left > 0:
            # Nothing is to be waited for where the session is.
            self._moves_left -= 1
            return 0.0
        wait_s = next(self._waits) + (0.0 if moved else error.retry_after_s or 0.0)
        return None if now_s + wait_s - self._since_s > self.budget_s else wait_s


#: Reasons of servers that are there, and serve the same request in a moment.
_THERE = ("NOT_YET_DURABLE", "SESSION_STOPPED", "STREAM_ENDED", "STREAM_IDLE")


def is_away(error: PerceptError) -> bool:
    """Whether another server of the same store might serve what this one did not: it is away, or about to be,
    or says nothing at all within the deadline."""
    if isinstance(error, DeadlineExceeded):
        return not error.reason
    return isinstance(error, Unavailable) and error.reason not in _THERE


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
