"""Damage stays where it is: one bad byte, one bad stamp, one bad clock harm one thing, precisely, and nobody
else.
"""

from __future__ import annotations

import hashlib
import re
import time

import httpx
import pytest
from percept import Client, InvalidArgument, PerceptError, SensorSpec, Unavailable

from support import robots, world
from support.measure import rss_mb

NAMES = ["r0", "r1", "r2"]
YEAR_NS = 365 * 24 * 3600 * 10**9
#: 2025, as a clock that was set says it.
NOW_NS = 55 * YEAR_NS


@pytest.fixture
def client(own_server):
    with Client(own_server.grpc) as client:
        yield client


def blobs(data_dir):
    """Files that are named by the SHA-256 of what they hold, wherever the store keeps them; the largest
    first.
    """
    found = []
    for path in data_dir.rglob("*"):
        name = re.search(r"[0-9a-f]{64}", path.name)
        if name and path.is_file() and hashlib.sha256(path.read_bytes()).hexdigest() == name.group():
            found.append(path)
    return sorted(found, key=lambda p: -p.stat().st_size)


def flip(path, position=0.5):
    """Flips a bit of one byte."""
    data = bytearray(path.read_bytes())
    data[int(len(data) * position)] ^= 0x10
    path.write_bytes(data)


def listed(server):
    with httpx.Client(base_url=server.rest_url, timeout=30) as http:
        answer = http.get("/v1/sessions")
        assert answer.status_code == 200, answer.text
        return {s["session_id"]: s for s in answer.json().get("sessions", [])}


def damaged_store(server, client):
    """Three sessions that share no blob, one of which has a byte flipped; the server is started again."""
    for phase, name in enumerate(NAMES):
        robots.mapped(client, name, phase=60 * phase)
    trajectories = {name: client.session(name).trajectory() for name in NAMES}
    assert server.stop() == 0
    found = blobs(server.data_dir)
    assert len(found) >= len(NAMES), "no blob was found; this shows nothing"
    flip(found[0])
    server.start()
    return trajectories


def refusal(ask):
    try:
        ask()
    except PerceptError as error:
        return error
    return None


def test_a_damaged_blob_is_its_own_sessions_trouble(own_server, client):
    trajectories = damaged_store(own_server, client)
    with Client(own_server.grpc) as client:
        assert list(listed(own_server)) == NAMES
        assert [s.session_id for s in client.sessions.list()] == NAMES

        def next_scan(name):
            scan = robots.scan(10, 60 * NAMES.index(name))
            return client.session(name).send_scan("laser", stamp_ns=world.stamp(10), **scan)

        refused = {name: refusal(lambda n=name: next_scan(n)) for name in NAMES}
        damaged = [name for name, error in refused.items() if error]
        assert len(damaged) == 1, refused
        (bad,) = damaged
        for name in set(NAMES) - {bad}:
            assert len(client.session(name).trajectory()) == len(trajectories[name]) + 1
            assert client.session(name).map.occupancy().cells.size > 0
        error = refused[bad]
        assert not isinstance(error, Unavailable), "trying again does not mend a damaged blob"
        assert error.reason not in ("", "INTERNAL"), error
        assert error.code in ("DATA_LOSS", "FAILED_PRECONDITION"), error
        # The list, the session itself, and a second try say it, too.
        shown = listed(own_server)
        assert shown[bad]["state"] == "SESSION_STATE_FAULTED", shown[bad]
        fault = shown[bad]["fault"]
        assert fault["reason"] not in ("", "INTERNAL"), fault
        assert fault["reason"] in f"{error.reason} {error.message}"
        assert refusal(lambda: next_scan(bad)).reason == error.reason
        others = set(NAMES) - {bad}
        assert "SESSION_STATE_FAULTED" not in {shown[name]["state"] for name in others}


def test_a_damaged_session_can_be_deleted_and_its_name_used_again(own_server, client):
    damaged_store(own_server, client)
    with Client(own_server.grpc) as client:
        for name in NAMES:
            refusal(client.session(name).pose)
            client.session(name).delete()
        for name in NAMES:
            again = robots.mapped(client, name, frames=4)
            assert len(again.trajectory()) == 4
    own_server.kill()
    own_server.start()
    with Client(own_server.grpc) as client:
        assert [len(client.session(name).trajectory()) for name in NAMES] == [4, 4, 4]


def test_damage_to_every_blob_stops_neither_the_start_nor_the_list(own_server, client):
    for phase, name in enumerate(NAMES):
        robots.mapped(client, name, phase=60 * phase)
    assert own_server.stop() == 0
    for path in blobs(own_server.data_dir):
        flip(path)
    own_server.start()
    assert list(listed(own_server)) == NAMES
    with Client(own_server.grpc) as client:
        fresh = robots.mapped(client, "fresh", frames=4)
        assert fresh.pose().state == "tracking"
        for i, name in enumerate(NAMES):
            scan = robots.scan(10, 60 * i)
            send = client.session(name).send_scan
            error = refusal(lambda send=send, scan=scan: send("laser", stamp_ns=world.stamp(10), **scan))
            assert error is not None
            assert not isinstance(error, Unavailable), error
    assert len(listed(own_server)) == 4


def test_listing_wakes_nobody(own_server, client):
    count = 30
    one = client.sessions.create("r00", sensors=[world.LIDAR])
    robots.send_sweeps(one, 0, 60)
    # Scans alike share their blobs, so that these are made quickly.
    for i in range(1, count):
        session = client.sessions.create(f"r{i:02}", sensors=[world.LIDAR])
        robots.send_sweeps(session, 0, 12)
    own_server.kill()
    own_server.start()
    # The first request of all takes memory of its own.
    assert httpx.get(f"{own_server.rest_url}/v1/time-sync").status_code == 200
    before = rss_mb(own_server.process.pid)
    sessions = listed(own_server)
    assert len(sessions) == count
    grown = rss_mb(own_server.process.pid) - before
    # A summary of a session is a few hundred bytes; the answer itself, parameters included, some kilobytes.
    assert grown < 8, f"listing {count} sessions took {grown:.0f} MB"
    assert {s["state"] for s in sessions.values()} == {"SESSION_STATE_ASLEEP"}


@pytest.mark.parametrize("stamp_ns", [2**62, 2**63 - 1, NOW_NS + 50 * YEAR_NS])
@pytest.mark.parametrize("before", [0, 3])
def test_an_impossible_stamp_is_refused_and_the_sensor_lives_on(client, own_server, stamp_ns, before):
    session = client.sessions.create("robot", sensors=[world.LASER])
    robots.send_scans(session, 0, before)
    with pytest.raises(InvalidArgument) as error:
        session.send_scan("laser", stamp_ns=stamp_ns, **robots.scan(before))
    assert error.value.reason == "STAMP_IMPLAUSIBLE"
    assert error.value.field == "stamp_ns"
    assert robots.send_scans(session, before, before + 3) == 3
    assert len(session.trajectory()) == before + 3
    own_server.kill()
    own_server.start()
    with Client(own_server.grpc) as client:
        assert robots.send_scans(client.session("robot"), before + 3, before + 5) == 2


def follow(session, first, last, start_ns, sensor_id="laser"):
    """Scans on the way, stamped from `start_ns` on; answers with the last result."""
    result = None
    for i in range(first, last):
        stamp = start_ns + (i - first) * world.FRAME_NS
        result = session.send_scan(sensor_id, stamp_ns=stamp, **robots.scan(i))
    return result


def test_a_clock_that_is_set_forward_after_boot_does_not_end_the_mapping(client):
    """A robot boots in 1970 and is told the time."""
    session = client.sessions.create("robot", sensors=[world.LASER])
    follow(session, 0, 8, start_ns=5 * 10**9)
    result = follow(session, 8, 16, start_ns=NOW_NS)
    assert result.pose.state == "tracking"
    truth = world.truth_in_map(list(robots.laps()))[15]
    assert world.position_error_m(result.pose.t_map_base, truth) < 0.1
    assert len(session.trajectory()) == 16
    assert all(len(list(s)) for s in [session.keyframes()])


def test_a_clock_that_is_set_back_is_answered_with_a_remedy_that_works(client):
    """The robot's clock was most of an hour fast, and is set. Its old sensor is past that time; the remedy is
    another one, with an offset.
    """
    session = client.sessions.create("robot", sensors=[world.LASER])
    follow(session, 0, 8, start_ns=NOW_NS + 3500 * 10**9)
    refused = refusal(lambda: follow(session, 8, 9, start_ns=NOW_NS))
    assert refused.reason == "CLOCK_SET_BACK"
    assert "declare" in refused.message
    offset_s = float(re.search(r"time_offset_s ([0-9.]+),", refused.message).group(1))
    again = SensorSpec(
        "laser2",
        kind="lidar2d",
        t_base_sensor=world.LASER.t_base_sensor,
        time_offset_s=offset_s + 2,
        overload_policy="block",
    )
    session.sensors.declare(again)
    before = session.pose()
    result = follow(session, 8, 14, start_ns=NOW_NS + 10**9, sensor_id="laser2")
    assert result.pose is not None, "the sensor that took over does not move the pose"
    assert session.pose().state == "tracking"
    assert session.pose().stamp_ns > before.stamp_ns
    truth = world.truth_in_map(list(robots.laps()))[13]
    assert world.position_error_m(session.pose().t_map_base, truth) < 0.1


def test_a_stamp_that_leaps_ahead_is_refused_and_the_sensor_lives_on(client):
    """One sample is stamped half an hour ahead; a clock that always was ahead, and a pause, are no slips."""
    session = client.sessions.create("robot", sensors=[world.LASER])
    now_ns = time.time_ns()
    follow(session, 0, 4, start_ns=now_ns)
    refused = refusal(lambda: follow(session, 4, 5, start_ns=now_ns + 1800 * 10**9))
    assert refused.reason == "STAMP_IMPLAUSIBLE"
    assert "1800 s" in refused.message
    follow(session, 4, 8, start_ns=now_ns + 4 * world.FRAME_NS)
    assert len(session.trajectory()) == 8
    ahead = client.sessions.create("ahead", sensors=[world.LASER])
    follow(ahead, 0, 4, start_ns=now_ns + 1800 * 10**9)
    follow(ahead, 4, 8, start_ns=now_ns + 1830 * 10**9)
    assert len(ahead.trajectory()) == 8


def test_time_that_stands_still_is_taken_once_and_goes_on(client):
    """Whether a stamp that comes again is refused or answered as the first was: it does nothing more."""
    session = client.sessions.create("robot", sensors=[world.LASER])
    follow(session, 0, 3, start_ns=NOW_NS)
    for i in (2, 5, 9):
        error = refusal(lambda i=i: follow(session, i, i + 1, start_ns=NOW_NS + 2 * world.FRAME_NS))
        assert error is None or error.reason == "STAMP_REPEATED"
    assert follow(session, 3, 4, start_ns=NOW_NS + 3 * world.FRAME_NS).pose.state == "tracking"
    assert session.trajectory().stamps_ns.tolist() == [NOW_NS + i * world.FRAME_NS for i in range(4)]
