"""Deadlines, retries, errors, pages."""

import asyncio
import time

import grpc
import numpy as np
import pytest
from conftest import refuse

import percept
from percept import AsyncClient, Client, InvalidArgument, NotFound, Unavailable
from percept import _rpc as rpc
from percept.v1 import object_pb2, session_pb2

DEPTH = np.ones((2, 3), np.float32)


def test_an_error_carries_code_reason_field_and_message(fake, client):
    fake.unary(
        rpc.GET_SESSION,
        lambda _, c: refuse(c, grpc.StatusCode.NOT_FOUND, "SESSION_NOT_FOUND", "session_id", "no session x"),
    )
    with pytest.raises(NotFound) as error:
        client.sessions.get("x")
    e = error.value
    assert (e.code, e.reason, e.field) == ("NOT_FOUND", "SESSION_NOT_FOUND", "session_id")
    assert e.message == "no session x"
    assert str(e) == "no session x (field session_id) [SESSION_NOT_FOUND]"


def test_errors_without_details_or_of_other_codes_are_still_ours(fake, client):
    fake.unary(rpc.GET_SESSION, lambda _, c: c.abort(grpc.StatusCode.OUT_OF_RANGE, "far"))
    with pytest.raises(InvalidArgument, match="far"):
        client.sessions.get("x")
    with pytest.raises(percept.PerceptError) as error:
        client.sessions.default_params()
    assert error.value.code == "UNIMPLEMENTED"


def away_at_first(times, answer):
    """Unavailable so many times, then the answer."""
    left = [times]

    def handler(request, context):
        if left[0]:
            left[0] -= 1
            context.abort(grpc.StatusCode.UNAVAILABLE, "stopping")
        return answer

    return handler


def test_a_repeatable_call_is_tried_again_while_the_server_is_away(fake, client):
    fake.unary(rpc.GET_POSE, away_at_first(2, rpc.GET_POSE.answer()))
    assert client.session("s").pose() is None
    assert len(fake.calls) == 3


def test_a_creation_is_repeated_with_the_same_request_id(fake, client):
    answer = rpc.CREATE_SESSION.answer(session=session_pb2.Session(session_id="s"))
    fake.unary(rpc.CREATE_SESSION, away_at_first(1, answer))
    assert client.sessions.create().session_id == "s"
    assert fake.calls[0].request_id == fake.calls[1].request_id != ""


def test_a_frame_is_never_sent_twice(fake, client):
    fake.unary(rpc.SEND_FRAME, away_at_first(1, rpc.SEND_FRAME.answer()))
    with pytest.raises(Unavailable):
        client.session("s").send_depth("d", stamp_ns=1, depth=DEPTH)
    assert len(fake.calls) == 1


def test_the_deadline_bounds_a_call(fake):
    def slow(request, context):
        time.sleep(1)
        return rpc.GET_POSE.answer()

    fake.unary(rpc.GET_POSE, slow)
    with Client(fake.address, timeout_s=0.1) as client, pytest.raises(percept.DeadlineExceeded):
        client.session("s").pose()


def test_nobody_at_the_address_is_unavailable_and_not_healthy():
    with Client("127.0.0.1:1", timeout_s=1.0, retries=1) as client:
        assert client.health(timeout_s=0.3) is False
        with pytest.raises(Unavailable):
            client.session("s").pose()


def paged(request, context):
    first = int(request.page_token or 0)
    numbers = range(first, min(first + request.page_size, 7))
    token = str(numbers.stop) if numbers.stop < 7 else ""
    objects = [object_pb2.Object(object_id=i) for i in numbers]
    return rpc.LIST_OBJECTS.answer(objects=objects, next_page_token=token)


def test_pages_are_followed_as_they_are_used(fake, client):
    fake.unary(rpc.LIST_OBJECTS, paged)
    objects = client.session("s").scene.objects(page_size=3)
    assert next(objects).object_id == 0
    assert len(fake.calls) == 1
    assert [o.object_id for o in objects] == [1, 2, 3, 4, 5, 6]
    assert len(fake.calls) == 3


def test_chunks_of_a_trajectory_are_joined(fake, client):
    def chunks(request, context):
        for i in range(3):
            pose = session_pb2.TrajectoryPose(stamp_ns=i, state=session_pb2.TRACKING_STATE_TRACKING)
            pose.t_map_base.translation.x = i
            yield rpc.GET_TRAJECTORY.answer(map_version=4, poses=[pose])

    fake.streaming(rpc.GET_TRAJECTORY, chunks)
    trajectory = client.session("s").trajectory()
    assert trajectory.stamps_ns.tolist() == [0, 1, 2]
    assert trajectory.t_map_base.shape == (3, 4, 4)
    assert trajectory.t_map_base[2, 0, 3] == 2
    assert trajectory.length_m == pytest.approx(2)
    assert trajectory.states == ("tracking",) * 3


def test_asyncio_does_the_same(fake):
    fake.unary(rpc.LIST_OBJECTS, paged)
    fake.unary(rpc.GET_POSE, away_at_first(1, rpc.GET_POSE.answer()))
    fake.unary(
        rpc.GET_OBJECT, lambda _, c: refuse(c, grpc.StatusCode.NOT_FOUND, "OBJECT_NOT_FOUND", "object_id")
    )

    async def scenario():
        async with AsyncClient(fake.address, timeout_s=5.0) as client:
            session = client.session("s")
            assert await session.pose() is None
            assert [o.object_id async for o in session.scene.objects(page_size=4)] == list(range(7))
            with pytest.raises(NotFound) as error:
                await session.scene.object(3)
            assert error.value.reason == "OBJECT_NOT_FOUND"
            assert await client.health() is False

    asyncio.run(scenario())
