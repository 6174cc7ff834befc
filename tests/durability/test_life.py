"""The life and death of sessions, whenever callers leave: what was begun ends, and looks alike after a
restart.
"""

from __future__ import annotations

import random
import threading
from concurrent.futures import ThreadPoolExecutor

import httpx
import pytest
from percept import Client, NotFound, PerceptError

from support import raw, robots, world
from support.measure import cpu_s
from support.server import eventually, settled

CREATE, DELETE = "SessionsService/CreateSession", "SessionsService/DeleteSession"
POSE = "SessionsService/GetPose"
#: Reasons a caller can act on while a session is on its way out or in.
RETRYABLE = ("UNAVAILABLE", "ABORTED")


@pytest.fixture
def client(own_server):
    with Client(own_server.grpc) as client:
        yield client


@pytest.fixture
def calls(own_server):
    with raw.Calls(own_server.grpc) as calls:
        yield calls


def ids(server) -> list[str]:
    with Client(server.grpc) as client:
        return [s.session_id for s in client.sessions.list()]


def contents(server) -> dict[str, tuple[int, int, bool]]:
    """Each session's keyframes, trajectory entries, and whether it has a pose."""
    with Client(server.grpc) as client:
        out = {}
        for session_id in ids(server):
            session = client.session(session_id)
            keyframes, trajectory = list(session.keyframes()), session.trajectory()
            out[session_id] = (len(keyframes), len(trajectory), session.pose() is not None)
        return out


EMPTY = (0, 0, False)


def restarted(server) -> None:
    server.kill()
    server.start()


def deleted(calls, session_id) -> None:
    """Deletes for certain, whatever an earlier try has come to."""

    def gone():
        answer = calls(DELETE, session_id=session_id)
        assert answer.ok or answer.code in ("NOT_FOUND", *RETRYABLE), answer
        return answer.code in ("OK", "NOT_FOUND")

    assert eventually(gone), "deleting does not end"


def created(calls, session_id) -> None:
    """Creates, waiting while the old one of that name goes."""

    def there():
        answer = calls(CREATE, session_id=session_id)
        assert answer.ok or answer.code in RETRYABLE, answer
        return answer.ok

    assert eventually(there), "creating does not come through"


def test_a_delete_that_its_caller_gave_up_never_leaks_the_old_map_into_a_new_session(own_server, client, calls):
    rng = random.Random(16)
    names = [f"r{i}" for i in range(12)]
    for name in names:
        # So many records take longer to delete than these callers wait.
        robots.mapped(client, name, frames=60)
    for name in names:
        begun = calls(DELETE, timeout_s=rng.uniform(0.0005, 0.004), session_id=name)
        assert begun.ok or begun.unheard, begun
        answer = calls(CREATE, session_id=name)
        if answer.code == "ALREADY_EXISTS":
            # The call may not have reached the server at all. Then nothing happened to the session.
            deleted(calls, name)
        if not answer.ok:
            created(calls, name)
    assert contents(own_server) == dict.fromkeys(names, EMPTY)
    restarted(own_server)
    assert contents(own_server) == dict.fromkeys(names, EMPTY)


def test_a_delete_over_rest_whose_client_leaves_at_once_is_done_or_not_and_stays_so(own_server, client):
    names = [f"r{i}" for i in range(8)]
    for name in names:
        robots.mapped(client, name)
    whole = contents(own_server)
    for name in names:
        raw.send_and_leave(own_server.rest, raw.request_head("DELETE", f"/v1/sessions/{name}"))
    left = settled(lambda: ids(own_server))
    assert left != names, "no request has arrived; this shows nothing"
    restarted(own_server)
    assert ids(own_server) == left, "sessions came back from the dead"
    assert contents(own_server) == {name: whole[name] for name in left}


def test_a_session_created_while_the_old_one_goes_is_new_and_lasts(own_server, client, calls):
    names = [f"r{i}" for i in range(12)]
    for name in names:
        robots.mapped(client, name)
    made = []
    with raw.Calls(own_server.grpc) as other:
        for name in names:
            going = other.begin(DELETE, session_id=name)
            while not (answer := calls(CREATE, session_id=name)).ok:
                # The delete has not begun, or has not ended.
                assert answer.code in ("ALREADY_EXISTS", *RETRYABLE), answer
            made.append(name)
            assert raw.answer_of(going).ok
    assert contents(own_server) == dict.fromkeys(made, EMPTY), "acknowledged as new, with the old one's map"
    restarted(own_server)
    assert contents(own_server) == dict.fromkeys(made, EMPTY), "acknowledged, then lost"


def test_what_is_sent_to_a_new_session_survives_the_death_of_the_old_one(own_server, client, calls):
    """Deleting goes on behind its caller's back; it must not reach what the next session of that name has
    stored.
    """
    for round_ in range(4):
        name = f"r{round_}"
        robots.mapped(client, name, frames=30)
        raw.send_and_leave(own_server.rest, raw.request_head("DELETE", f"/v1/sessions/{name}"))
        with raw.Calls(own_server.grpc) as other:
            other.begin(DELETE, timeout_s=0.001, session_id=name)
            deleted(calls, name)
            created(calls, name)
        session = client.session(name)
        session.sensors.declare(world.LASER)
        assert robots.send_scans(session, 0, 7, phase=40) == 7
    before = contents(own_server)
    assert [value[1] for value in before.values()] == [7] * 4
    restarted(own_server)
    assert contents(own_server) == before


def test_a_create_that_its_caller_gave_up_is_whole_or_absent_and_stays_so(own_server, calls):
    rng = random.Random(7)
    names = [f"r{i:02}" for i in range(20)]
    for name in names:
        answer = calls(CREATE, timeout_s=rng.uniform(0.0005, 0.004), session_id=name, request_id=f"once-{name}")
        assert answer.ok or answer.unheard, answer
    there = settled(lambda: ids(own_server))
    restarted(own_server)
    assert ids(own_server) == there, "what the server said of them before is not what it says after a restart"
    with raw.Calls(own_server.grpc) as again:
        for name in names:
            answer = again(CREATE, session_id=name, request_id=f"once-{name}")
            assert answer.ok, answer
            assert answer.message.session.session_id == name
            # Of a complete session, not of one that is half there.
            assert answer.message.session.create_time_ns > 0
    assert ids(own_server) == names


def test_a_create_over_rest_whose_client_leaves_at_once_is_whole_or_absent(own_server):
    names = [f"r{i:02}" for i in range(12)]
    for name in names:
        body = f'{{"session_id": "{name}"}}'.encode()
        head = raw.request_head("POST", "/v1/sessions", content_type="application/json", content_length=len(body))
        raw.send_and_leave(own_server.rest, head + body)
    there = settled(lambda: ids(own_server))
    restarted(own_server)
    assert ids(own_server) == there


def test_one_request_id_makes_one_session_however_many_ask_and_leave(own_server):
    rng = random.Random(3)
    waits = [rng.uniform(0.0005, 0.01) if i % 2 else 30.0 for i in range(24)]
    barrier = threading.Barrier(8)

    def ask(share):
        with raw.Calls(own_server.grpc) as calls:
            barrier.wait()
            return [calls(CREATE, timeout_s=t, request_id="once", display_name="one") for t in share]

    with ThreadPoolExecutor(8) as pool:
        answers = [a for part in pool.map(ask, [waits[i::8] for i in range(8)]) for a in part]
    assert all(a.ok or a.unheard for a in answers), answers
    given = {a.message.session.session_id for a in answers if a.ok}
    assert len(given) == 1
    assert settled(lambda: ids(own_server)) == list(given)
    restarted(own_server)
    assert ids(own_server) == list(given)
    with Client(own_server.grpc) as client:
        assert client.sessions.create(request_id="once").session_id in given


def test_one_id_wanted_by_many_is_given_once(own_server):
    barrier = threading.Barrier(8)

    def ask(i):
        with raw.Calls(own_server.grpc) as calls:
            barrier.wait()
            return [calls(CREATE, session_id=f"r{k}", display_name=f"of {i}") for k in range(6)]

    with ThreadPoolExecutor(8) as pool:
        answers = list(pool.map(ask, range(8)))
    for column in zip(*answers):
        assert sorted(a.code for a in column) == ["ALREADY_EXISTS"] * 7 + ["OK"]
    restarted(own_server)
    with Client(own_server.grpc) as client:
        for k, column in enumerate(zip(*answers)):
            (winner,) = (a.message.session.display_name for a in column if a.ok)
            assert client.session(f"r{k}").info().display_name == winner


@pytest.fixture
def sleeper(own_server, client):
    """A session whose waking takes far longer than a call that answers at once; its server has just
    started.
    """
    session = client.sessions.create("heavy", sensors=[world.LIDAR])
    count = robots.HEAVY_SWEEPS
    assert robots.send_sweeps(session, 0, count, stride=robots.HEAVY_STRIDE) == count
    restarted(own_server)
    return session.session_id


def test_a_wake_that_its_callers_do_not_wait_for_goes_on(own_server, sleeper):
    with raw.Calls(own_server.grpc) as calls:
        first = calls(POSE, timeout_s=0.02, session_id=sleeper)
        assert not first.ok, "waking was as quick as an answer; this shows nothing"

        def answered():
            return calls(POSE, timeout_s=0.02, session_id=sleeper).ok

        assert eventually(answered), "each call begins to wake it anew"
        impatient_s = cpu_s(own_server.process.pid)
    restarted(own_server)
    with raw.Calls(own_server.grpc) as calls:
        assert calls(POSE, session_id=sleeper).ok
        patient_s = cpu_s(own_server.process.pid)
    # A session is built once, not once for each caller.
    assert impatient_s < 2 * patient_s + 0.5


def test_others_are_served_while_a_session_wakes(own_server, sleeper):
    """Creating with a request id looks at all sessions; that must not wait for one that wakes."""
    with Client(own_server.grpc) as client:
        client.sessions.create("other")
    with raw.Calls(own_server.grpc) as calls, raw.Calls(own_server.grpc) as busy:
        waking = busy.begin(POSE, session_id=sleeper)
        assert calls(CREATE, session_id="new", request_id="new").ok
        assert calls(DELETE, session_id="new").ok
        assert calls(POSE, session_id="other").ok
        assert not waking.done(), "they waited for the one that wakes"
        assert raw.answer_of(waking).ok


def test_a_session_that_is_deleted_while_it_wakes_is_gone(own_server, sleeper):
    with raw.Calls(own_server.grpc) as calls, raw.Calls(own_server.grpc) as busy:
        waking = busy.begin(POSE, session_id=sleeper)
        assert calls(DELETE, session_id=sleeper).ok
        answer = raw.answer_of(waking)
        assert answer.ok or answer.code in ("NOT_FOUND", *RETRYABLE), answer
        assert calls(POSE, session_id=sleeper).code == "NOT_FOUND"
    restarted(own_server)
    assert ids(own_server) == []


def test_frames_are_refused_not_lost_while_their_session_is_deleted(own_server, client, calls):
    session = robots.mapped(client, "robot", frames=3)
    stream = session.stream(max_in_flight=8)
    ended = []

    def send():
        try:
            for i in range(3, 100_000):
                stream.send_scan("laser", stamp_ns=world.stamp(i), **robots.scan(i % 20))
        except PerceptError as error:
            ended.append(error)

    sending = threading.Thread(target=send)
    sending.start()
    assert eventually(lambda: stream.summary.accepted > 10)
    assert calls(DELETE, session_id="robot").ok

    def reasons():
        return {e.reason for e in ended} | {a.rejection.reason for a in stream.summary.rejections}

    # Either the stream ends, or each frame is refused; and not as if trying again would help.
    final = {"SESSION_NOT_FOUND", "SESSION_DELETING", "SESSION_DELETED"}
    assert eventually(lambda: reasons() & final), reasons()
    stream.cancel()
    sending.join()
    with pytest.raises(NotFound):
        session.info()
    restarted(own_server)
    assert ids(own_server) == []


def test_the_list_over_rest_shows_no_session_that_is_going(own_server, client):
    names = [f"r{i}" for i in range(6)]
    for name in names:
        robots.mapped(client, name, frames=5)
    with httpx.Client(base_url=own_server.rest_url, timeout=30) as http:
        for name in names:
            assert http.delete(f"/v1/sessions/{name}").status_code == 200
            listed = [s["session_id"] for s in http.get("/v1/sessions").json().get("sessions", [])]
            assert name not in listed


def test_what_a_deleted_session_stored_is_gone_at_the_first_try(own_server, client):
    for k in range(6):
        session = robots.mapped(client, f"robot-{k}")
        session.delete()
        folder = own_server.data_dir / "sessions" / f"robot-{k}"
        assert eventually(lambda folder=folder: not folder.exists())
    assert "still there" not in own_server.log.read_text()
