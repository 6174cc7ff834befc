"""A client that is closed: what was under way ends with an error of ours, what comes later is refused so."""

import asyncio
import sys
import threading
import time

import grpc
import numpy as np
import pytest
from conftest import ack_of, eventually, refuse

from percept import AsyncClient, Client, DeadlineExceeded, PerceptError, Unavailable
from percept import _rpc as rpc
from percept.v1 import session_pb2

DEPTH = np.ones((2, 3), np.float32)


def held(request, context):
    while context.is_active():
        time.sleep(0.005)
    return rpc.GET_POSE.answer()


def held_after_one(request, context):
    yield rpc.WATCH_SESSION.answer(event=session_pb2.SessionEvent(token=1))
    while context.is_active():
        time.sleep(0.005)


def nothing(request, context):
    while context.is_active():
        time.sleep(0.005)
    yield from ()


def kept_in_memory(requests, context):
    for request in requests:
        yield ack_of(request.message, 0)


def away_for_long(request, context):
    refuse(context, grpc.StatusCode.UNAVAILABLE, "STOPPING", "", retry_s=20)


@pytest.fixture
def holding(fake):
    """A server that answers nothing in time."""
    fake.unary(rpc.GET_POSE, held)
    fake.unary(rpc.LIST_OBJECTS, held)
    fake.unary(rpc.DELETE_SESSION, away_for_long)
    fake.unary(rpc.GET_SESSION, away_for_long)
    fake.streaming(rpc.GET_TRAJECTORY, nothing)
    fake.streaming(rpc.WATCH_SESSION, held_after_one)
    fake.bidi(rpc.STREAM_FRAMES, kept_in_memory)
    return fake


def is_said_to_be_closed(error):
    return isinstance(error, Unavailable) and error.reason == "CLIENT_CLOSED"


def watched(session):
    for _ in session.watch(resume_token=0):
        pass


#: Calls that are under way, or between two tries, for long.
CALLS = {
    "unary": lambda s: s.pose(),
    "chunked": lambda s: s.trajectory(),
    "paged": lambda s: list(s.scene.objects()),
    "tried again": lambda s: s.info(),
    "watch": watched,
}


def raised_by(work):
    try:
        work()
    except BaseException as error:
        return error
    return None


@pytest.mark.parametrize("kind", CALLS)
def test_calls_under_way_end_with_the_client(holding, kind):
    client = Client(holding.address)
    errors = []
    caller = threading.Thread(
        target=lambda: errors.append(raised_by(lambda: CALLS[kind](client.session("s")))), daemon=True
    )
    caller.start()
    assert eventually(lambda: holding.calls)
    client.close()
    caller.join(5)
    assert not caller.is_alive()
    assert is_said_to_be_closed(errors[0]), repr(errors[0])


def test_a_closed_client_says_so(holding):
    client = Client(holding.address)
    session = client.session("s")
    client.close()
    client.close()
    later = {**CALLS, "delete": lambda s: s.delete(), "health": lambda _: client.health()}
    for kind, call in later.items():
        error = raised_by(lambda call=call: call(session))
        assert is_said_to_be_closed(error), (kind, repr(error))
    stream = session.stream()
    with pytest.raises(Unavailable) as error:
        stream.send_depth("d", stamp_ns=1, depth=DEPTH)
        stream.close()
    assert error.value.reason == "CLIENT_CLOSED"
    assert holding.calls == []


async def watched_async(session):
    async for _ in session.watch(resume_token=0):
        pass


async def listed_async(session):
    return [o async for o in session.scene.objects()]


ASYNC_CALLS = {
    "unary": lambda s: s.pose(),
    "chunked": lambda s: s.trajectory(),
    "paged": listed_async,
    "tried again": lambda s: s.info(),
    "watch": watched_async,
}


async def raised_in(call):
    try:
        await call
    except BaseException as error:
        return error
    return None


@pytest.mark.parametrize("kind", ASYNC_CALLS)
def test_asyncio_calls_under_way_end_with_the_client(holding, kind):
    """They were cancelled, as if it were their task that nobody wants any more."""

    async def scenario():
        client = AsyncClient(holding.address)
        caller = asyncio.create_task(raised_in(ASYNC_CALLS[kind](client.session("s"))))
        while not holding.calls:
            await asyncio.sleep(0.005)
        await client.close()
        return await asyncio.wait_for(caller, 5)

    error = asyncio.run(scenario())
    assert is_said_to_be_closed(error), repr(error)


def test_a_closed_asyncio_client_says_so(holding):
    async def scenario():
        client = AsyncClient(holding.address)
        session = client.session("s")
        await client.close()
        await client.close()
        later = {**ASYNC_CALLS, "delete": lambda s: s.delete(), "health": lambda _: client.health()}
        for kind, call in later.items():

            async def made(call=call):
                await call(session)

            error = await raised_in(made())
            assert is_said_to_be_closed(error), (kind, repr(error))
        stream = session.stream()
        with pytest.raises(Unavailable) as error:
            await stream.send_depth("d", stamp_ns=1, depth=DEPTH)
            await stream.close()
        assert error.value.reason == "CLIENT_CLOSED"

    asyncio.run(scenario())


@pytest.mark.skipif(sys.version_info < (3, 11), reason="Python 3.10 does not tell who cancelled")
def test_a_cancelled_asyncio_call_is_cancelled_whatever_becomes_of_the_client(holding):
    async def scenario():
        client = AsyncClient(holding.address)
        caller = asyncio.create_task(client.session("s").pose())
        while not holding.calls:
            await asyncio.sleep(0.005)
        caller.cancel()
        await client.close()
        with pytest.raises(asyncio.CancelledError):
            await caller

    asyncio.run(scenario())


def test_frames_that_were_accepted_and_are_not_durable_are_missed_when_the_client_is_closed(holding):
    """The summary was returned as if all were well."""
    client = Client(holding.address)
    stream = client.session("s").stream()
    stream.send_depth("d", stamp_ns=1, depth=DEPTH)
    assert len(list(stream.acks())) == 1
    client.close()
    with pytest.raises(Unavailable) as error:
        stream.close()
    assert error.value.reason == "CLIENT_CLOSED"
    assert (stream.summary.accepted, stream.summary.durable) == (1, 0)


def test_so_they_are_in_asyncio(holding):
    async def scenario():
        client = AsyncClient(holding.address)
        stream = client.session("s").stream()
        await stream.send_depth("d", stamp_ns=1, depth=DEPTH)
        assert len([a async for a in stream.acks()]) == 1
        await client.close()
        with pytest.raises(Unavailable) as error:
            await stream.close()
        assert error.value.reason == "CLIENT_CLOSED"

    asyncio.run(scenario())


def test_a_stream_that_waits_for_its_server_ends_with_its_client(fake):
    fake.bidi(rpc.STREAM_FRAMES, away_for_long)
    client = Client(fake.address)
    stream = client.session("s").stream()
    stream.send_depth("d", stamp_ns=1, depth=DEPTH)
    assert eventually(lambda: fake.calls)
    client.close()
    error = raised_by(stream.close)
    assert is_said_to_be_closed(error), repr(error)


def test_leaving_the_block_ends_a_stream_that_could_not_be_closed(fake):
    """It went on beside the caller."""
    fake.bidi(rpc.STREAM_FRAMES, nothing)
    with Client(fake.address, timeout_s=0.2) as client:
        with client.session("s").stream() as stream:
            stream.send_depth("d", stamp_ns=1, depth=DEPTH)
            with pytest.raises(DeadlineExceeded):
                stream.close()
        assert "percept-stream" not in {thread.name for thread in threading.enumerate()}

    async def scenario():
        async with AsyncClient(fake.address, timeout_s=0.2) as client:
            async with client.session("s").stream() as stream:
                await stream.send_depth("d", stamp_ns=1, depth=DEPTH)
                with pytest.raises(DeadlineExceeded):
                    await stream.close()
            return {task.get_name() for task in asyncio.all_tasks()}

    assert "percept-stream" not in asyncio.run(scenario())


def test_a_client_may_be_closed_while_many_ask(fake):
    fake.unary(rpc.GET_POSE, lambda *_: rpc.GET_POSE.answer())
    client = Client(fake.address)
    errors = []

    def ask():
        session = client.session("s")
        while (error := raised_by(session.pose)) is None:
            pass
        errors.append(error)

    askers = [threading.Thread(target=ask, daemon=True) for _ in range(6)]
    for asker in askers:
        asker.start()
    assert eventually(lambda: len(fake.calls) > 20)
    client.close()
    for asker in askers:
        asker.join(5)
    assert len(errors) == 6
    assert all(isinstance(error, PerceptError) and is_said_to_be_closed(error) for error in errors), errors
