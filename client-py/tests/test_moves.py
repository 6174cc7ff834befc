"""Several servers on one store: the next takes the place of one that is away, a session is followed."""

import asyncio
import threading

import grpc
import numpy as np
import pytest
from conftest import FakeServer, ack_of, elsewhere, eventually, refuse

from percept import AsyncClient, Client, DeadlineExceeded, InvalidArgument, PerceptError, Unavailable
from percept import _rpc as rpc
from percept._access import accesses
from percept._options import MOST_MOVES, Options
from percept._sync.transport import Link, Transport
from percept.v1 import object_pb2, session_pb2

DEPTH = np.ones((2, 3), np.float32)


def taking_in(requests, context):
    for count, request in enumerate(requests, 1):
        yield ack_of(request.message, count)


def pages(request, context):
    first = int(request.page_token or 0)
    objects = [object_pb2.Object(object_id=i) for i in (first, first + 1)]
    return rpc.LIST_OBJECTS.answer(objects=objects, next_page_token=str(first + 2) if first < 4 else "")


def chunks(request, context):
    for i in range(3):
        pose = session_pb2.TrajectoryPose(stamp_ns=i, state=session_pb2.TRACKING_STATE_TRACKING)
        yield rpc.GET_TRAJECTORY.answer(map_version=4, poses=[pose])


def events(request, context):
    for token in range(request.resume_token + 1, 4):
        yield rpc.WATCH_SESSION.answer(event=session_pb2.SessionEvent(token=token))


def serve(server):
    """What the one that has the session answers."""
    server.unary(rpc.GET_POSE, lambda *_: rpc.GET_POSE.answer())
    server.unary(rpc.DELETE_SESSION, lambda *_: rpc.DELETE_SESSION.answer())
    server.unary(rpc.LIST_OBJECTS, pages)
    server.unary(rpc.SYNC_TIME, lambda *_: rpc.SYNC_TIME.answer())
    server.unary(
        rpc.GET_SESSION,
        lambda *_: rpc.GET_SESSION.answer(session=session_pb2.Session(session_id="s")),
    )
    server.streaming(rpc.GET_TRAJECTORY, chunks)
    server.streaming(rpc.WATCH_SESSION, events)
    server.bidi(rpc.STREAM_FRAMES, taking_in)


def point(server, there):
    """What one says that knows another has it."""
    for call in (rpc.GET_POSE, rpc.DELETE_SESSION, rpc.LIST_OBJECTS, rpc.GET_SESSION):
        server.unary(call, elsewhere(there))
    for call in (rpc.GET_TRAJECTORY, rpc.WATCH_SESSION):
        server.streaming(call, elsewhere(there))
    server.bidi(rpc.STREAM_FRAMES, elsewhere(there))
    server.unary(rpc.SYNC_TIME, lambda *_: rpc.SYNC_TIME.answer())


@pytest.fixture
def moved(fake, other):
    """The address that is asked, whose sessions the other server has."""
    point(fake, other)
    serve(other)
    return fake.address


def streamed(session):
    with session.stream() as stream:
        for stamp_ns in range(3):
            stream.send_depth("d", stamp_ns=stamp_ns, depth=DEPTH)
    return stream.summary.durable


def watched(session):
    with session.watch() as watch:
        return [event.token for event in watch]


KINDS = {
    "repeatable": (lambda s: s.pose(), None),
    "not repeatable": (lambda s: s.delete(), None),
    "paged": (lambda s: [o.object_id for o in s.scene.objects()], [0, 1, 2, 3, 4, 5]),
    "chunked": (lambda s: len(s.trajectory()), 3),
    "stream": (streamed, 3),
    "watch": (watched, [1, 2, 3]),
}


@pytest.mark.parametrize("kind", KINDS)
def test_a_session_is_followed_at_once_and_asked_for_there_from_then_on(fake, other, moved, kind):
    ask, answer = KINDS[kind]
    # Whoever waited as long as the server says would be too late.
    with Client(moved, timeout_s=5.0) as client:
        session = client.session("s")
        assert ask(session) == answer
        assert len(fake.calls) == 1
        assert session.map._transport.here.target == other.address
        assert session.pose() is None
        assert len(fake.calls) == 1


def test_asyncio_follows_too(fake, other, moved):
    async def scenario():
        async with AsyncClient(moved, timeout_s=5.0) as client:
            assert await client.session("s").pose() is None
            await client.session("s").delete()
            assert [o.object_id async for o in client.session("s").scene.objects()] == [0, 1, 2, 3, 4, 5]
            assert len(await client.session("s").trajectory()) == 3
            async with client.session("s").stream() as stream:
                await stream.send_depth("d", stamp_ns=1, depth=DEPTH)
            assert stream.summary.durable == 1
            async with client.session("s").watch() as watch:
                assert [event.token async for event in watch] == [1, 2, 3]

    asyncio.run(scenario())
    assert len(fake.calls) == 6


def test_an_asyncio_stream_hears_where_its_session_is_though_it_has_much_to_send(fake, other, moved):
    """A frame that was on its way when the refusal came made grpc.aio forget what that said."""

    async def scenario():
        async with AsyncClient(moved) as client:
            for _ in range(20):
                async with client.session("s").stream() as stream:
                    for stamp_ns in range(20):
                        await stream.send_depth("d", stamp_ns=stamp_ns, depth=DEPTH)
                assert stream.summary.durable == 20

    asyncio.run(scenario())
    assert len(fake.calls) == 20


def test_a_frame_of_a_stream_may_tell_where_its_session_is(fake, other):
    def moves(requests, context):
        yield ack_of(next(requests).message, 1)
        ack = ack_of(next(requests).message, 1, "SESSION_ELSEWHERE", "UNAVAILABLE")
        ack.ack.rejection.server = other.address
        ack.ack.rejection.retry_after_s = 3600
        yield ack

    stamps = []

    def noting(requests, context):
        for count, request in enumerate(requests, 1):
            stamps.append(request.message.stamp_ns)
            yield ack_of(request.message, count)

    fake.bidi(rpc.STREAM_FRAMES, moves)
    other.bidi(rpc.STREAM_FRAMES, noting)
    with Client(fake.address) as client:
        assert streamed(client.session("s")) == 3
    assert stamps == [1, 2]


def test_a_stream_that_does_not_resume_says_where_to_go_and_the_next_one_is_there(fake, other, moved):
    with Client(moved) as client:
        session = client.session("s")
        stream = session.stream(resume=False)
        with pytest.raises(Unavailable) as error:
            stream.send_depth("d", stamp_ns=0, depth=DEPTH)
            stream.close()
        assert (error.value.reason, error.value.server) == ("SESSION_ELSEWHERE", other.address)
        with session.stream(resume=False) as stream:
            stream.send_depth("d", stamp_ns=1, depth=DEPTH)
        assert stream.summary.durable == 1


def test_a_watch_that_broke_goes_on_where_its_session_went(fake, other):
    def leaving(request, context):
        yield rpc.WATCH_SESSION.answer(event=session_pb2.SessionEvent(token=1))
        elsewhere(other)(request, context)

    fake.streaming(rpc.WATCH_SESSION, leaving)
    serve(other)
    with Client(fake.address) as client:
        assert watched(client.session("s")) == [1, 2, 3]
    assert other.calls[0].resume_token == 1


def test_a_session_that_moved_moves_nothing_else(fake, other, moved):
    with Client(moved) as client:
        client.session("s").pose()
        # By its name, over the client itself: found, and no reason to ask the other server for all else.
        assert client.sessions.get("s").session_id == "s"
        client.sessions.delete("s")
        before = len(fake.calls), len(other.calls)
        client.sync_time()
        assert (len(fake.calls), len(other.calls)) == (before[0] + 5, before[1])
        assert client.session("t").pose() is None
        assert len(fake.calls) == before[0] + 6


def test_what_breaks_where_a_session_went_does_not_move_the_client(fake, other):
    """The next address took the place of a server that was well."""
    third = FakeServer()
    try:
        point(fake, other)
        other.unary(rpc.GET_SESSION, lambda _, c: refuse(c, grpc.StatusCode.UNAVAILABLE, "STOPPING", ""))
        serve(third)
        with Client([fake.address, other.address, third.address], retries=1) as client:
            assert client.sessions.get("s").session_id == "s"
            client.sync_time()
        assert len(third.calls) == 1
        assert len(fake.calls) == 6
    finally:
        third.stop()


@pytest.mark.parametrize("kind", KINDS)
def test_the_next_server_takes_the_place_of_a_dead_one(other, kind):
    dead = FakeServer()
    dead.stop()
    serve(other)
    ask, answer = KINDS[kind]
    with Client([dead.address, other.address]) as client:
        if kind == "not repeatable":
            with pytest.raises(Unavailable):
                ask(client.session("s"))
        assert ask(client.session("s")) == answer
        # Found out once, it holds for all.
        client.session("t").delete()
        client.with_options(retries=0).sync_time()


def test_asyncio_asks_the_next_server_too(other):
    dead = FakeServer()
    dead.stop()
    serve(other)

    async def scenario():
        async with AsyncClient([dead.address, other.address]) as client:
            assert await client.session("s").pose() is None
            async with client.session("s").watch() as watch:
                assert [event.token async for event in watch] == [1, 2, 3]
            async with client.session("s").stream() as stream:
                await stream.send_depth("d", stamp_ns=1, depth=DEPTH)

    asyncio.run(scenario())


def test_a_server_that_dies_under_a_stream_and_its_callers_is_left_by_all_of_them(fake, other):
    def dying(requests, context):
        yield ack_of(next(requests).message, 1)
        next(requests)
        assert gone.wait(10)
        refuse(context, grpc.StatusCode.UNAVAILABLE, "STOPPING", "")

    gone = threading.Event()
    serve(other)
    fake.bidi(rpc.STREAM_FRAMES, dying)
    fake.unary(rpc.GET_POSE, lambda _, c: refuse(c, grpc.StatusCode.UNAVAILABLE, "STOPPING", ""))
    with Client([fake.address, other.address]) as client:
        session = client.session("s")
        with session.stream() as stream:
            for stamp_ns in range(4):
                stream.send_depth("d", stamp_ns=stamp_ns, depth=DEPTH)
            # Moves the session; the stream, which breaks after it, must not move it back.
            assert session.pose() is None
            gone.set()
        assert stream.summary.durable == 4
        calls = len(fake.calls)
        assert session.pose() is None
        assert len(fake.calls) == calls


def test_many_threads_that_share_a_session_all_arrive(fake, other, moved):
    with Client(moved) as client:
        session = client.session("s")
        errors = []

        def ask():
            try:
                for _ in range(20):
                    session.pose()
            except PerceptError as error:
                errors.append(error)

        askers = [threading.Thread(target=ask) for _ in range(8)]
        for asker in askers:
            asker.start()
        for asker in askers:
            asker.join()
    assert errors == []
    assert len(fake.calls) <= 8


def test_a_silent_server_is_not_asked_again(fake, other):
    release = threading.Event()

    def silent(request, context):
        release.wait(10)
        return rpc.GET_POSE.answer()

    fake.unary(rpc.GET_POSE, silent)
    serve(other)
    with Client([fake.address, other.address], timeout_s=0.3) as client:
        session = client.session("s")
        with pytest.raises(DeadlineExceeded):
            session.pose()
        assert session.with_options(timeout_s=5.0).pose() is None
    release.set()


@pytest.mark.parametrize("reason", ["SESSION_STOPPED", "NOT_YET_DURABLE"])
def test_a_server_that_only_asks_for_a_moment_keeps_its_session(fake, other, reason):
    """Asking the other one would take the session there."""
    left = [1]

    def stopped_at_first(request, context):
        if left[0]:
            left[0] -= 1
            refuse(context, grpc.StatusCode.UNAVAILABLE, reason, "")
        return rpc.GET_POSE.answer()

    fake.unary(rpc.GET_POSE, stopped_at_first)
    serve(other)
    with Client([fake.address, other.address]) as client:
        assert client.session("s").pose() is None
    assert (len(fake.calls), len(other.calls)) == (2, 0)


def test_a_server_that_tells_itself_is_asked_as_often_as_one_that_is_away(fake):
    for call in (rpc.GET_POSE, rpc.DELETE_SESSION):
        fake.unary(
            call,
            lambda _, c: refuse(
                c, grpc.StatusCode.UNAVAILABLE, "SESSION_ELSEWHERE", "", metadata={"server": fake.address}
            ),
        )
    with Client(fake.address, retries=2) as client:
        with pytest.raises(Unavailable) as error:
            client.session("s").pose()
        assert (error.value.reason, error.value.server) == ("SESSION_ELSEWHERE", fake.address)
        assert len(fake.calls) == 3
        with pytest.raises(Unavailable):
            client.session("s").delete()
        assert len(fake.calls) == 4


def test_two_servers_that_tell_each_other_are_not_asked_for_ever(fake, other):
    point(fake, other)
    point(other, fake)
    with Client(fake.address, retries=0) as client:
        for ask in (lambda s: s.pose(), lambda s: s.delete()):
            before = len(fake.calls) + len(other.calls)
            with pytest.raises(Unavailable) as error:
                ask(client.session("s"))
            assert error.value.reason == "SESSION_ELSEWHERE"
            assert len(fake.calls) + len(other.calls) == before + 1 + MOST_MOVES
        # It pauses between rounds, and gives up in its time.
        before = len(fake.calls) + len(other.calls)
        stream = client.session("s").stream(resume_timeout_s=0.5)
        stream.send_depth("d", stamp_ns=1, depth=DEPTH)
        with pytest.raises(Unavailable) as error:
            stream.close()
        assert error.value.reason == "SESSION_ELSEWHERE"
        with pytest.raises(Unavailable):
            watched(client.session("s"))
        assert len(fake.calls) + len(other.calls) < before + 60


def test_a_client_may_be_closed_while_sessions_move(fake, other):
    point(fake, other)
    point(other, fake)
    client = Client(fake.address, retries=10**6, timeout_s=60.0)
    errors = []

    def ask():
        try:
            client.session("s").pose()
        except BaseException as error:
            errors.append(error)

    askers = [threading.Thread(target=ask, daemon=True) for _ in range(4)]
    for asker in askers:
        asker.start()
    assert eventually(lambda: len(fake.calls) + len(other.calls) > 8)
    client.close()
    for asker in askers:
        asker.join(5)
    reasons = [getattr(error, "reason", repr(error)) for error in errors]
    # Either it was told so, or its pause was too long for it anyway.
    assert len(reasons) == 4
    assert set(reasons) <= {"CLIENT_CLOSED", "SESSION_ELSEWHERE"}


REMOTE = "10.0.0.7:50051"


@pytest.mark.parametrize(
    ("address", "options", "told", "target"),
    [
        ("127.0.0.1:1", {}, REMOTE, REMOTE),
        ("127.0.0.1:1", {}, "http://10.0.0.7", REMOTE),
        ("127.0.0.1:1", {}, "10.0.0.7", REMOTE),
        ("127.0.0.1:1", {}, "[fd00::7]:2", "[fd00::7]:2"),
        # No place to go to.
        ("127.0.0.1:1", {}, "0.0.0.0:50051", None),
        ("127.0.0.1:1", {}, "[::]:50051", None),
        ("127.0.0.1:1", {}, "", None),
        ("127.0.0.1:1", {}, "two words:1", None),
        ("127.0.0.1:1", {}, "a:1,b:2", None),
        ("127.0.0.1:1", {}, "user@percept:1", None),
        # Nor for a server to choose.
        ("127.0.0.1:1", {}, "unix:/run/docker.sock", None),
        ("127.0.0.1:1", {}, "unix-abstract:agent", None),
        ("127.0.0.1:1", {}, "dns://10.0.0.9/percept:1", None),
        ("127.0.0.1:1", {}, "xds:///percept:1", None),
        # A token stays where it is protected.
        ("127.0.0.1:1", {"token": "t"}, "127.0.0.2:2", "127.0.0.2:2"),
        ("127.0.0.1:1", {"token": "t"}, REMOTE, None),
        ("127.0.0.1:1", {"token": "t"}, "dns://10.0.0.9/localhost:1", None),
        ("127.0.0.1:1", {"token": "t"}, f"https://{REMOTE}", None),
        ("127.0.0.1:1", {"token": "t", "allow_insecure_token": True}, REMOTE, REMOTE),
        ("https://percept", {"token": "t"}, REMOTE, REMOTE),
        ("https://percept", {"token": "t"}, f"https://{REMOTE}", REMOTE),
        ("https://percept", {"token": "t"}, f"http://{REMOTE}", None),
        ("https://percept", {}, f"http://{REMOTE}", None),
        ("http://percept", {}, f"https://{REMOTE}", None),
    ],
)
def test_where_a_server_may_send_a_caller(address, options, told, target):
    said = {
        "token": None,
        "token_file": None,
        "allow_insecure_token": False,
        "tls": None,
        "ca_file": None,
        "cert_file": None,
        "key_file": None,
        "credentials": None,
    }
    [here] = accesses(address, **(said | options))
    there = here.at(told)
    assert (there.target if there else None) == target
    if there:
        assert (there.credentials, there.token) == (here.credentials, here.token)


def test_a_session_is_not_followed_with_a_token_over_an_open_link(fake):
    fake.unary(rpc.GET_POSE, elsewhere(REMOTE))
    with Client(fake.address, token="t") as client, pytest.raises(Unavailable) as error:
        client.session("s").pose()
    assert (error.value.reason, error.value.server) == ("SESSION_ELSEWHERE", REMOTE)
    assert len(fake.calls) == 1


@pytest.mark.parametrize(
    "addresses",
    [
        # The token would have gone to the second one readably.
        ["127.0.0.1:1", "https://percept:1"],
        ["https://percept:1", "http://other:1"],
        ["https://percept:1", "127.0.0.1:1"],
    ],
)
def test_servers_are_all_protected_or_none_is(addresses):
    with pytest.raises(InvalidArgument) as error:
        Client(addresses, token="t", allow_insecure_token=True)
    assert (error.value.reason, error.value.field) == ("OPTIONS_CONFLICT", "address")


@pytest.mark.parametrize("addresses", [[], "a:1,b:2", ["a:1", ""], ["a:1 b:2"]])
def test_addresses_that_name_no_server_are_refused(addresses):
    with pytest.raises(InvalidArgument) as error:
        Client(addresses)
    assert (error.value.reason, error.value.field) == ("ADDRESS_INVALID", "address")


def test_an_address_that_is_given_twice_is_asked_once(other):
    dead = FakeServer()
    dead.stop()
    serve(other)
    with Client([dead.address, f"http://{dead.address}", other.address], retries=1) as client:
        assert client.session("s").pose() is None


def test_whoever_finds_a_server_dead_later_goes_where_the_others_went():
    said = dict.fromkeys(
        ["token", "token_file", "tls", "ca_file", "cert_file", "key_file", "credentials"]
    ) | {"allow_insecure_token": False}
    link = Link(accesses(["127.0.0.1:1", "127.0.0.1:2", "127.0.0.1:3"], **said), None)
    transport = Transport(link, Options(timeout_s=1.0, retries=0, metadata=())).following()
    first, away = transport.here, Unavailable("gone")
    assert transport.after(first, away).target == "127.0.0.1:2"
    # Another one that had asked the first.
    transport.after(first, away)
    assert transport.here.target == "127.0.0.1:2"
    assert transport.after(transport.here, away).target == "127.0.0.1:3"
    assert transport.after(transport.here, away).target == "127.0.0.1:1"
    assert transport.after(first, InvalidArgument("no")).target == "127.0.0.1:1"
    link.close()
