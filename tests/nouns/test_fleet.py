"""All sessions at once: lists with filters and orders, and one watch over all of them."""

from __future__ import annotations

import asyncio
import json
import subprocess

import httpx
import pytest
from percept import (
    AsyncClient,
    Client,
    FleetEvent,
    InvalidArgument,
    Keyframe,
    PoseEstimate,
    Resync,
    SessionLife,
    SessionUpdated,
)

from support import world
from support.server import Server, binary, free_port


def send_scans(session, first, last):
    poses = world.drive(last)
    for i in range(first, last):
        session.send_scan("laser", stamp_ns=world.stamp(i), **world.scan(poses[i]))


def read(watch, until) -> list[FleetEvent]:
    seen = []
    while not seen or not until(seen[-1]):
        seen.append(next(watch))
    return seen


def life(event):
    return isinstance(event.event, SessionLife) and (event.event.step, event.event.state)


def test_one_watch_tells_of_all_sessions(client, name):
    with client.sessions.watch(f"{name}-*") as watch:
        one = client.sessions.create(f"{name}-1", sensors=[world.LASER])
        two = client.sessions.create(f"{name}-2", sensors=[world.LASER])
        client.sessions.create(f"other-{name}")
        send_scans(one, 0, 2)
        send_scans(two, 0, 1)
        updated = two.update(display_name="Two")
        one.delete()
        seen = read(watch, lambda e: life(e) == ("deleted", "unspecified"))
    assert {e.session_id for e in seen} == {one.session_id, two.session_id}
    tokens = [e.token for e in seen]
    assert tokens == sorted(set(tokens))
    of_one = [e for e in seen if e.session_id == one.session_id]
    states = [life(e) for e in of_one if isinstance(e.event, SessionLife)]
    assert states[0] == ("created", "unspecified")
    assert ("moved", "awake") in states
    assert states[-1] == ("deleted", "unspecified")
    poses = [e for e in of_one if isinstance(e.event, PoseEstimate)]
    assert [e.stamp_ns for e in poses] == [world.stamp(0), world.stamp(1)]
    assert any(isinstance(e.event, Keyframe) for e in of_one)
    assert [e.event.etag for e in seen if isinstance(e.event, SessionUpdated)] == [updated.etag]


def test_only_the_kinds_that_are_wanted_come(client, name):
    with client.sessions.watch(name, kinds=["settings", "life"]) as watch:
        session = client.sessions.create(name, sensors=[world.LASER])
        send_scans(session, 0, 3)
        session.update(labels={"a": "b"})
        seen = read(watch, lambda e: isinstance(e.event, SessionUpdated))
    assert {type(e.event) for e in seen} == {SessionLife, SessionUpdated}


def test_a_watch_of_all_resumes_after_its_token(client, name):
    session = client.sessions.create(name, sensors=[world.LASER])
    with client.sessions.watch(name, kinds=["pose"]) as watch:
        send_scans(session, 0, 2)
        first = read(watch, lambda e: e.stamp_ns == world.stamp(1))
    send_scans(session, 2, 4)
    with client.sessions.watch(name, kinds=["pose"], resume_token=watch.token) as again:
        rest = read(again, lambda e: e.stamp_ns == world.stamp(3))
    assert [e.stamp_ns for e in first + rest] == [world.stamp(i) for i in range(4)]


def test_a_token_from_before_a_restart_gets_a_resync(own_server, name):
    with Client(own_server.grpc) as client, client.sessions.watch() as watch:
        client.sessions.create(name)
        token = next(watch).token
    own_server.kill()
    own_server.start()
    with Client(own_server.grpc) as client, client.sessions.watch(resume_token=token) as watch:
        missing = next(watch)
        assert (missing.session_id, missing.event) == ("", Resync(missed=0))
        client.sessions.create(f"{name}-2")
        assert next(watch).session_id == f"{name}-2"


def test_a_watcher_that_is_too_far_behind_is_told_how_much_it_missed(tmp_path, monkeypatch, name):
    monkeypatch.setenv("PERCEPT_LIMITS_FLEET_EVENT_HISTORY", "4")
    server = Server(tmp_path / "data")
    try:
        with Client(server.grpc) as client:
            with client.sessions.watch(kinds=["life"]) as watch:
                client.sessions.create(name)
                token = next(watch).token
            for i in range(9):
                client.sessions.create(f"{name}-{i}")
            with client.sessions.watch(kinds=["settings"], resume_token=token) as watch:
                missing = next(watch)
            # Nine came, four are kept; it is told whatever kinds are wanted.
            assert (missing.event, missing.token) == (Resync(missed=5), token + 5)
    finally:
        server.kill()


def test_a_watch_of_all_goes_on_over_a_restart_of_the_server(tmp_path, name):
    server = Server(tmp_path / "data", grpc=f"127.0.0.1:{free_port()}")
    try:
        with Client(server.grpc, retries=20) as client, client.sessions.watch(kinds=["life"]) as watch:
            client.sessions.create(name)
            next(watch)
            server.kill()
            server.start()
            assert isinstance(next(watch).event, Resync)
            client.sessions.create(f"{name}-2")
            assert next(watch).session_id == f"{name}-2"
    finally:
        server.kill()


def test_asyncio_watches_all_too(server, name):
    async def scenario():
        async with AsyncClient(server.grpc) as client, client.sessions.watch(name) as watch:
            await client.sessions.create(name)
            assert life(await anext(watch)) == ("created", "unspecified")

    asyncio.run(scenario())


def test_rest_tells_of_all_sessions_as_server_sent_events(server, client, name):
    url = f"{server.rest_url}/v1/events?session_pattern={name}*&kinds=life&kinds=settings"

    def events(response, is_last):
        found, token = [], None
        for line in response.iter_lines():
            if line.startswith("id:"):
                token = line[3:].strip()
            if line.startswith("data:"):
                found.append(json.loads(line[5:]))
                assert found[-1]["token"] == token
                if is_last(found[-1]):
                    return found, token
        raise AssertionError(found)

    with httpx.stream("GET", url, timeout=30) as response:
        client.sessions.create(f"{name}-1").update(display_name="A")
        seen, token = events(response, lambda e: "new_etag" in e)
    assert seen[0]["life"]["step"] == "LIFE_STEP_CREATED"
    client.sessions.create(f"{name}-2")
    with httpx.stream("GET", url, timeout=30, headers={"last-event-id": token}) as response:
        again, _ = events(response, lambda e: e["session_id"] == f"{name}-2")
    assert again[-1]["life"]["step"] == "LIFE_STEP_CREATED"


@pytest.mark.parametrize(
    ("query", "reason", "field"),
    [
        ("kinds=smell", "QUERY_INVALID", "kinds"),
        ("kinds=unspecified", "ENUM_UNKNOWN", "kinds"),
        ("session_pattern=a/b", "PATTERN_INVALID", "session_pattern"),
        ("resume_token=-1", "QUERY_INVALID", "resume_token"),
        ("colour=red", "QUERY_INVALID", "colour"),
    ],
)
def test_watches_that_cannot_be_are_refused(server, query, reason, field):
    problem = httpx.get(f"{server.rest_url}/v1/events?{query}").json()
    assert (problem["reason"], problem["field"]) == (reason, field)


@pytest.fixture(scope="module")
def fleet(client):
    """Six sessions of two sites; their ids, oldest first."""
    prefix = "fleet-list"
    ids = []
    for i, site in enumerate(["north", "south", "north", "south", "north", "south"]):
        # Created in another order than that of their ids.
        session = client.sessions.create(f"{prefix}-{(i * 5) % 6}", labels={"site": site, f"n{i}": ""})
        ids.append(session.session_id)
    yield ids
    for session_id in ids:
        client.sessions.delete(session_id)


def listed(client, **asked):
    return [s.session_id for s in client.sessions.list(pattern="fleet-list-*", **asked)]


@pytest.mark.parametrize("page_size", [0, 1, 4])
def test_lists_are_filtered_and_ordered_and_their_pages_join(client, fleet, page_size):
    assert listed(client, page_size=page_size) == sorted(fleet)
    assert listed(client, order_by="create_time_ns", page_size=page_size) == fleet
    assert listed(client, order_by="create_time_ns desc", page_size=page_size) == fleet[::-1]
    assert listed(client, order_by="session_id desc", page_size=page_size) == sorted(fleet)[::-1]
    assert listed(client, labels="site=north", page_size=page_size) == sorted(fleet[::2])
    assert listed(client, labels="site=north,n2", order_by="create_time_ns", page_size=page_size) == [fleet[2]]
    assert listed(client, labels="site=nowhere", page_size=page_size) == []
    assert listed(client, state="asleep", page_size=page_size) == sorted(fleet)


def test_the_last_used_comes_first(client, fleet):
    client.session(fleet[3]).trajectory()
    assert listed(client, order_by="last_used_ns desc")[0] == fleet[3]


def test_labels_that_were_changed_are_found_after_a_restart_without_waking_anybody(own_server, name):
    with Client(own_server.grpc) as client:
        for i in range(3):
            client.sessions.create(f"{name}-{i}", labels={"site": "north"})
        client.session(f"{name}-1").update(labels={"site": "south"})
    own_server.kill()
    own_server.start()
    with Client(own_server.grpc) as client:
        assert [s.session_id for s in client.sessions.list(labels="site=south")] == [f"{name}-1"]
        assert [s.session_id for s in client.sessions.list(labels="site=north")] == [f"{name}-0", f"{name}-2"]
        assert {s.state for s in client.sessions.list()} == {"asleep"}


@pytest.mark.parametrize(
    ("asked", "reason", "field"),
    [
        ({"pattern": "a b"}, "PATTERN_INVALID", "session_pattern"),
        ({"labels": "=x"}, "LABEL_SELECTOR_INVALID", "label_selector"),
        ({"labels": "a,,b"}, "LABEL_SELECTOR_INVALID", "label_selector"),
        ({"order_by": "age"}, "ORDER_INVALID", "order_by"),
        ({"order_by": "session_id sideways"}, "ORDER_INVALID", "order_by"),
    ],
)
def test_lists_that_cannot_be_are_refused(client, asked, reason, field):
    with pytest.raises(InvalidArgument) as error:
        list(client.sessions.list(**asked))
    assert (error.value.reason, error.value.field) == (reason, field)


def test_a_token_of_another_order_is_refused(server, fleet):
    url = f"{server.rest_url}/v1/sessions"
    page = {"session_pattern": "fleet-list-*", "page_size": 2}
    token = httpx.get(url, params=page).json()["next_page_token"]
    other = httpx.get(url, params=page | {"order_by": "create_time_ns", "page_token": token}).json()
    assert (other["reason"], other["field"]) == ("PAGE_TOKEN_INVALID", "page_token")


def test_every_reason_is_explained_where_users_find_it(server):
    page = httpx.get(f"{server.rest_url}/reasons")
    assert page.headers["content-type"].startswith("text/markdown")
    document = httpx.get(f"{server.rest_url}/openapi.json").json()
    reasons = document["components"]["schemas"]["Reason"]["examples"]
    assert len(reasons) > 100
    assert all(f"| `{reason}` | " in page.text for reason in reasons)
    refused = httpx.get(f"{server.rest_url}/v1/sessions/nobody").json()
    assert refused["reason"] in reasons


def test_what_a_reader_may_not_see_it_is_not_told(tmp_path, name):
    """One tenant's watch is silent about the other's."""
    keys = tmp_path / "keys.json"

    def key(who, tenant, sessions):
        command = [binary(), "keys", "create", "--file", keys, "--name", who, "--tenant", tenant]
        command += ["--scope", "write", "--sessions", sessions, "--json"]
        return json.loads(subprocess.run(command, capture_output=True, check=True).stdout)["key"]

    ours, theirs, part = key("o", "ours", "*"), key("t", "theirs", "*"), key("p", "ours", "a-*")
    users = tmp_path / "users"
    users.write_text("robot:r\n")
    zenoh = '[[auth.zenoh_users]]\nuser = "robot"\ntenant = "ours"\naccess = "read"\nsessions = "b-*"\n'
    config = tmp_path / "percept.toml"
    files = f'keys_file = "{keys}"\nzenoh_users_file = "{users}"\n'
    config.write_text(f'[auth]\nmode = "required"\n{files}{zenoh}')
    server = Server(tmp_path / "data", "--config", str(config))
    try:
        with (
            Client(server.grpc, token=ours) as us,
            Client(server.grpc, token=theirs) as them,
            Client(server.grpc, token=part) as some,
            us.sessions.watch() as our_watch,
            them.sessions.watch() as their_watch,
            some.sessions.watch() as some_watch,
        ):
            us.sessions.create("b-1")
            us.sessions.create("a-1")
            them.sessions.create("c-1")
            assert [next(our_watch).session_id for _ in range(2)] == ["b-1", "a-1"]
            assert next(their_watch).session_id == "c-1"
            assert next(some_watch).session_id == "a-1"
    finally:
        server.kill()
