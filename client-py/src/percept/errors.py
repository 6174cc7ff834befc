"""What can go wrong, as a tree:

    PerceptError
    ├── InvalidArgument         the request is wrong: mend it (also a ValueError)
    │   └── WrongType           an argument is of no type that fits, or could be misread (also a TypeError)
    ├── Unauthenticated         the server does not know who asks: token or certificate missing, wrong, old
    ├── PermissionDenied        it knows, and does not allow it (also a PermissionError)
    ├── NotFound                what was named does not exist
    ├── AlreadyExists           it exists already, and differs
    ├── FailedPrecondition      right request, wrong state: do something else first
    ├── Aborted                 somebody else was quicker: read again what is there now, then try again
    ├── ResourceExhausted       a limit is used up
    ├── Unavailable             server stopping, unreachable, or a resource gone for now: try again
    │   └── StreamBroken        a stream of frames could not be taken up again in time; says how many are safe
    ├── DeadlineExceeded        no answer in time
    └── Internal                a fault of the server's; its log has the cause

Expected outcomes are no errors: lost is a state of a pose, no path is an answer, a refused frame of a stream
is an acknowledgement with a `rejection`.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import grpc
from google.protobuf import any_pb2
from google.protobuf.message import DecodeError
from google.rpc import error_details_pb2, status_pb2


class PerceptError(Exception):
    """A request that was not served.

    `reason` is stable and upper-case (SENSOR_NOT_FOUND), `message` says field, value and remedy, `field` is
    the path of the offending field or empty, `code` the name of the gRPC code. `retry_after_s` is how long
    the server asks to wait before another try, `trace_id` what its operator finds the call by, `server` the
    address of the one to ask instead (reason SESSION_ELSEWHERE); None if it does not say.
    """

    code = "UNKNOWN"

    def __init__(
        self,
        message: str,
        *,
        reason: str = "",
        field: str = "",
        code: str = "",
        retry_after_s: float | None = None,
        trace_id: str | None = None,
        server: str | None = None,
    ) -> None:
        super().__init__(message)
        self.message = message
        self.reason = reason
        self.field = field
        self.code = code or type(self).code
        self.retry_after_s = retry_after_s
        self.trace_id = trace_id
        self.server = server

    def __str__(self) -> str:
        reason = f" [{self.reason}]" if self.reason else ""
        field = f" (field {self.field})" if self.field else ""
        return f"{self.message}{field}{reason}"


class InvalidArgument(PerceptError, ValueError):
    """The request is wrong whatever the state of the server."""

    code = "INVALID_ARGUMENT"


class WrongType(InvalidArgument, TypeError):
    """An argument is of no type that fits, or of one that could be misread: (x, y, yaw) for (x, y, z)."""


class Unauthenticated(PerceptError):
    """The server does not know who asks."""

    code = "UNAUTHENTICATED"


class PermissionDenied(PerceptError, PermissionError):
    """The server knows who asks, and does not allow it."""

    code = "PERMISSION_DENIED"


class NotFound(PerceptError, LookupError):
    """What was named does not exist."""

    code = "NOT_FOUND"


class AlreadyExists(PerceptError):
    """It exists already, and differs."""

    code = "ALREADY_EXISTS"


class FailedPrecondition(PerceptError):
    """Right request, wrong state."""

    code = "FAILED_PRECONDITION"


class Aborted(PerceptError):
    """Somebody else was quicker: what is there is not what was seen."""

    code = "ABORTED"


class ResourceExhausted(PerceptError):
    """A limit or budget is used up."""

    code = "RESOURCE_EXHAUSTED"


class Unavailable(PerceptError, ConnectionError):
    """The server cannot be reached or is stopping."""

    code = "UNAVAILABLE"


class StreamBroken(Unavailable):
    """A stream of frames broke, and was not taken up again in time. The first `durable` of the `sent` frames
    survive a crash; send those after them again on another stream, and what was taken in is told by its
    stamp."""

    def __init__(self, cause: PerceptError, *, sent: int, durable: int, tried_s: float) -> None:
        super().__init__(
            f"the stream broke ({cause.message}) and was not resumed within {tried_s:g} s: {durable} of "
            f"{sent} frames are durable; send the others again",
            reason=cause.reason or "STREAM_BROKEN",
            retry_after_s=cause.retry_after_s,
            trace_id=cause.trace_id,
        )
        self.sent = sent
        self.durable = durable


class DeadlineExceeded(PerceptError, TimeoutError):
    """No answer within the deadline."""

    code = "DEADLINE_EXCEEDED"


class Internal(PerceptError):
    """A fault of the server's."""

    code = "INTERNAL"


_BY_CODE: dict[str, type[PerceptError]] = {
    kind.code: kind
    for kind in (
        InvalidArgument,
        Unauthenticated,
        PermissionDenied,
        NotFound,
        AlreadyExists,
        FailedPrecondition,
        Aborted,
        ResourceExhausted,
        Unavailable,
        DeadlineExceeded,
        Internal,
    )
}

# gRPC's own refusals that mean the same to a caller.
_ALIASES = {"OUT_OF_RANGE": "INVALID_ARGUMENT", "DATA_LOSS": "INTERNAL"}

_DETAILS = "grpc-status-details-bin"


def error_of(
    code: str,
    message: str,
    *,
    reason: str = "",
    field: str = "",
    retry_after_s: float | None = None,
    trace_id: str | None = None,
    server: str | None = None,
) -> PerceptError:
    """The exception for the name of a gRPC code."""
    kind = _BY_CODE.get(_ALIASES.get(code, code), PerceptError)
    return kind(
        message,
        reason=reason,
        field=field,
        code=code,
        retry_after_s=retry_after_s,
        trace_id=trace_id,
        server=server,
    )


def client_closed() -> Unavailable:
    """What a closed client raises, whatever it is asked for or had under way."""
    return Unavailable("the client is closed; make another", reason="CLIENT_CLOSED")


def error_of_rpc(error: grpc.RpcError, server: str = "the server") -> PerceptError:
    """The exception for a failed call to a server, with what its google.rpc.Status details say. Where gRPC
    alone speaks, for no server answered, it says whom it could not reach, why, and what to look at."""
    if not isinstance(error, (grpc.Call, grpc.aio.AioRpcError)):
        return PerceptError(str(error))
    said = _details(error.trailing_metadata() or ())
    code, message = error.code().name, error.details() or ""
    if not said.reason:
        message, said.reason = _of_the_link(code, message, server)
    return error_of(
        code,
        message,
        reason=said.reason,
        field=said.field,
        retry_after_s=said.retry_after_s,
        trace_id=said.trace_id,
        server=said.server,
    )


#: How gRPC's own words of a link that failed begin.
_LINK_FAILED = (
    "failed to connect",
    "errors resolving",
    "dns resolution failed",
    "socket closed",
    "connection reset",
)
#: What gRPC says of a link that did not come about or broke, in lower case: what that means, and what to do.
_LINK_FAULTS = (
    (
        ("connection refused",),
        "nobody listens there",
        "is `percept serve` running, and is that the port that it names for gRPC?",
    ),
    (
        ("lookup failed", "dns resolution failed", "name not found", "errors resolving"),
        "no machine of this name is known",
        "look at its spelling, or give the IP address",
    ),
    (
        ("certificate_verify_failed", "peer name", "hostname verification"),
        "its certificate is not trusted",
        "name who signed it (ca_file) and whom it is made out to (server_name)",
    ),
    (
        ("handshake", "wrong_version_number", "ssl_"),
        "the TLS handshake failed",
        "a server without TLS is called by http:// or a bare address, and REST is no gRPC",
    ),
    (
        ("no route", "unreachable", "timed out", "timeout"),
        "no answer comes from there",
        "is that percept's gRPC port, is the machine on this network, does a firewall let the port through?",
    ),
    (
        ("socket closed", "connection reset", "broken pipe", "goaway", "http2", "protocol"),
        "the connection was closed",
        "has the server stopped, or is that another port than gRPC's (50051; REST has 8080)? One with TLS is "
        "called by https://",
    ),
)


def _of_the_link(code: str, message: str, server: str) -> tuple[str, str]:
    """Message and reason, where gRPC speaks in words of its own; what else is said stays as it is."""
    words = message.lower()
    if code == "DEADLINE_EXCEEDED" and "deadline exceeded" in words:
        remedy = "give the call more timeout_s, or see whether that is percept's gRPC port and what it is at"
        # Without a reason: it is by that that a server which says nothing is told from one that is late.
        return f"{server} did not answer in time; {remedy}", ""
    if code != "UNAVAILABLE" or not words.startswith(_LINK_FAILED):
        return message, ""
    for signs, meaning, remedy in _LINK_FAULTS:
        if any(sign in words for sign in signs):
            return f"cannot reach {server}: {meaning}; {remedy}", "SERVER_UNREACHABLE"
    return f"cannot reach {server}: {message}", "SERVER_UNREACHABLE"


@dataclass
class _Details:
    """What a google.rpc.Status says beyond code and message; empty or None where it does not."""

    reason: str = ""
    field: str = ""
    retry_after_s: float | None = None
    trace_id: str | None = None
    server: str | None = None


def _details(metadata: Iterable[tuple[str, str | bytes]]) -> _Details:
    """Reason, trace and server (ErrorInfo), field (first BadRequest violation), pause (RetryInfo)."""
    said = _Details()
    for key, value in metadata:
        if key != _DETAILS or not isinstance(value, bytes):
            continue
        status = status_pb2.Status()
        try:
            status.ParseFromString(value)
            for detail in status.details:
                _read(detail, said)
        except DecodeError:
            continue
    return said


def _read(detail: any_pb2.Any, said: _Details) -> None:
    info, bad, retry = (
        error_details_pb2.ErrorInfo(),
        error_details_pb2.BadRequest(),
        error_details_pb2.RetryInfo(),
    )
    if detail.Unpack(info):
        said.reason = info.reason
        said.trace_id = info.metadata.get("trace_id") or None
        said.server = info.metadata.get("server") or None
    elif detail.Unpack(bad) and bad.field_violations:
        said.field = bad.field_violations[0].field
    elif detail.Unpack(retry):
        said.retry_after_s = max(retry.retry_delay.ToNanoseconds() / 1e9, 0.0)
