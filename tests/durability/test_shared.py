"""Two servers share a store, each of them some of the sessions: whoever asks the wrong one is told where to go, and
what one of them leaves behind the other answers for.
"""

from __future__ import annotations

import contextlib
import signal
import threading
import uuid
from collections.abc import Iterator

import numpy as np
import pytest
from percept import Client

from support import raw, robots, s3, world
from support.server import Server, eventually

#: Until the sessions of a server that says nothing any more may be another's, seconds; with room for a slow machine.
TAKEN_OVER_S = 20.0
#: Until a server has looked through the catalogue again.
SEEN_S = 15.0


@pytest.fixture(scope="module")
def s3_address():
    with s3.server() as address:
        yield address


@pytest.fixture(params=["directory", "s3"])
def pair(request, tmp_path, monkeypatch):
    """Two servers on one store; sessions sleep after a second."""
    monkeypatch.setenv("PERCEPT_LIMITS_SLEEP_AFTER_S", "1")
    data = tmp_path / "data"
    if request.param == "directory":
        monkeypatch.setenv("PERCEPT_STORAGE_SHARED", "true")
    else:
        for name, value in s3.KEYS.items():
            monkeypatch.setenv(name, value)
        monkeypatch.setenv("PERCEPT_STORAGE_S3_ENDPOINT", request.getfixturevalue("s3_address"))
        monkeypatch.setenv("PERCEPT_STORAGE_S3_ALLOW_HTTP", "true")
        monkeypatch.setenv("PERCEPT_STORAGE_URL", f"s3://{s3.BUCKET}/{uuid.uuid4()}")
    servers = []
    for name in ("one.example:1", "two.example:2"):
        monkeypatch.setenv("PERCEPT_STORAGE_ADVERTISE", name)
        servers.append(Server(None if request.param == "s3" else data, log=tmp_path / f"{name[:3]}.log"))
    yield servers
    for server in servers:
        server.process.send_signal(signal.SIGCONT)
        server.kill()


class Side:
    """One of the servers: its client, and calls that are not tried again."""

    def __init__(self, server: Server) -> None:
        self.server = server
        self.client = Client(server.grpc)
        self.calls = raw.Calls(server.grpc)

    def pose(self, name: str) -> raw.Answer:
        return self.calls("SessionsService/GetPose", session_id=name)

    def names(self) -> list[str]:
        return [info.session_id for info in self.client.sessions.list()]

    def close(self) -> None:
        self.client.close()
        self.calls.close()


@pytest.fixture
def sides(pair):
    one, two = (Side(server) for server in pair)
    yield one, two
    one.close()
    two.close()


def stamps(client: Client, name: str) -> list[int]:
    return client.sessions.get(name).trajectory().stamps_ns.tolist()


@contextlib.contextmanager
def in_use(client: Client, name: str) -> Iterator[None]:
    """A question each moment keeps a session awake, so that it stays where it is."""
    stop, session = threading.Event(), client.sessions.get(name)

    def ask():
        while not stop.wait(0.1):
            session.pose()

    asking = threading.Thread(target=ask)
    asking.start()
    try:
        yield
    finally:
        stop.set()
        asking.join()


def test_a_session_in_use_elsewhere_says_where_and_moves_when_it_ends_there(sides):
    one, two = sides
    session = robots.mapped(one.client, "robot")
    with in_use(one.client, "robot"):
        told = two.pose("robot")
    assert (told.code, told.reason) == ("UNAVAILABLE", "SESSION_ELSEWHERE")
    assert "one.example:1" in told.text
    trajectory, keyframes = session.trajectory(), [k.stamp_ns for k in session.keyframes()]
    grid = session.map.occupancy()
    # It falls asleep there, and belongs to whoever is asked next.
    assert eventually(lambda: two.pose("robot").ok, seconds=TAKEN_OVER_S)
    moved = two.client.sessions.get("robot")
    assert [k.stamp_ns for k in moved.keyframes()] == keyframes
    assert np.allclose(moved.trajectory().positions, trajectory.positions, atol=1e-6)
    assert np.array_equal(moved.map.occupancy().cells, grid.cells)
    with in_use(two.client, "robot"):
        assert robots.send_scans(moved, 10, 20) == 10
        assert one.pose("robot").reason == "SESSION_ELSEWHERE"
    assert two.names() == ["robot"]


def test_what_is_created_at_one_server_is_listed_by_the_other(sides):
    one, two = sides
    for name in ("a", "b"):
        one.client.sessions.create(name)
    assert eventually(lambda: two.names() == ["a", "b"], seconds=SEEN_S)
    two.client.sessions.delete("a")
    assert eventually(lambda: one.names() == ["b"], seconds=SEEN_S)


def test_a_session_is_found_at_the_other_server_at_once(sides):
    one, two = sides
    one.client.sessions.create("robot", sensors=[world.LASER])
    assert robots.send_scans(two.client.sessions.get("robot"), 0, 3) == 3


def test_what_a_killed_server_had_answers_at_the_other_with_all_that_was_acknowledged(sides):
    one, two = sides
    names = [f"robot-{k}" for k in range(4)]
    for phase, name in enumerate(names):
        robots.mapped(one.client, name, frames=12, phase=phase)
    before = {name: stamps(one.client, name) for name in names}
    one.server.kill()
    for name in names:
        assert eventually(lambda name=name: two.pose(name).ok, seconds=TAKEN_OVER_S), two.pose(name)
        assert stamps(two.client, name) == before[name]
        assert robots.send_scans(two.client.sessions.get(name), 12, 16) == 4


def test_a_server_that_stops_leaves_its_sessions_to_the_other_at_once(sides):
    one, two = sides
    robots.mapped(one.client, "robot")
    before = stamps(one.client, "robot")
    assert one.server.stop() == 0
    assert two.pose("robot").ok
    assert stamps(two.client, "robot") == before


def test_a_server_that_was_paused_confirms_nothing_of_what_another_has_taken_over(sides):
    one, two = sides
    robots.mapped(one.client, "robot")
    one.server.process.send_signal(signal.SIGSTOP)
    assert eventually(lambda: two.pose("robot").ok, seconds=TAKEN_OVER_S)
    assert robots.send_scans(two.client.sessions.get("robot"), 10, 20) == 10
    # What is sent to the paused one waits for it, and is the first that it does when it wakes up.
    frames = [robots.scan_message("robot", i) for i in range(20, 24)]
    # Once it sleeps at the other, it belongs to whoever is asked next.
    with in_use(two.client, "robot"):
        sent = [one.calls.begin("SensorsService/SendFrame", message=frame) for frame in frames]
        one.server.process.send_signal(signal.SIGCONT)
        answers = [raw.answer_of(call) for call in sent]
        assert all(a.code == "UNAVAILABLE" for a in answers), answers
        assert eventually(lambda: one.pose("robot").reason == "SESSION_ELSEWHERE")
    assert stamps(two.client, "robot") == [world.stamp(i) for i in range(20)]
    assert robots.send_scans(two.client.sessions.get("robot"), 24, 27) == 3


def test_of_two_that_create_a_session_at_once_one_wins_and_who_deletes_it_deletes_it_for_all(sides):
    answers = []

    def create(side: Side) -> None:
        answers.append(side.calls("SessionsService/CreateSession", session_id="robot").reason)

    both = [threading.Thread(target=create, args=(side,)) for side in sides]
    for thread in both:
        thread.start()
    for thread in both:
        thread.join()
    assert sorted(answers) == ["", "SESSION_EXISTS"]
    one, two = sides
    robots_session = two.client.sessions.get("robot")
    robots_session.sensors.declare(world.LASER)
    assert robots.send_scans(robots_session, 0, 3) == 3
    deleted = lambda: one.calls("SessionsService/DeleteSession", session_id="robot")  # noqa: E731
    assert eventually(lambda: deleted().ok, seconds=TAKEN_OVER_S)
    assert two.pose("robot").reason == "SESSION_NOT_FOUND"
    assert eventually(lambda: two.names() == [], seconds=SEEN_S)
    again = two.client.sessions.create("robot", sensors=[world.LASER])
    assert len(again.trajectory()) == 0
    assert robots.send_scans(again, 0, 3) == 3


def test_a_request_sent_again_to_the_other_server_is_the_same_session(sides):
    answers = [
        side.calls("SessionsService/CreateSession", session_id="robot", request_id="first-try") for side in sides
    ]
    assert [a.code for a in answers] == ["OK", "OK"], answers
    another = sides[1].calls("SessionsService/CreateSession", session_id="robot", request_id="second")
    assert another.reason == "SESSION_EXISTS"


def test_a_directory_of_one_server_is_refused_to_another(tmp_path):
    one = Server(tmp_path / "data")
    try:
        with pytest.raises(AssertionError, match=r"in use|another"):
            Server(tmp_path / "data", log=tmp_path / "other.log")
    finally:
        one.kill()


@pytest.fixture
def known_pair(tmp_path, monkeypatch):
    """Two servers on one store that tell of each other where they can be reached."""
    monkeypatch.setenv("PERCEPT_STORAGE_SHARED", "true")
    servers = []
    for name in ("one", "two"):
        servers.append(Server(tmp_path / "data", log=tmp_path / f"{name}.log"))
    yield servers
    for server in servers:
        server.kill()


def test_a_client_that_knows_both_follows_its_session_and_outlives_the_server_that_had_it(known_pair):
    one, two = known_pair
    with Client(one.grpc) as near, Client([two.grpc, one.grpc]) as far:
        robots.mapped(near, "robot", frames=10)
        session = far.session("robot")
        with session.watch(resume_token=0) as watch, session.stream(max_in_flight=4) as stream:
            for i in range(10, 40):
                if i == 25:
                    one.kill()
                stream.send_scan("laser", stamp_ns=world.stamp(i), **robots.scan(i))
            summary = stream.close()
            assert eventually(lambda: next(watch).stamp_ns == world.stamp(39), seconds=60)
        assert (summary.sent, summary.accepted, summary.rejected, summary.durable) == (30, 30, 0, 30)
        assert session.trajectory().stamps_ns.tolist() == [world.stamp(i) for i in range(40)]
