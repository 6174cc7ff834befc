"""Operations: work at the server that goes on whoever hangs up."""

from __future__ import annotations

from dataclasses import dataclass

from ._value import Name, Value


class OperationKind(Name):
    """What an operation does."""

    UNSPECIFIED = "unspecified"
    OPTIMISE_MAP = "optimise_map"
    EXPORT_MAP = "export_map"
    RUN_PIPELINE = "run_pipeline"
    REGISTER_CLOUDS_GLOBALLY = "register_clouds_globally"
    IMPORT_MAP = "import_map"


class OperationState(Name):
    """How an operation stands; the last three are ends."""

    UNSPECIFIED = "unspecified"
    #: Waits for its turn.
    QUEUED = "queued"
    RUNNING = "running"
    #: It has a result.
    DONE = "done"
    #: It has an error.
    FAILED = "failed"
    #: It was cancelled before it was done.
    CANCELLED = "cancelled"


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class OperationFault(Value):
    """Why an operation has no result; result() raises it."""

    #: Name of the gRPC code.
    code: str
    #: Stable, upper-case.
    reason: str
    #: One sentence: field, value, remedy.
    message: str
    #: Path of the offending field; empty if none.
    field: str


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class OperationInfo(Value):
    """An operation as it was when the server was asked."""

    #: Names it; nobody can guess it.
    operation_id: str
    kind: OperationKind
    #: The session whose map it is about; empty if none.
    session_id: str
    state: OperationState
    #: Share that is done, 0 to 1; None where nothing can be counted.
    fraction: float | None
    #: What is being done; empty before it runs.
    stage: str
    #: Whether cancel() was asked for; it may be done all the same.
    cancel_requested: bool
    #: Of one that failed or was cancelled.
    fault: OperationFault | None
    #: Of one that is done.
    result_size_bytes: int | None
    #: When it was started, by the server's clock, nanoseconds.
    create_time_ns: int
    #: When it began to run.
    run_time_ns: int | None
    #: When it ended; None before.
    end_time_ns: int | None
    #: When it is forgotten; None before its end.
    expire_time_ns: int | None
    #: As it was started with.
    request_id: str

    @property
    def has_ended(self) -> bool:
        """Whether it changes no more."""
        return self.state in (OperationState.DONE, OperationState.FAILED, OperationState.CANCELLED)
