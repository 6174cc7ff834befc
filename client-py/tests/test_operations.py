"""Operations as the client sees them: waits made of several, results by kind, failures as of plain calls."""

import asyncio

import pytest

from percept import AsyncClient, DeadlineExceeded, FailedPrecondition, InvalidArgument, OperationFault
from percept import _rpc as rpc
from percept.v1 import operations_service_pb2 as service

QUEUED, RUNNING, DONE, FAILED, CANCELLED = range(1, 6)


def standing(state, **fields):
    return service.Operation(operation_id="op-1", kind=1, state=state, **fields)


def started(fake, state=QUEUED):
    fake.unary(rpc.START_OPERATION, lambda *_: rpc.START_OPERATION.answer(operation=standing(state)))


def waits(fake, *operations):
    left = list(operations)
    fake.unary(rpc.WAIT_OPERATION, lambda *_: rpc.WAIT_OPERATION.answer(operation=left.pop(0)))


def test_a_start_is_the_plain_call_within_one_that_may_be_repeated(fake, client):
    started(fake)
    operation = client.session("s").map.start_export("cloud_ply")
    assert fake.calls[0].export_map.source.session_id == "s"
    assert fake.calls[0].request_id
    assert (operation.operation_id, operation.info.state, operation.info.fraction) == ("op-1", "queued", None)
    client.session("s").map.start_optimise(request_id="mine")
    assert (fake.calls[1].WhichOneof("work"), fake.calls[1].request_id) == ("optimise_map", "mine")


def test_a_long_wait_is_made_of_calls_that_end_within_their_deadline(fake, client):
    started(fake)
    operation = client.session("s").map.start_optimise()
    halfway = standing(RUNNING, progress={"fraction": 0.5, "stage": "step 2 of 4"})
    waits(fake, standing(QUEUED), halfway, standing(DONE))
    assert operation.wait().state == "done"
    asked = [call.timeout_s for call in fake.calls[1:]]
    assert len(asked) == 3
    assert all(0 < timeout_s < 5 for timeout_s in asked)


def test_a_wait_ends_with_its_own_time_and_says_how_it_stands(fake, client):
    started(fake)
    operation = client.session("s").map.start_optimise()
    waits(
        fake,
        standing(RUNNING, progress={"fraction": 0.25, "stage": "a"}),
        standing(RUNNING),
        standing(RUNNING),
    )
    info = operation.wait(0.0)
    assert (info.state, info.fraction, info.stage, info.has_ended) == ("running", 0.25, "a", False)
    with pytest.raises(DeadlineExceeded) as error:
        operation.result(timeout_s=0.0)
    assert error.value.reason == "OPERATION_NOT_DONE"


def test_a_result_is_read_by_its_kind_from_its_parts(fake, client):
    started(fake, DONE)

    def parts(request, context):
        for label in (b"\0\0\0\0", b"\xff\xff\xff\xff"):
            part = rpc.READ_OPERATION_RESULT.answer()
            result = part.run_pipeline.results.add(operation="cluster_points")
            result.clusters.labels = label
            yield part

    fake.streaming(rpc.READ_OPERATION_RESULT, parts)
    fake.unary(rpc.GET_OPERATION, lambda *_: rpc.GET_OPERATION.answer(operation=standing(DONE)))
    [step] = client.operations.get("op-1").result().steps
    assert (step.operation, step.answer.labels.tolist()) == ("cluster_points", [0, -1])


@pytest.mark.parametrize(
    ("state", "code", "kind"),
    [(FAILED, "INVALID_ARGUMENT", InvalidArgument), (CANCELLED, "FAILED_PRECONDITION", FailedPrecondition)],
)
def test_what_has_no_result_raises_what_the_plain_call_would_have(fake, client, state, code, kind):
    error = {"reason": "WHY", "message": "so it is", "field": "steps[0]", "code": code}
    fake.unary(rpc.GET_OPERATION, lambda *_: rpc.GET_OPERATION.answer(operation=standing(state, error=error)))
    operation = client.operations.get("op-1")
    assert operation.info.fault == OperationFault(**error)
    with pytest.raises(kind) as raised:
        operation.result()
    assert (raised.value.reason, raised.value.field, raised.value.message) == ("WHY", "steps[0]", "so it is")


def test_asyncio_watches_until_the_end(fake):
    started(fake)
    fake.unary(rpc.GET_OPERATION, lambda *_: rpc.GET_OPERATION.answer(operation=standing(QUEUED)))
    waits(fake, standing(RUNNING), standing(DONE))

    async def scenario():
        async with AsyncClient(fake.address, timeout_s=5.0) as client:
            operation = await client.session("s").map.start_optimise()
            return [info.state async for info in operation.watch(every_s=0.0)]

    assert asyncio.run(scenario()) == ["queued", "running", "done"]
