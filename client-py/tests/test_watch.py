"""Watches that break: where they go on, how long they try, how they end."""

import asyncio
import threading
import time

import grpc
import pytest
from conftest import eventually, refuse

from percept import AsyncClient, Client, Unauthenticated, Unavailable
from percept import _rpc as rpc
from percept.v1 import session_pb2


def event(token):
    return rpc.WATCH_SESSION.answer(event=session_pb2.SessionEvent(token=token, map_version=token))


def until_left(context):
    while context.is_active():
        time.sleep(0.005)


class Watched:
    """A server that does with its first, second ... watch as it is told, and goes on with the last. It tells
    its newest token when it takes a watch up, unless it is of those that do not."""

    def __init__(self, *scripts, newest=None):
        self.scripts = list(scripts)
        self.newest = newest
        #: Tokens that it was asked to go on from.
        self.asked = []

    def __call__(self, request, context):
        script = self.scripts.pop(0) if len(self.scripts) > 1 else self.scripts[0]
        self.asked.append(request.resume_token if request.HasField("resume_token") else None)
        return script(self, request, context)

    def take_up(self, context):
        token = [] if self.newest is None else [("percept-resume-token", str(self.newest))]
        context.send_initial_metadata(token)


def telling(*tokens, goes=None, reason="STOPPING", retry_s=None, when=None):
    """Events, then, when it is time, a break, or an end."""

    def script(server, request, context):
        server.take_up(context)
        for token in tokens:
            yield event(token)
        assert when is None or when.wait(10)
        if goes is not None:
            refuse(context, goes, reason, "", retry_s=retry_s)

    return script


def away(server, request, context):
    refuse(context, grpc.StatusCode.UNAVAILABLE, "STOPPING", "")


GONE = grpc.StatusCode.UNAVAILABLE


@pytest.fixture
def hurried(monkeypatch):
    """Pauses are short."""
    monkeypatch.setattr("percept._options.random.uniform", lambda *_: 0.005)


def tokens_of(client):
    with client.session("s").watch() as watch:
        return [e.token for e in watch]


def test_a_watch_that_saw_no_event_goes_on_from_the_token_that_it_was_told(fake, client):
    """It knew no place to go on from, and raised whatever broke it."""
    told = threading.Event()
    server = Watched(telling(goes=GONE, when=told), telling(18, 19), newest=17)
    fake.streaming(rpc.WATCH_SESSION, server)
    with client.session("s").watch() as watch:
        assert watch.token == 17
        told.set()
        assert [e.token for e in watch] == [18, 19]
    assert server.asked == [None, 17]


def test_a_token_that_was_given_stays(fake, client):
    server = Watched(telling(goes=GONE), telling(5), newest=17)
    fake.streaming(rpc.WATCH_SESSION, server)
    with client.session("s").watch(resume_token=4) as watch:
        assert watch.token == 4
        assert [e.token for e in watch] == [5]
    assert server.asked == [4, 4]


def test_a_server_that_tells_no_token_can_only_be_gone_on_with_after_an_event(fake, client):
    begun = threading.Event()
    fake.streaming(rpc.WATCH_SESSION, Watched(telling(goes=GONE, when=begun)))
    with client.session("s").watch() as watch:
        begun.set()
        with pytest.raises(Unavailable):
            next(watch)
    server = Watched(telling(1, goes=GONE), telling(2))
    fake.streaming(rpc.WATCH_SESSION, server)
    assert tokens_of(client) == [1, 2]
    assert server.asked == [None, 1]


def test_a_watch_outlives_more_breaks_than_a_call_has_tries(fake, client, hurried):
    """It gave up after five, within seconds."""
    server = Watched(telling(1, goes=GONE), *[away] * 12, telling(2))
    fake.streaming(rpc.WATCH_SESSION, server)
    assert tokens_of(client) == [1, 2]
    assert len(server.asked) == 14


def test_a_watch_gives_up_once_it_could_not_go_on_for_its_time(fake, client):
    server = Watched(telling(1, goes=GONE), away)
    fake.streaming(rpc.WATCH_SESSION, server)
    with client.session("s").watch(resume_timeout_s=0.3) as watch:
        assert next(watch).token == 1
        for _ in range(2):
            before = len(server.asked)
            with pytest.raises(Unavailable) as error:
                next(watch)
            assert error.value.reason == "STOPPING"
            assert len(server.asked) > before


def test_a_watch_is_begun_like_any_call(fake, client, hurried):
    server = Watched(away, away, telling(1))
    fake.streaming(rpc.WATCH_SESSION, server)
    assert tokens_of(client) == [1]
    fake.streaming(rpc.WATCH_SESSION, Watched(away))
    with pytest.raises(Unavailable):
        tokens_of(client.with_options(retries=2))


def test_a_watch_that_is_refused_says_why(fake, client):
    for watched in (Watched(telling(goes=grpc.StatusCode.NOT_FOUND)), Watched(telling(1), newest=0)):
        fake.streaming(rpc.WATCH_SESSION, watched)
    assert tokens_of(client) == [1]
    fake.streaming(rpc.WATCH_SESSION, Watched(telling(goes=grpc.StatusCode.UNAUTHENTICATED), newest=3))
    with pytest.raises(Unauthenticated):
        tokens_of(client)


def test_a_watch_goes_on_with_a_new_token_of_the_caller(fake, tmp_path):
    file = tmp_path / "token"
    file.write_text("old")

    def expired(server, request, context):
        yield event(1)
        file.write_text("renewed")
        refuse(context, grpc.StatusCode.UNAUTHENTICATED, "CREDENTIALS_EXPIRED", "")

    fake.streaming(rpc.WATCH_SESSION, Watched(expired, telling(2)))
    with Client(fake.address, token_file=file) as client:
        assert tokens_of(client) == [1, 2]
    assert [h["authorization"] for h in fake.headers] == ["Bearer old", "Bearer renewed"]


def test_a_watch_that_is_closed_while_it_waits_for_the_server_ends_and_asks_no_more(fake, client):
    """It slept on, and then began a call that nobody ended."""
    server = Watched(telling(1, goes=GONE, retry_s=30), telling(2))
    fake.streaming(rpc.WATCH_SESSION, server)
    watch = client.session("s").watch()
    seen = []
    reader = threading.Thread(target=lambda: seen.extend(e.token for e in watch), daemon=True)
    reader.start()
    assert eventually(lambda: seen == [1])
    watch.close()
    reader.join(5)
    assert not reader.is_alive()
    assert len(server.asked) == 1


def test_asyncio_watches_go_on_too(fake, hurried):
    told = threading.Event()
    server = Watched(telling(goes=GONE, when=told), *[away] * 8, telling(18), newest=17)
    fake.streaming(rpc.WATCH_SESSION, server)

    async def scenario():
        async with AsyncClient(fake.address) as client, client.session("s").watch() as watch:
            assert watch.token == 17
            told.set()
            return [e.token async for e in watch]

    assert asyncio.run(scenario()) == [18]
    assert server.asked == [None, *[17] * 9]


def test_an_asyncio_watch_that_is_closed_by_another_task_ends(fake):
    """Its reader was cancelled, and with it whatever awaited that."""

    def quiet(server, request, context):
        server.take_up(context)
        yield event(1)
        until_left(context)

    def pausing(server, request, context):
        yield event(1)
        refuse(context, GONE, "STOPPING", "", retry_s=30)

    async def scenario():
        async with AsyncClient(fake.address) as client:
            for script in (quiet, pausing):
                fake.streaming(rpc.WATCH_SESSION, Watched(script))
                watch = client.session("s").watch()
                seen = []

                async def read(watch=watch, seen=seen):
                    async for e in watch:
                        seen.append(e.token)
                    return seen

                reader = asyncio.create_task(read())
                while not seen:
                    await asyncio.sleep(0.005)
                watch.close()
                assert await asyncio.wait_for(reader, 5) == [1]

    asyncio.run(scenario())


def test_an_asyncio_reader_that_is_cancelled_itself_is_cancelled(fake):
    def quiet(server, request, context):
        yield event(1)
        until_left(context)

    fake.streaming(rpc.WATCH_SESSION, Watched(quiet))

    async def scenario():
        async with AsyncClient(fake.address) as client, client.session("s").watch() as watch:
            await anext(watch)
            reader = asyncio.create_task(anext(watch))
            await asyncio.sleep(0)
            reader.cancel()
            with pytest.raises(asyncio.CancelledError):
                await reader

    asyncio.run(scenario())
