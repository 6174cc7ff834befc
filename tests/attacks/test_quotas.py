"""What one tenant may use: too fast is told when to come back, too many is refused, and others notice nothing."""

from __future__ import annotations

import itertools
import json
import signal
import subprocess
import time

import httpx
import pytest
from percept import Client, ResourceExhausted

from support import robots, world
from support.server import Server, binary, eventually

CONFIG = """
[auth]
mode = "required"
keys_file = "{keys}"
zenoh_users_file = "{users}"

[[auth.zenoh_users]]
user = "robot"
tenant = "free"
access = "write"
sessions = "*"

[quotas.tenants.greedy]
{quota}
"""


class Site:
    """A server with a tenant that has a quota, and one that has none."""

    def __init__(self, folder, quota: str) -> None:
        self._config, self._keys = folder / "percept.toml", folder / "keys.json"
        self._users = folder / "users"
        self._users.write_text("robot:secret\n")
        self._greedy, self._free = self._key("greedy"), self._key("free")
        self.set(quota)
        self.server = Server(folder / "data", "--config", str(self._config))

    def _key(self, tenant: str) -> str:
        command = [binary(), "keys", "create", "--file", self._keys, "--name", "robot", "--tenant", tenant]
        made = subprocess.run([*command, "--scope", "admin", "--json"], capture_output=True, check=True)
        return json.loads(made.stdout)["key"]

    def set(self, quota: str) -> None:
        self._config.write_text(CONFIG.format(keys=self._keys, users=self._users, quota=quota))

    def greedy(self) -> Client:
        return Client(self.server.grpc, token=self._greedy, retries=0)

    def free(self) -> Client:
        return Client(self.server.grpc, token=self._free, retries=0)

    @property
    def headers(self) -> dict[str, str]:
        return {"authorization": f"Bearer {self._greedy}"}

    def rest(self, path: str) -> httpx.Response:
        return httpx.get(f"{self.server.rest_url}{path}", headers=self.headers)


@pytest.fixture
def site(tmp_path):
    """Starts a server: `site("max_sessions = 2")`."""
    sites = []

    def start(quota: str) -> Site:
        sites.append(Site(tmp_path, quota))
        return sites[-1]

    yield start
    for site in sites:
        site.server.kill()


def refused(ask) -> ResourceExhausted | None:
    """The refusal of a call, if it is one."""
    try:
        ask()
    except ResourceExhausted as error:
        return error
    return None


def refusal(ask) -> ResourceExhausted:
    """The first refusal for being too fast, which has to come: rates here are so low that slow calls exceed them."""
    error = eventually(lambda: refused(ask), seconds=60)
    assert error, "nothing was refused"
    return error


def least_s(count: int, rate: int) -> float:
    """Time that so many take: a second's worth comes at once, the last as soon as anything is left for it."""
    return (count - 1 - rate) / rate


def test_who_asks_too_often_is_told_when_to_ask_again(site):
    place = site("max_requests_per_s = 2")
    with place.greedy() as greedy, place.free() as free:
        error = refusal(lambda: greedy.sessions.create())
        assert error.reason == "RATE_LIMITED"
        assert 0 < error.retry_after_s < 2
        # One connection for all: to make one takes longer than a call.
        with httpx.Client(base_url=place.server.rest_url, headers=place.headers) as rest:

            def over():
                answer = rest.get("/v1/sessions")
                return answer if answer.status_code == 429 else None

            answer = eventually(over, seconds=60)
        assert answer, "nothing was refused"
        assert answer.json()["reason"] == "RATE_LIMITED"
        assert int(answer.headers["retry-after"]) >= 1
        for _ in range(100):
            list(free.sessions.list())
        # A client that waits as it is told gets through.
        patient, began = greedy.with_options(retries=20), time.monotonic()
        for _ in range(8):
            list(patient.sessions.list())
        assert time.monotonic() - began > least_s(8, 2)


def test_a_stream_that_is_too_fast_is_held_back_and_loses_nothing(site):
    place = site("max_session_frames_per_s = 4")
    with place.greedy() as greedy, place.free() as free:
        session = greedy.sessions.create("slow", sensors=[world.LASER])
        began = time.monotonic()
        assert robots.send_scans(session, 0, 12) == 12
        assert time.monotonic() - began > least_s(12, 4)
        other = free.sessions.create("fast", sensors=[world.LASER])
        assert robots.send_scans(other, 0, 120) == 120
        frames = itertools.count(200)
        single = refusal(lambda: session.send_scan("laser", stamp_ns=world.stamp(next(frames)), **robots.scan(0)))
        assert single.reason == "RATE_LIMITED"


def test_sessions_watchers_and_streams_are_counted_by_tenant(site):
    place = site("max_sessions = 2\nmax_watchers = 1\nmax_ingest_streams = 1")
    with place.greedy() as greedy, place.free() as free:
        sessions = [greedy.sessions.create(sensors=[world.LASER]) for _ in range(2)]
        assert refused(greedy.sessions.create).reason == "TOO_MANY_SESSIONS"
        sessions.pop().delete()
        sessions.append(greedy.sessions.create())
        assert len([free.sessions.create() for _ in range(4)]) == 4
        events = f"/v1/sessions/{sessions[0].session_id}/events"
        with sessions[0].watch():
            answer = place.rest(events)
            assert (answer.status_code, answer.json()["reason"]) == (429, "TOO_MANY_WATCHERS")

        def is_watched() -> bool:
            with httpx.stream("GET", f"{place.server.rest_url}{events}", headers=place.headers) as answer:
                return answer.status_code == 200

        assert eventually(is_watched), "the place of the one that ended was not given back"


def test_quotas_change_while_the_server_runs(site):
    place = site("max_sessions = 1")
    with place.greedy() as greedy:
        greedy.sessions.create()
        assert refused(greedy.sessions.create).reason == "TOO_MANY_SESSIONS"
        place.set("max_sessions = 2")
        place.server.process.send_signal(signal.SIGHUP)

        def created() -> bool:
            return refused(greedy.sessions.create) is None

        assert eventually(created)
        assert refused(greedy.sessions.create).reason == "TOO_MANY_SESSIONS"
