"""Streams of frames whose link breaks: what is sent again, what is told to the sender, when it gives up."""

import asyncio
import threading
import time
from types import SimpleNamespace

import grpc
import numpy as np
import pytest
from conftest import ack_of, eventually, refuse

import percept
from percept import AsyncClient, Client, NotFound, PerceptError, StreamBroken, Unauthenticated, Unavailable
from percept import _rpc as rpc
from percept.v1 import session_pb2

DEPTH = np.ones((2, 3), np.float32)


class Connections:
    """A server that does with its first, second ... connection as it is told, and goes on with the last; it
    knows the stamps that it took in, as percept does."""

    def __init__(self, *scripts):
        self.scripts = list(scripts)
        #: Stamps that came over each connection.
        self.seen = []
        self.taken = set()

    def __call__(self, requests, context):
        script = self.scripts.pop(0) if len(self.scripts) > 1 else self.scripts[0]
        stamps = []
        self.seen.append(stamps)
        return script(self, (self._noted(r.message, stamps) for r in requests), context)

    @staticmethod
    def _noted(message, stamps):
        stamps.append(message.stamp_ns)
        return message


def answer(server, message, durable):
    # As the server says it of one just before, and of one some seconds back.
    again = ("STAMP_NOT_INCREASING", "CLOCK_SET_BACK")[message.stamp_ns % 2]
    reason = again if message.stamp_ns in server.taken else ""
    server.taken.add(message.stamp_ns)
    return ack_of(message, durable, reason)


def whole(server, messages, context):
    """Takes all in; the last acknowledgement says that all of it is durable."""
    count = 0
    for message in messages:
        count += 1
        yield answer(server, message, 0)
    yield rpc.STREAM_FRAMES.answer(ack=session_pb2.FrameAck(durable_count=count))


def breaking(*, acked, durable, unanswered=0, code=grpc.StatusCode.UNAVAILABLE, retry_s=None):
    """Acknowledges so many, takes in some more without a word, and goes away."""

    def script(server, messages, context):
        for count in range(1, acked + 1):
            yield answer(server, next(messages), min(count, durable))
        for _ in range(unanswered):
            server.taken.add(next(messages).stamp_ns)
        refuse(context, code, "GONE", "", "gone", retry_s=retry_s)

    return script


def send(stream, stamps):
    for stamp_ns in stamps:
        stream.send_depth("d", stamp_ns=stamp_ns, depth=DEPTH)


def counts(summary):
    return summary.sent, summary.accepted, summary.rejected, summary.durable


def test_what_was_not_durable_is_sent_again_and_each_frame_is_acknowledged_once(fake, client):
    server = Connections(breaking(acked=5, durable=3, unanswered=2), whole)
    fake.bidi(rpc.STREAM_FRAMES, server)
    with client.session("s").stream() as stream:
        send(stream, range(10))
        acks = list(stream.acks())
    assert server.seen[0][:7] == [0, 1, 2, 3, 4, 5, 6]
    # 3 and 4 were acknowledged, but might have been lost.
    assert server.seen[1] == [3, 4, 5, 6, 7, 8, 9]
    assert [a.stamp_ns for a in acks] == list(range(10))
    assert all(a.accepted for a in acks)
    # What came of 5 and 6 was told to nobody.
    assert [a.stamp_ns for a in acks if a.result is None] == [5, 6]
    assert counts(stream.summary) == (10, 10, 0, 10)


def test_a_frame_that_was_refused_is_not_sent_again(fake, client):
    server = Connections(breaking(acked=6, durable=2), whole)
    server.taken = {1, 4}
    fake.bidi(rpc.STREAM_FRAMES, server)
    with client.session("s").stream() as stream:
        send(stream, range(8))
    assert server.seen[1] == [2, 3, 5, 6, 7]
    assert counts(stream.summary) == (8, 6, 2, 8)
    assert [r.stamp_ns for r in stream.summary.rejections] == [1, 4]


@pytest.mark.parametrize(
    ("code", "retry_s"),
    [
        (grpc.StatusCode.UNAVAILABLE, None),
        (grpc.StatusCode.UNAVAILABLE, 0.1),
        (grpc.StatusCode.DEADLINE_EXCEEDED, None),
        (grpc.StatusCode.RESOURCE_EXHAUSTED, 0.1),
    ],
)
def test_a_server_that_can_go_on_later_is_asked_again(fake, client, code, retry_s):
    fake.bidi(rpc.STREAM_FRAMES, Connections(breaking(acked=2, durable=1, code=code, retry_s=retry_s), whole))
    with client.session("s").stream() as stream:
        send(stream, range(5))
    assert counts(stream.summary) == (5, 5, 0, 5)


@pytest.mark.parametrize("code", [grpc.StatusCode.INTERNAL, grpc.StatusCode.RESOURCE_EXHAUSTED])
def test_what_asking_again_would_not_mend_is_raised(fake, client, code):
    fake.bidi(rpc.STREAM_FRAMES, Connections(breaking(acked=2, durable=1, code=code), whole))
    with pytest.raises(PerceptError) as error, client.session("s").stream() as stream:
        send(stream, range(100))
    assert (error.value.code, error.value.reason) == (code.name, "GONE")


def test_a_stamp_that_the_stream_itself_repeats_is_refused_on_any_connection(fake, client):
    server = Connections(breaking(acked=1, durable=0, unanswered=3), whole)
    fake.bidi(rpc.STREAM_FRAMES, server)
    with client.session("s").stream() as stream:
        send(stream, [0, 1, 2, 1, 3])
    assert counts(stream.summary) == (5, 4, 1, 5)
    assert [r.stamp_ns for r in stream.summary.rejections] == [1]


def test_a_frame_that_is_turned_away_for_now_is_sent_again(fake, client):
    def stopping(server, messages, context):
        yield answer(server, next(messages), 1)
        yield ack_of(next(messages), 1, "SESSION_STOPPED", "UNAVAILABLE")
        for message in messages:
            yield ack_of(message, 1, "SESSION_STOPPED", "UNAVAILABLE")

    server = Connections(stopping, whole)
    fake.bidi(rpc.STREAM_FRAMES, server)
    with client.session("s").stream() as stream:
        send(stream, range(5))
    assert server.seen[1] == [1, 2, 3, 4]
    assert counts(stream.summary) == (5, 5, 0, 5)


def test_a_frame_that_one_server_took_and_the_next_turned_away_is_not_refused(fake, client):
    def elsewhere(server, messages, context):
        for message in messages:
            yield ack_of(message, 0, "SESSION_ELSEWHERE", "UNAVAILABLE")

    server = Connections(breaking(acked=1, durable=1, unanswered=2), elsewhere, elsewhere, whole)
    fake.bidi(rpc.STREAM_FRAMES, server)
    with client.session("s").stream() as stream:
        send(stream, range(6))
    # The last one finds 1 and 2 in what the first had taken.
    assert server.seen[3] == [1, 2, 3, 4, 5]
    assert counts(stream.summary) == (6, 6, 0, 6)


def turning_away(*, acked, reason, code):
    """Takes so many in, nothing of it durable, and turns all others away."""

    def script(server, messages, context):
        for count, message in enumerate(messages):
            yield answer(server, message, 0) if count < acked else ack_of(message, 0, reason, code)

    return script


@pytest.mark.parametrize("reason", ["STORAGE_FULL", "SERVER_BUSY", "RATE_LIMITED", "MEMORY_EXHAUSTED"])
def test_a_full_server_drops_nothing_not_even_what_it_had_accepted(fake, client, reason):
    """Frames that were only in its memory were told as refused, and never sent again."""
    full = {"reason": reason, "code": "RESOURCE_EXHAUSTED"}
    server = Connections(turning_away(acked=2, **full), turning_away(acked=0, **full), whole)
    fake.bidi(rpc.STREAM_FRAMES, server)
    with client.session("s").stream() as stream:
        send(stream, range(5))
    assert server.seen[1][0] == 0
    assert server.seen[2] == [0, 1, 2, 3, 4]
    assert counts(stream.summary) == (5, 5, 0, 5)


def test_a_frame_over_a_limit_is_refused_for_good(fake, client):
    def limited(server, messages, context):
        for count, message in enumerate(messages, 1):
            reason = ("", "IMAGE_TOO_LARGE", "MESSAGE_TOO_LARGE")[message.stamp_ns % 3]
            yield ack_of(message, count, reason, "RESOURCE_EXHAUSTED")

    server = Connections(limited)
    fake.bidi(rpc.STREAM_FRAMES, server)
    with client.session("s").stream() as stream:
        send(stream, range(6))
    assert server.seen == [[0, 1, 2, 3, 4, 5]]
    assert counts(stream.summary) == (6, 2, 4, 6)


def test_a_server_that_stays_full_ends_the_stream_with_that(fake, client):
    fake.bidi(
        rpc.STREAM_FRAMES,
        Connections(turning_away(acked=1, reason="STORAGE_FULL", code="RESOURCE_EXHAUSTED")),
    )
    stream = client.session("s").stream(resume_timeout_s=0.3)
    send(stream, range(3))
    with pytest.raises(StreamBroken) as error:
        stream.close()
    assert (error.value.reason, error.value.sent, error.value.durable) == ("STORAGE_FULL", 3, 0)
    assert stream.summary.rejected == 0


def test_without_resuming_a_full_server_refuses_frames(fake, client):
    fake.bidi(
        rpc.STREAM_FRAMES,
        Connections(turning_away(acked=1, reason="STORAGE_FULL", code="RESOURCE_EXHAUSTED")),
    )
    with client.session("s").stream(resume=False) as stream:
        send(stream, range(3))
    assert (stream.summary.accepted, stream.summary.rejected) == (1, 2)


def test_a_frame_that_was_accepted_and_then_turned_away_is_known_as_accepted(fake, client):
    """It was told as refused: the server knew its stamp, and it had been turned away once."""
    away = turning_away(acked=0, reason="STORAGE_FAULT", code="UNAVAILABLE")
    server = Connections(breaking(acked=2, durable=0), away, whole)
    fake.bidi(rpc.STREAM_FRAMES, server)
    with client.session("s").stream() as stream:
        send(stream, range(2))
        acks = list(stream.acks())
    assert [seen[0] for seen in server.seen] == [0, 0, 0]
    assert [a.accepted for a in acks] == [True, True]
    assert counts(stream.summary) == (2, 2, 0, 2)


def test_a_frame_whose_answer_was_lost_and_that_was_then_turned_away_is_known_as_accepted(fake, client):
    away = turning_away(acked=0, reason="STORAGE_FAULT", code="UNAVAILABLE")
    server = Connections(breaking(acked=0, durable=0, unanswered=1), away, whole)
    fake.bidi(rpc.STREAM_FRAMES, server)
    with client.session("s").stream() as stream:
        send(stream, range(2))
    assert counts(stream.summary) == (2, 2, 0, 2)


def test_a_frame_that_was_only_ever_turned_away_is_refused_if_its_stamp_is_too_old_by_then(fake, client):
    def overtaken(server, messages, context):
        yield ack_of(next(messages), 0, "STORAGE_FAULT", "UNAVAILABLE")
        for _ in messages:
            pass

    server = Connections(overtaken, whole)
    # By another sender.
    server.taken = {0}
    fake.bidi(rpc.STREAM_FRAMES, server)
    with client.session("s").stream(max_in_flight=1) as stream:
        send(stream, range(2))
    assert counts(stream.summary) == (2, 1, 1, 2)


@pytest.mark.parametrize("renewed", [True, False])
def test_frames_that_came_with_an_expired_token_are_sent_again_with_the_new_one(fake, tmp_path, renewed):
    file = tmp_path / "token"
    file.write_text("old")

    def expired(server, messages, context):
        yield answer(server, next(messages), 0)
        message = next(messages)
        if renewed:
            file.write_text("renewed")
        yield ack_of(message, 0, "CREDENTIALS_EXPIRED", "UNAUTHENTICATED")

    fake.bidi(rpc.STREAM_FRAMES, Connections(expired, whole))
    with Client(fake.address, token_file=file) as client:
        stream = client.session("s").stream()
        send(stream, range(3))
        if renewed:
            assert counts(stream.close()) == (3, 3, 0, 3)
        else:
            with pytest.raises(Unauthenticated):
                stream.close()


def test_a_stream_that_had_nothing_to_send_while_the_server_was_away_has_all_its_patience(
    fake, client, monkeypatch
):
    """The time was counted from when the link broke, not from the first frame that needed it."""
    ahead_s = [0.0]
    clock = SimpleNamespace(monotonic=lambda: time.monotonic() + ahead_s[0])
    for module in (percept._options, percept._sync.stream):
        monkeypatch.setattr(module, "time", clock)
    server = Connections(breaking(acked=2, durable=2), breaking(acked=0, durable=0), whole)
    fake.bidi(rpc.STREAM_FRAMES, server)
    with client.session("s").stream(resume_timeout_s=30) as stream:
        send(stream, range(2))
        assert len(list(stream.acks())) == 2
        assert eventually(lambda: stream._resuming)
        ahead_s[0] = 3600.0
        send(stream, range(2, 4))
    assert counts(stream.summary) == (4, 4, 0, 4)
    assert len(server.seen) == 3


def test_frames_wait_for_the_server_and_the_sender_is_told_how_many_are_safe(fake):
    fake.bidi(rpc.STREAM_FRAMES, Connections(breaking(acked=4, durable=3), breaking(acked=0, durable=0)))
    with Client(fake.address) as client:
        stream = client.session("s").stream(max_in_flight=3, resume_timeout_s=0.3)
        with pytest.raises(StreamBroken) as error:
            send(stream, range(100))
            stream.close()
        stream.cancel()
    assert isinstance(error.value, Unavailable)
    assert error.value.durable == 3
    assert f"3 of {error.value.sent} frames are durable" in str(error.value)
    assert stream.summary.durable == 3


def test_without_resuming_the_stream_ends_with_what_broke_it(fake, client):
    server = Connections(breaking(acked=2, durable=2), whole)
    fake.bidi(rpc.STREAM_FRAMES, server)
    with pytest.raises(Unavailable, match="gone"), client.session("s").stream(resume=False) as stream:
        send(stream, range(100))
    assert len(server.seen) == 1


def test_what_the_server_refuses_for_good_is_not_tried_again(fake, client):
    def deleted(server, messages, context):
        next(messages)
        refuse(context, grpc.StatusCode.NOT_FOUND, "SESSION_NOT_FOUND", "session_id")
        yield

    server = Connections(breaking(acked=2, durable=0), deleted)
    fake.bidi(rpc.STREAM_FRAMES, server)
    with pytest.raises(NotFound), client.session("s").stream() as stream:
        send(stream, range(100))
    assert len(server.seen) == 2


def test_a_stream_goes_on_with_a_new_token_and_not_with_the_old_one(fake, tmp_path):
    file = tmp_path / "token"
    file.write_text("old")

    def expired(server, messages, context):
        next(messages)
        if server.renew:
            file.write_text("renewed")
        refuse(context, grpc.StatusCode.UNAUTHENTICATED, "TOKEN_EXPIRED", "authorization")
        yield

    server = Connections(expired, whole)
    server.renew = True
    fake.bidi(rpc.STREAM_FRAMES, server)
    with Client(fake.address, token_file=file) as client:
        with client.session("s").stream() as stream:
            send(stream, range(3))
        assert counts(stream.summary) == (3, 3, 0, 3)
        assert [h["authorization"] for h in fake.headers] == ["Bearer old", "Bearer renewed"]
        server.renew, server.scripts = False, [expired]
        with pytest.raises(Unauthenticated), client.session("s").stream() as stream:
            send(stream, range(3))


def test_a_full_buffer_waits_until_what_it_holds_is_durable(fake, client):
    # Durable is only told at a connection's end here: the stream has to ask for it.
    server = Connections(whole)
    fake.bidi(rpc.STREAM_FRAMES, server)
    with client.session("s").stream(resume_buffer_bytes=1500) as stream:
        send(stream, range(30))
    assert counts(stream.summary) == (30, 30, 0, 30)
    assert [stamp for seen in server.seen for stamp in seen] == list(range(30))
    assert len(server.seen) > 3


def test_sensors_do_not_wait_for_a_server_that_is_away_until_the_buffer_is_full(fake, client):
    back = threading.Event()

    def away(server, messages, context):
        if back.is_set():
            yield from whole(server, messages, context)
        context.abort(grpc.StatusCode.UNAVAILABLE, "gone")

    server = Connections(breaking(acked=1, durable=1), away)
    fake.bidi(rpc.STREAM_FRAMES, server)
    sent = []

    def send_all(stream):
        for stamp_ns in range(60):
            send(stream, [stamp_ns])
            sent.append(stamp_ns)

    with client.session("s").stream(max_in_flight=2, resume_buffer_bytes=10_000) as stream:
        sender = threading.Thread(target=send_all, args=[stream])
        sender.start()
        deadline = time.monotonic() + 10
        # Some 300 bytes each: far more fit than the window of a server that is there.
        while len(sent) < 20 and time.monotonic() < deadline:
            time.sleep(0.01)
        sender.join(0.3)
        assert 20 <= len(sent) <= 40
        back.set()
        sender.join(10)
        assert len(sent) == 60
    assert counts(stream.summary) == (60, 60, 0, 60)


def test_a_link_that_breaks_while_nothing_is_sent_is_mended_for_the_next_frame(fake, client):
    server = Connections(breaking(acked=2, durable=2), whole)
    fake.bidi(rpc.STREAM_FRAMES, server)
    with client.session("s").stream() as stream:
        send(stream, range(2))
        assert len(list(stream.acks())) == 2
        send(stream, range(2, 4))
    assert server.seen == [[0, 1], [2, 3]]
    assert counts(stream.summary) == (4, 4, 0, 4)


def test_a_stream_that_waits_for_the_server_can_be_cancelled(fake, client):
    fake.bidi(rpc.STREAM_FRAMES, Connections(breaking(acked=1, durable=0)))
    stream = client.session("s").stream(resume_timeout_s=3600)
    send(stream, range(3))
    next(stream.acks())
    stream.cancel()
    assert stream.summary.durable == 0


def test_asyncio_streams_do_the_same(fake):
    server = Connections(breaking(acked=5, durable=3, unanswered=2), whole)
    fake.bidi(rpc.STREAM_FRAMES, server)

    async def scenario():
        async with AsyncClient(fake.address, timeout_s=5.0) as client:
            async with client.session("s").stream(max_in_flight=4) as stream:
                for stamp_ns in range(10):
                    await stream.send_depth("d", stamp_ns=stamp_ns, depth=DEPTH)
                acks = [a async for a in stream.acks()]
            return acks, stream.summary

    acks, summary = asyncio.run(scenario())
    assert [a.stamp_ns for a in acks] == list(range(10))
    assert server.seen[1][:4] == [3, 4, 5, 6]
    assert counts(summary) == (10, 10, 0, 10)


def test_a_cancelled_task_ends_its_stream(fake):
    release = threading.Event()

    def silent(server, messages, context):
        release.wait(10)
        yield from ()

    async def send_for_ever(client):
        async with client.session("s").stream(max_in_flight=2) as stream:
            for stamp_ns in range(100):
                await stream.send_depth("d", stamp_ns=stamp_ns, depth=DEPTH)

    async def scenario():
        async with AsyncClient(fake.address) as client:
            for server in (Connections(silent), Connections(breaking(acked=1, durable=0))):
                fake.bidi(rpc.STREAM_FRAMES, server)
                with pytest.raises(asyncio.TimeoutError):
                    await asyncio.wait_for(send_for_ever(client), 0.3)
            return {task.get_name() for task in asyncio.all_tasks()}

    try:
        assert "percept-stream" not in asyncio.run(scenario())
    finally:
        release.set()


def test_a_client_that_is_closed_ends_its_streams(fake):
    fake.bidi(rpc.STREAM_FRAMES, Connections(breaking(acked=1, durable=0)))
    client = Client(fake.address)
    stream = client.session("s").stream(resume_timeout_s=3600)
    send(stream, range(2))
    next(stream.acks())
    client.close()
    with pytest.raises(Unavailable):
        stream.close()
