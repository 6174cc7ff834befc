"""What can go wrong, as a tree:

PerceptError
├── InvalidArgument         the request is wrong: mend it (also a ValueError)
├── NotFound                what was named does not exist
├── AlreadyExists           it exists already, and differs
├── FailedPrecondition      right request, wrong state: do something else first
├── ResourceExhausted       a limit is used up
├── Unavailable             server stopping, unreachable, or a resource gone for now: try again
├── DeadlineExceeded        no answer in time
└── Internal                a fault of the server's; its log has the cause

Expected outcomes are no errors: lost is a state of a pose, no path is an answer, a refused frame of a stream
is an acknowledgement with a `rejection`.
"""

from __future__ import annotations

from collections.abc import Iterable

import grpc
from google.protobuf.message import DecodeError
from google.rpc import error_details_pb2, status_pb2


class PerceptError(Exception):
    """A request that was not served.

    `reason` is stable and upper-case (SENSOR_NOT_FOUND), `message` says field, value and remedy, `field` is
    the path of the offending field or empty, `code` the name of the gRPC code.
    """

    code = "UNKNOWN"

    def __init__(self, message: str, *, reason: str = "", field: str = "", code: str = "") -> None:
        super().__init__(message)
        self.message = message
        self.reason = reason
        self.field = field
        self.code = code or type(self).code

    def __str__(self) -> str:
        reason = f" [{self.reason}]" if self.reason else ""
        field = f" (field {self.field})" if self.field else ""
        return f"{self.message}{field}{reason}"


class InvalidArgument(PerceptError, ValueError):
    """The request is wrong whatever the state of the server."""

    code = "INVALID_ARGUMENT"


class NotFound(PerceptError, LookupError):
    """What was named does not exist."""

    code = "NOT_FOUND"


class AlreadyExists(PerceptError):
    """It exists already, and differs."""

    code = "ALREADY_EXISTS"


class FailedPrecondition(PerceptError):
    """Right request, wrong state."""

    code = "FAILED_PRECONDITION"


class ResourceExhausted(PerceptError):
    """A limit or budget is used up."""

    code = "RESOURCE_EXHAUSTED"


class Unavailable(PerceptError, ConnectionError):
    """The server cannot be reached or is stopping."""

    code = "UNAVAILABLE"


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
        NotFound,
        AlreadyExists,
        FailedPrecondition,
        ResourceExhausted,
        Unavailable,
        DeadlineExceeded,
        Internal,
    )
}

# gRPC's own refusals that mean the same to a caller.
_ALIASES = {"OUT_OF_RANGE": "INVALID_ARGUMENT", "DATA_LOSS": "INTERNAL"}

_DETAILS = "grpc-status-details-bin"


def error_of(code: str, message: str, *, reason: str = "", field: str = "") -> PerceptError:
    """The exception for the name of a gRPC code."""
    kind = _BY_CODE.get(_ALIASES.get(code, code), PerceptError)
    return kind(message, reason=reason, field=field, code=code)


def error_of_rpc(error: grpc.RpcError) -> PerceptError:
    """The exception for a failed call: reason and field come out of its google.rpc.Status details."""
    if not isinstance(error, (grpc.Call, grpc.aio.AioRpcError)):
        return PerceptError(str(error))
    reason, field = _details(error.trailing_metadata() or ())
    return error_of(error.code().name, error.details() or "", reason=reason, field=field)


def _details(metadata: Iterable[tuple[str, str | bytes]]) -> tuple[str, str]:
    """Reason (ErrorInfo) and field (first BadRequest violation); empty where absent or unreadable."""
    reason = field = ""
    for key, value in metadata:
        if key != _DETAILS or not isinstance(value, bytes):
            continue
        status = status_pb2.Status()
        try:
            status.ParseFromString(value)
        except DecodeError:
            continue
        info, bad = error_details_pb2.ErrorInfo(), error_details_pb2.BadRequest()
        for detail in status.details:
            if detail.Unpack(info):
                reason = info.reason
            elif detail.Unpack(bad) and bad.field_violations:
                field = bad.field_violations[0].field
    return reason, field
