"""Streams of frames and events against the stand-in."""

import asyncio
import threading
import time

import grpc
import numpy as np
import pytest
from conftest import ack_of, refuse

import percept
from percept import AsyncClient, Client, FailedPrecondition, NotFound, Resync, Unavailable
from percept import _rpc as rpc
from percept.v1 import session_pb2

DEPTH = np.ones((2, 3), np.float32)


def acknowledge(requests, context):
    """Refuses every third frame; a last acknowledgement without an outcome tells the end."""
    count = 0
    for request in requests:
        count += 1
        yield ack_of(request.message, count - 1, "STAMP_NOT_INCREASING" if count % 3 == 0 else "")
    yield rpc.STREAM_FRAMES.answer(ack=session_pb2.FrameAck(durable_count=count))


def test_leaving_the_block_waits_for_every_acknowledgement(fake, client):
    fake.bidi(rpc.STREAM_FRAMES, acknowledge)
    with client.session("s").stream() as stream:
        for i in range(100):
            stream.send_depth("d", stamp_ns=i, depth=DEPTH)
    summary = stream.summary
    assert (summary.sent, summary.accepted, summary.rejected, summary.durable) == (100, 67, 33, 100)
    assert summary.rejections[0].rejection.reason == "STAMP_NOT_INCREASING"
    assert summary.rejections[0].stamp_ns == 2


def test_acks_come_in_order_and_end_when_none_is_outstanding(fake, client):
    fake.bidi(rpc.STREAM_FRAMES, acknowledge)
    with client.session("s").stream() as stream:
        for i in range(6):
            stream.send_depth("d", stamp_ns=i, depth=DEPTH)
        acks = list(stream.acks())
        assert [a.stamp_ns for a in acks] == list(range(6))
        assert [a.accepted for a in acks] == [True, True, False] * 2
        stream.send_depth("d", stamp_ns=6, depth=DEPTH)
        assert [a.sequence for a in stream.acks()] == [7]


def test_the_first_frame_that_is_refused_for_a_reason_is_told(fake, client, caplog):
    # A stream into a session without its sensor went through without a word.
    fake.bidi(rpc.STREAM_FRAMES, acknowledge)
    with client.session("s").stream() as stream:
        for i in range(9):
            stream.send_depth("d", stamp_ns=i, depth=DEPTH)
    assert stream.summary.rejected == 3
    [told] = [r.getMessage() for r in caplog.records if r.name == "percept"]
    assert told.startswith("session s refused frame 3 of d: ")
    assert "[STAMP_NOT_INCREASING]; the stream's summary counts" in told


def test_frames_are_numbered_for_each_sensor(fake, client):
    fake.bidi(rpc.STREAM_FRAMES, acknowledge)
    with client.session("s").stream() as stream:
        for sensor in ("a", "b", "a", "b"):
            stream.send_depth(sensor, stamp_ns=1, depth=DEPTH)
        assert [(a.sensor_id, a.sequence) for a in stream.acks()] == [("a", 1), ("b", 1), ("a", 2), ("b", 2)]


def test_a_slow_server_makes_the_sender_wait(fake, client):
    release = threading.Event()

    def slow(requests, context):
        for count, request in enumerate(requests, 1):
            if count > 4:
                release.wait(10)
            yield ack_of(request.message, count)

    fake.bidi(rpc.STREAM_FRAMES, slow)
    sent = []

    def send_all(stream):
        for i in range(20):
            stream.send_depth("d", stamp_ns=i, depth=DEPTH)
            sent.append(i)

    with client.session("s").stream(max_in_flight=3) as stream:
        sender = threading.Thread(target=send_all, args=[stream])
        sender.start()
        deadline = time.monotonic() + 5
        while len(sent) < 7 and time.monotonic() < deadline:
            time.sleep(0.01)
        # 4 answered, 3 in flight, and no more than that.
        sender.join(0.3)
        assert len(sent) == 7
        release.set()
        sender.join(10)
        assert len(sent) == 20


def test_a_stalled_server_ends_the_wait_by_the_deadline(fake):
    done = threading.Event()

    def silent(requests, context):
        done.wait(10)
        yield from ()

    fake.bidi(rpc.STREAM_FRAMES, silent)
    with Client(fake.address, timeout_s=0.2) as client:
        stream = client.session("s").stream(max_in_flight=1)
        stream.send_depth("d", stamp_ns=1, depth=DEPTH)
        with pytest.raises(percept.DeadlineExceeded):
            stream.send_depth("d", stamp_ns=2, depth=DEPTH)
        stream.cancel()
    done.set()


def test_what_ended_the_stream_is_raised_to_the_sender(fake, client):
    def refused(requests, context):
        next(requests)
        refuse(context, grpc.StatusCode.NOT_FOUND, "SESSION_NOT_FOUND", "session_id")
        yield

    fake.bidi(rpc.STREAM_FRAMES, refused)
    with pytest.raises(NotFound) as error, client.session("s").stream(max_in_flight=2) as stream:
        for i in range(10):
            stream.send_depth("d", stamp_ns=i, depth=DEPTH)
    assert error.value.reason == "SESSION_NOT_FOUND"


def test_a_stream_that_the_server_ends_early_is_not_a_success(fake, client):
    def short(requests, context):
        yield ack_of(next(requests).message, 1)

    fake.bidi(rpc.STREAM_FRAMES, short)
    stream = client.session("s").stream(resume=False)
    stream.send_depth("d", stamp_ns=1, depth=DEPTH)
    assert next(stream.acks()).accepted
    with pytest.raises(Unavailable) as error:
        for i in range(2, 1000):
            stream.send_depth("d", stamp_ns=i, depth=DEPTH)
            time.sleep(0.001)
    assert error.value.reason == "STREAM_ENDED"


def test_a_closed_stream_takes_nothing(fake, client):
    fake.bidi(rpc.STREAM_FRAMES, acknowledge)
    with client.session("s").stream() as stream:
        pass
    with pytest.raises(FailedPrecondition):
        stream.send_depth("d", stamp_ns=1, depth=DEPTH)


def test_asyncio_streams_do_the_same(fake):
    fake.bidi(rpc.STREAM_FRAMES, acknowledge)

    async def scenario():
        async with AsyncClient(fake.address, timeout_s=5.0) as client:
            async with client.session("s").stream(max_in_flight=4) as stream:
                for i in range(30):
                    await stream.send_depth("d", stamp_ns=i, depth=DEPTH)
                acks = [a async for a in stream.acks()]
            return acks, stream.summary

    acks, summary = asyncio.run(scenario())
    assert [a.stamp_ns for a in acks] == list(range(30))
    assert (summary.sent, summary.rejected, summary.durable) == (30, 10, 30)


def test_an_asyncio_stream_raises_what_ended_it(fake):
    def refused(requests, context):
        next(requests)
        refuse(context, grpc.StatusCode.UNAVAILABLE, "STOPPING", "")
        yield

    fake.bidi(rpc.STREAM_FRAMES, refused)

    async def scenario():
        async with (
            AsyncClient(fake.address, timeout_s=5.0) as client,
            client.session("s").stream(max_in_flight=2, resume=False) as stream,
        ):
            for i in range(10):
                await stream.send_depth("d", stamp_ns=i, depth=DEPTH)

    with pytest.raises(Unavailable) as error:
        asyncio.run(scenario())
    # grpc.aio loses the server's own reason if a write is under way.
    assert error.value.reason in ("STOPPING", "STREAM_ENDED")


def events(first, last):
    for token in range(first, last + 1):
        yield rpc.WATCH_SESSION.answer(event=session_pb2.SessionEvent(token=token, map_version=token))


def test_a_watch_goes_on_where_it_stopped_when_the_server_comes_back(fake, client):
    tries = []

    def watch(request, context):
        tries.append(request.resume_token if request.HasField("resume_token") else None)
        if len(tries) == 1:
            yield from events(1, 3)
            context.abort(grpc.StatusCode.UNAVAILABLE, "stopping")
        yield from events(request.resume_token + 1, 6)
        yield rpc.WATCH_SESSION.answer(event=session_pb2.SessionEvent(token=7, resync={"missed": 2}))

    fake.streaming(rpc.WATCH_SESSION, watch)
    with client.session("s").watch() as watch:
        seen = list(watch)
    assert tries == [None, 3]
    assert [e.token for e in seen] == [1, 2, 3, 4, 5, 6, 7]
    assert seen[-1].event == Resync(missed=2)
    assert watch.token == 7


def test_a_watch_can_be_closed_while_it_waits(fake, client):
    def watch(request, context):
        yield from events(1, 1)
        while context.is_active():
            time.sleep(0.01)

    fake.streaming(rpc.WATCH_SESSION, watch)
    watch = client.session("s").watch(resume_token=0)
    assert next(watch).token == 1
    threading.Timer(0.1, watch.close).start()
    assert list(watch) == []


def test_asyncio_watches_do_the_same(fake):
    fake.streaming(rpc.WATCH_SESSION, lambda request, context: events(request.resume_token + 1, 5))

    async def scenario():
        async with AsyncClient(fake.address) as client, client.session("s").watch(resume_token=2) as watch:
            return [e.token async for e in watch]

    assert asyncio.run(scenario()) == [3, 4, 5]
