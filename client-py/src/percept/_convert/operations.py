"""Operations: a call of the contract as work that goes on by itself."""

from __future__ import annotations

import uuid
from collections.abc import Callable
from typing import Any

from .. import _rpc
from .._call import Call, ChunkedCall, PagedCall
from .._parts import joined
from .._rpc import A, Q, Rpc
from ..types.operations import OperationFault, OperationInfo, OperationKind, OperationState
from ..v1 import error_pb2
from ..v1 import operations_service_pb2 as service
from . import map_import, maps, words
from .toolbox import kept, registration

#: What can be started, by its field in the request.
_WORK: dict[str, Rpc[Any, Any]] = {
    "optimise_map": _rpc.OPTIMISE_MAP,
    "export_map": _rpc.EXPORT_MAP,
    "run_pipeline": _rpc.RUN_PIPELINE,
    "register_clouds_globally": _rpc.REGISTER_CLOUDS_GLOBALLY,
    "import_map": _rpc.IMPORT_MAP,
}
#: What comes of it, of the parts of the plain call's answer.
_READ: dict[str, Callable[[list[Any]], Any]] = {
    "optimise_map": lambda parts: maps.optimised(joined(parts)),
    "export_map": lambda parts: maps.file([part.chunk for part in parts]),
    "run_pipeline": lambda parts: kept.pipeline_result(joined(parts)),
    "register_clouds_globally": lambda parts: registration.global_registration(joined(parts)),
    "import_map": lambda parts: map_import.imported(joined(parts)),
}


def info(message: service.Operation) -> OperationInfo:
    """An operation."""
    progress = message.progress
    return OperationInfo(
        operation_id=message.operation_id,
        kind=words.word(OperationKind, service.OperationKind, message.kind),
        session_id=message.session_id,
        state=words.word(OperationState, service.OperationState, message.state),
        fraction=progress.fraction if progress.HasField("fraction") else None,
        stage=progress.stage,
        cancel_requested=message.cancel_requested,
        fault=_fault(message.error) if message.HasField("error") else None,
        result_size_bytes=message.result_size_bytes if message.HasField("result_size_bytes") else None,
        create_time_ns=message.create_time_ns,
        run_time_ns=message.run_time_ns if message.HasField("run_time_ns") else None,
        end_time_ns=message.end_time_ns if message.HasField("end_time_ns") else None,
        expire_time_ns=message.expire_time_ns if message.HasField("expire_time_ns") else None,
        request_id=message.request_id,
    )


def _fault(error: error_pb2.ErrorInfo) -> OperationFault:
    return OperationFault(code=error.code, reason=error.reason, message=error.message, field=error.field)


def start(
    call: Call[Q, A, Any] | ChunkedCall[Q, A, Any], request_id: str | None
) -> Call[service.StartOperationRequest, service.StartOperationResponse, OperationInfo]:
    """Starts what the call would do; with a request id of its own, so that it can be repeated."""
    request = service.StartOperationRequest(request_id=request_id or uuid.uuid4().hex)
    [field] = [name for name, rpc in _WORK.items() if rpc is call.rpc]
    getattr(request, field).CopyFrom(call.request)
    return Call(_rpc.START_OPERATION, request, lambda a: info(a.operation))


def get(
    operation_id: str,
) -> Call[service.GetOperationRequest, service.GetOperationResponse, OperationInfo]:
    request = service.GetOperationRequest(operation_id=operation_id)
    return Call(_rpc.GET_OPERATION, request, lambda a: info(a.operation))


def list_operations(
    state: OperationState | str | None, session_pattern: str, page_size: int
) -> PagedCall[service.ListOperationsRequest, service.ListOperationsResponse, OperationInfo]:
    request = service.ListOperationsRequest(page_size=page_size, session_pattern=session_pattern)
    if state is not None:
        request.state = words.number("state", service.OperationState, state)
    return PagedCall(_rpc.LIST_OPERATIONS, request, lambda a: [info(o) for o in a.operations])


def wait(
    operation_id: str, timeout_s: float
) -> Call[service.WaitOperationRequest, service.WaitOperationResponse, OperationInfo]:
    request = service.WaitOperationRequest(operation_id=operation_id, timeout_s=timeout_s)
    return Call(_rpc.WAIT_OPERATION, request, lambda a: info(a.operation))


def cancel(
    operation_id: str,
) -> Call[service.CancelOperationRequest, service.CancelOperationResponse, OperationInfo]:
    request = service.CancelOperationRequest(operation_id=operation_id)
    return Call(_rpc.CANCEL_OPERATION, request, lambda a: info(a.operation))


def result(
    operation_id: str,
) -> ChunkedCall[service.ReadOperationResultRequest, service.ReadOperationResultResponse, Any]:
    """What the plain call would have given."""

    def read(parts: list[service.ReadOperationResultResponse]) -> Any:  # noqa: ANN401
        [field] = {part.WhichOneof("result") for part in parts}
        return _READ[field or ""]([getattr(part, field or "") for part in parts])

    request = service.ReadOperationResultRequest(operation_id=operation_id)
    return ChunkedCall(_rpc.READ_OPERATION_RESULT, request, read)


def delete(
    operation_id: str,
) -> Call[service.DeleteOperationRequest, service.DeleteOperationResponse, None]:
    request = service.DeleteOperationRequest(operation_id=operation_id)
    return Call(_rpc.DELETE_OPERATION, request, lambda _: None)
