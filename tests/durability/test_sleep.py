"""Sessions that nobody uses leave the memory and come back as they were, whenever a frame or a question
meets them.
"""

from __future__ import annotations

import threading

import httpx
import numpy as np
import pytest
from percept import Client, InvalidArgument, PoseEstimate

from support import robots, world
from support.measure import rss_mb
from support.server import Server, eventually


@pytest.fixture
def sleepy_server(tmp_path, monkeypatch):
    """A server whose sessions sleep after a second."""
    monkeypatch.setenv("PERCEPT_LIMITS_SLEEP_AFTER_S", "1")
    server = Server(tmp_path / "data")
    yield server
    server.kill()


@pytest.fixture
def client(sleepy_server):
    with Client(sleepy_server.grpc) as client:
        yield client


@pytest.fixture
def states(sleepy_server):
    """Asks for the state of each session, which wakes none."""
    with httpx.Client(base_url=sleepy_server.rest_url, timeout=30) as http:

        def ask():
            sessions = http.get("/v1/sessions").json()["sessions"]
            return {s["session_id"]: s["state"].removeprefix("SESSION_STATE_") for s in sessions}

        yield ask


def asleep(states, *names):
    assert eventually(lambda: {states()[n] for n in names} == {"ASLEEP"}), states()


def test_a_session_sleeps_wakes_and_is_as_it_was(client, states):
    session = client.sessions.create("robot", sensors=[world.LIDAR], display_name="Seven")
    robots.send_sweeps(session, 0, 30)
    trajectory, grid, cloud = session.trajectory(), session.map.occupancy(), session.map.cloud()
    keyframes, pose = list(session.keyframes()), session.pose()
    assert states() == {"robot": "AWAKE"}
    asleep(states, "robot")
    # Looking at it does not wake it, and tells what it had when it fell asleep.
    info = session.info()
    assert (info.display_name, info.num_keyframes) == ("Seven", len(keyframes))
    assert states() == {"robot": "ASLEEP"}
    assert np.array_equal(session.map.occupancy().cells, grid.cells)
    assert states() == {"robot": "AWAKE"}
    assert np.array_equal(session.map.cloud().cloud.points, cloud.cloud.points)
    again = session.trajectory()
    assert np.array_equal(again.stamps_ns, trajectory.stamps_ns)
    assert np.allclose(again.positions, trajectory.positions, atol=1e-6)
    assert [k.stamp_ns for k in session.keyframes()] == [k.stamp_ns for k in keyframes]
    assert session.pose().stamp_ns == pose.stamp_ns


def test_counters_go_on_and_versions_never_fall_over_sleep_and_restart(sleepy_server, client, states):
    session = client.sessions.create("robot", sensors=[world.LASER])
    robots.send_scans(session, 0, 12)
    with pytest.raises(InvalidArgument):
        session.send_scan("laser", stamp_ns=world.stamp(3) + 1, **robots.scan(3))
    version = session.space.changes().stamp.map_version
    assert version > 0
    asleep(states, "robot")

    def go_on(session):
        """Asks a session that sleeps, then one that wakes."""
        (status,) = session.sensors.list()
        assert session.info().state == "asleep", "asked without waking it"
        assert (status.accepted, status.rejected, status.verdict) == (12, 1, "troubled")
        assert status.last_stamp_ns == world.stamp(11)
        changes = session.space.changes(version)
        if changes.stamp.map_version == version:
            assert changes.regions == (), "made of the same records, it is the same"
        else:
            # Whoever holds the map of that version gets all of it: what it was made of is laid anew.
            assert changes.stamp.map_version > version
            assert changes.regions == session.space.changes().regions
        (status,) = session.sensors.list()
        assert (status.accepted, status.rejected, status.last_stamp_ns) == (12, 1, world.stamp(11))
        return changes.stamp.map_version

    version = go_on(session)
    sleepy_server.kill()
    sleepy_server.start()
    with Client(sleepy_server.grpc) as again:
        session = again.session("robot")
        version = go_on(session)
        robots.send_scans(session, 12, 14)
        assert session.sensors.list()[0].accepted == 14
        assert session.space.changes().stamp.map_version >= version


def test_a_robot_that_pauses_maps_on_through_every_sleep(client, states):
    session = client.sessions.create("robot", sensors=[world.LASER])
    truth = world.truth_in_map(list(robots.laps()))
    for nap in range(3):
        robots.send_scans(session, 10 * nap, 10 * nap + 10)
        asleep(states, "robot")
    result = session.send_scan("laser", stamp_ns=world.stamp(30), **robots.scan(30))
    assert result.pose.state == "tracking"
    assert world.position_error_m(result.pose.t_map_base, truth[30]) < 0.1
    assert session.trajectory().stamps_ns.tolist() == [world.stamp(i) for i in range(31)]


def test_an_open_stream_survives_the_sleep_of_its_session(client, states):
    session = client.sessions.create("robot", sensors=[world.LASER])
    with session.stream() as stream:
        for nap in range(2):
            for i in range(5):
                stream.send_scan("laser", stamp_ns=world.stamp(5 * nap + i), **robots.scan(5 * nap + i))
            list(stream.acks())
            # Whether it sleeps under an open stream is the server's choice; frames are not lost by it.
            eventually(lambda: states()["robot"] == "ASLEEP", seconds=4)
    assert (stream.summary.accepted, stream.summary.rejected, stream.summary.durable) == (10, 0, 10)
    assert len(session.trajectory()) == 10


def test_a_watcher_hears_of_what_happens_after_a_sleep(client, states):
    session = client.sessions.create("robot", sensors=[world.LASER])
    robots.send_scans(session, 0, 3)
    with session.watch() as watch:
        eventually(lambda: states()["robot"] == "ASLEEP", seconds=4)
        robots.send_scans(session, 3, 5)
        seen = []
        while not seen or seen[-1].stamp_ns < world.stamp(4):
            seen.append(next(watch))
    assert {world.stamp(3), world.stamp(4)} <= {e.stamp_ns for e in seen if isinstance(e.event, PoseEstimate)}
    assert [e.token for e in seen] == sorted({e.token for e in seen})


def test_frames_that_meet_a_session_falling_asleep_are_not_lost(client, states):
    """Many sessions that sleep after a second, each sent a frame at its own time, over and over."""
    names = [f"r{i}" for i in range(8)]
    for name in names:
        client.sessions.create(name, sensors=[world.LASER])

    def drive(number):
        session = client.session(names[number])
        for i in range(6):
            session.send_scan("laser", stamp_ns=world.stamp(i), **robots.scan(i))
            # Just before, at, and after the second.
            pause.wait(0.8 + 0.06 * number)

    pause = threading.Event()
    threads = [threading.Thread(target=drive, args=(k,)) for k in range(len(names))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    kept = {name: len(client.session(name).trajectory()) for name in names}
    assert kept == dict.fromkeys(names, 6)


def test_sleeping_gives_memory_back(sleepy_server, client, states):
    """What a batch of sessions held is taken by the next. The allocator keeps some of it, and threads come and go."""
    pid = sleepy_server.process.pid

    def batch(tag):
        names = [f"{tag}{i}" for i in range(12)]
        for i, name in enumerate(names):
            session = client.sessions.create(name, sensors=[world.LASER])
            robots.send_scans(session, 0, 60, phase=15 * i)
        awake = rss_mb(pid)
        asleep(states, *names)
        return awake

    start = rss_mb(pid)
    first = batch("a") - start
    sixth = [batch(tag) - start for tag in "bcdef"][-1]
    # Were nothing given back, it would be six times as much.
    assert sixth < 3.5 * first, (start, first, sixth)


def test_what_sleeps_survives_a_kill_and_can_be_deleted(sleepy_server, client, states):
    for name in ("kept", "gone"):
        robots.mapped(client, name, frames=8)
    asleep(states, "kept", "gone")
    client.session("gone").delete()
    sleepy_server.kill()
    sleepy_server.start()
    with Client(sleepy_server.grpc) as client:
        assert [s.session_id for s in client.sessions.list()] == ["kept"]
        assert len(client.session("kept").trajectory()) == 8
