"""A stand-in for the server: just enough of the contract to test the client's own behaviour."""

from __future__ import annotations

import time
from concurrent import futures

import grpc
import pytest
from google.protobuf import any_pb2
from google.rpc import error_details_pb2, status_pb2

from percept import Client
from percept import _rpc as rpc
from percept.v1 import error_pb2, session_pb2


class FakeServer:
    def __init__(self, credentials=None):
        self.handlers = {}
        self.calls = []
        #: Headers of each call, as a dict.
        self.headers = []
        self._server = grpc.server(futures.ThreadPoolExecutor(8))
        self._server.add_generic_rpc_handlers([self])
        if credentials is None:
            self.port = self._server.add_insecure_port("127.0.0.1:0")
        else:
            self.port = self._server.add_secure_port("127.0.0.1:0", credentials)
        self._server.start()

    @property
    def address(self):
        return f"127.0.0.1:{self.port}"

    def unary(self, call, answer):
        self._add(call, grpc.unary_unary_rpc_method_handler, answer)

    def streaming(self, call, answers):
        self._add(call, grpc.unary_stream_rpc_method_handler, answers)

    def bidi(self, call, answers):
        self._add(call, grpc.stream_stream_rpc_method_handler, answers)

    def _add(self, call, kind, answer):
        def recorded(request, context):
            self.calls.append(request)
            self.headers.append(dict(context.invocation_metadata()))
            return answer(request, context)

        self.handlers[call.path] = kind(
            recorded,
            request_deserializer=call.request.FromString,
            response_serializer=call.answer.SerializeToString,
        )

    def service(self, details):
        return self.handlers.get(details.method)

    def stop(self):
        self._server.stop(None).wait()


def refuse(context, code, reason, field, message="refused", retry_s=None, metadata=None):
    """Ends a call as percept does."""
    status = status_pb2.Status(code=code.value[0], message=message)
    details = [
        error_details_pb2.ErrorInfo(reason=reason, domain="percept", metadata=metadata),
        error_details_pb2.BadRequest(
            field_violations=[error_details_pb2.BadRequest.FieldViolation(field=field)]
        ),
    ]
    if retry_s is not None:
        retry = error_details_pb2.RetryInfo()
        retry.retry_delay.FromMicroseconds(round(retry_s * 1e6))
        details.append(retry)
    for detail in details:
        packed = any_pb2.Any()
        packed.Pack(detail)
        status.details.append(packed)
    context.set_trailing_metadata([("grpc-status-details-bin", status.SerializeToString())])
    context.abort(code, message)


def elsewhere(there):
    """A server that does not have the session, and tells who does; its pause is longer than any patience."""

    def answer(request, context):
        where = there if isinstance(there, str) else there.address
        refuse(
            context,
            grpc.StatusCode.UNAVAILABLE,
            "SESSION_ELSEWHERE",
            "session_id",
            retry_s=3600,
            metadata={"server": where},
        )

    return answer


def eventually(check, seconds=10.0):
    """The first truthy value of `check`, asked again until time is up."""
    deadline = time.monotonic() + seconds
    while not (value := check()) and time.monotonic() < deadline:
        time.sleep(0.005)
    return value


def ack_of(message, durable, reason="", code="INVALID_ARGUMENT"):
    """An acknowledgement as percept sends it."""
    ack = session_pb2.FrameAck(
        sensor_id=message.sensor_id,
        sequence=message.sequence,
        stamp_ns=message.stamp_ns,
        durable_count=durable,
    )
    if reason:
        ack.rejection.CopyFrom(error_pb2.ErrorInfo(reason=reason, code=code))
    else:
        ack.result.latency_s = 0.001
    return rpc.STREAM_FRAMES.answer(ack=ack)


@pytest.fixture
def fake():
    server = FakeServer()
    yield server
    server.stop()


@pytest.fixture
def other():
    server = FakeServer()
    yield server
    server.stop()


@pytest.fixture
def client(fake):
    with Client(fake.address, timeout_s=5.0) as client:
        yield client
