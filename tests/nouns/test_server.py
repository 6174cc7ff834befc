"""The server itself: what runs, and what it allows."""

from __future__ import annotations

import time

import httpx
import pytest

from support.server import Server


@pytest.fixture
def info(server):
    return httpx.get(f"{server.rest_url}/v1/server").json()["server"]


def test_a_server_says_what_it_is(info):
    assert info["version"].count(".") == 2
    assert set(info["doors"]) == {"grpc", "rest", "zenoh"}
    assert info["is_ready"] is True
    assert info["not_ready"] == []
    assert abs(int(info["time_ns"]) / 1e9 - time.time()) < 60


def test_limits_in_force_are_named_as_in_the_configuration(tmp_path, monkeypatch):
    monkeypatch.setenv("PERCEPT_LIMITS_MAX_SESSIONS", "7")
    own = Server(tmp_path / "data")
    try:
        limits = httpx.get(f"{own.rest_url}/v1/server").json()["server"]["limits"]
        assert limits["max_sessions"] == "7"
        assert int(limits["max_message_bytes"]) > 1 << 20
    finally:
        own.kill()


def test_it_says_where_its_data_are(tmp_path, server, info):
    assert info["store"] == "file"
    own = Server(None, "--store-url", "memory://", log=tmp_path / "log")
    try:
        assert httpx.get(f"{own.rest_url}/v1/server").json()["server"]["store"] == "memory"
    finally:
        own.kill()


def test_time_goes_on(server):
    def uptime():
        return httpx.get(f"{server.rest_url}/v1/server").json()["server"]["uptime_s"]

    first = uptime()
    assert 0 <= first < uptime()
