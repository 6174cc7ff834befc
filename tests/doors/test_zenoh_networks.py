"""Percept in a network of zenoh: beside a router that robots connect to, and before it is there; namespaces."""

from __future__ import annotations

import contextlib
import json
import subprocess

import pytest
import zenoh
from percept import Client
from percept.errors import DeadlineExceeded
from percept.zenoh import MapReader, SensorPublisher

from support import world
from support.links import Link
from support.ros2 import Router
from support.server import Server, binary, eventually


@pytest.fixture
def router():
    with Router() as router:
        yield router


@pytest.fixture
def start(tmp_path, monkeypatch):
    """Starts a server with further arguments, and a client of it. Whoever reaches the router is let in."""
    monkeypatch.setenv("PERCEPT_AUTH_ALLOW_ANONYMOUS_BEYOND_LOOPBACK", "true")
    servers = []

    def started(*arguments: str, zenoh: str | None = None) -> tuple[Server, Client]:
        servers.append(Server(tmp_path / f"data-{len(servers)}", *arguments, zenoh=zenoh))
        return servers[-1], Client(servers[-1].grpc)

    yield started
    for server in servers:
        server.kill()


def joined(router: Router) -> zenoh.Session:
    """A peer of a router."""
    config = zenoh.Config()
    for key, value in {"connect/endpoints": [router.endpoint], "scouting/multicast/enabled": False}.items():
        config.insert_json5(key, json.dumps(value))
    return zenoh.open(config)


def drive(publisher: SensorPublisher, first: int, last: int) -> None:
    poses = world.drive(last)
    for i in range(first, last):
        publisher.send_scan("laser", stamp_ns=world.stamp(i), **world.scan(poses[i]))


# By the router alone, and listening beside it.
@pytest.mark.parametrize("listens", [False, True])
def test_a_robot_reaches_percept_by_the_router_that_both_are_connected_to(start, router, listens):
    _, client = start("--zenoh-connect", router.endpoint, zenoh=None if listens else "")
    session = client.sessions.create(sensors=[world.LASER])
    of = {"session_id": session.session_id}
    with SensorPublisher(router.endpoint, **of) as publisher, MapReader(router.endpoint, **of) as reader:
        with reader.poses() as published:
            drive(publisher, 0, 3)
            assert published.receive(timeout_s=10).stamp_ns >= world.stamp(0)
        assert eventually(lambda: session.sensors.list()[0].accepted == 3)
        assert reader.pose() == session.info().pose


def test_the_router_may_come_later_and_go_and_come_back(start, tmp_path):
    router = Router()
    router.close()
    _, client = start("--zenoh-connect", router.endpoint, zenoh="")
    session = client.sessions.create(sensors=[world.LASER])

    def send(first: int, last: int) -> None:
        with SensorPublisher(router.endpoint, session_id=session.session_id) as publisher:
            drive(publisher, first, last)

    # At once each time, too: percept is there again before it has done with the router that left.
    for i in range(0, 16, 2):
        router.start()
        with MapReader(router.endpoint, session_id=session.session_id) as reader, reader.poses() as poses:
            send(i, i + 2)
            assert eventually(lambda i=i: session.sensors.list()[0].accepted == i + 2)
            if i > 0:
                assert poses.receive(timeout_s=10).stamp_ns >= world.stamp(i)
        router.close()


def test_a_link_to_the_router_may_break(start, router):
    with Link(router.endpoint) as link:
        _, client = start("--zenoh-connect", link.endpoint, zenoh="")
        session = client.sessions.create(sensors=[world.LASER])
        of = {"session_id": session.session_id}
        with SensorPublisher(router.endpoint, **of) as publisher, MapReader(router.endpoint, **of) as reader:
            sent = 0

            def is_there_again(poses) -> bool:
                """What is published while nobody is connected is lost."""
                nonlocal sent
                drive(publisher, sent, sent + 1)
                sent += 1
                with contextlib.suppress(DeadlineExceeded):
                    return poses.receive(timeout_s=0.2).stamp_ns > cut_at
                return False

            for _ in range(5):
                with reader.poses() as poses:
                    cut_at = world.stamp(sent)
                    assert eventually(lambda poses=poses: is_there_again(poses))
                link.cut()


def test_sites_of_one_router_are_apart_by_their_namespaces(start, router, tmp_path):
    sessions = {}
    for site in ("site-a", "site-b/hall-2"):
        config = tmp_path / f"{site[:6]}.toml"
        config.write_text(f'[zenoh]\nconnect = ["{router.endpoint}"]\nnamespace = "{site}"\n')
        _, client = start("--config", str(config), zenoh="")
        sessions[site] = client.sessions.create(session_id="robot", sensors=[world.LASER])
    for site in sessions:
        with SensorPublisher(router.endpoint, session_id="robot", namespace=site) as publisher:
            drive(publisher, 0, 2 if site == "site-a" else 5)
    for site, session in sessions.items():
        num = 2 if site == "site-a" else 5
        assert eventually(lambda session=session, num=num: session.sensors.list()[0].accepted == num)
        with MapReader(router.endpoint, session_id="robot", namespace=site) as reader:
            assert reader.pose() == session.info().pose


def test_percept_is_no_bridge_between_the_networks_that_it_joins(start, router):
    with Router() as other:
        _, client = start("--zenoh-connect", router.endpoint, "--zenoh-connect", other.endpoint, zenoh="")
        session = client.sessions.create(sensors=[world.LASER])
        here, there = joined(router), joined(other)
        heard: list[str] = []
        # What a router may not pass on it may not be asked for: "**" would be refused as a whole.
        for keys in ("percept/**", "0/**"):
            here.declare_subscriber(keys, lambda sample: heard.append(str(sample.key_expr)))
        # It is connected to both.
        for endpoint in (router.endpoint, other.endpoint):
            with MapReader(endpoint, session_id=session.session_id) as reader:
                assert eventually(lambda reader=reader: reader.sensors())
        there.put("0/cmd_vel/geometry_msgs::msg::dds_::Twist_", b"drive")
        with SensorPublisher(other.endpoint, session_id=session.session_id) as publisher:
            drive(publisher, 0, 3)
        # What percept says comes after what it was to pass on.
        assert eventually(lambda: any(key.endswith("/pose") for key in heard))
        assert all(key.startswith("percept/") for key in heard), heard
        here.close()
        there.close()


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ('[zenoh]\nconnect = ["router:7447"]\n', 'zenoh.connect is "router:7447"; write tcp/'),
        ('[zenoh]\nnamespace = "a//b"\n', 'zenoh.namespace is "a//b"; write names'),
        ('[zenoh]\nnamespace = "a*"\n', 'zenoh.namespace is "a*"; write names'),
        ('[zenoh]\nconnect = ["tcp/127.0.0.1:7447"]\n', "auth.allow_anonymous_beyond_loopback = true"),
        (
            '[zenoh]\nconnect = ["tcp/127.0.0.1:7447"]\n[auth]\nmode = "required"\nkeys_file = "keys.json"\n',
            "who sends through a router cannot be told",
        ),
    ],
)
def test_networks_that_cannot_be_are_refused(tmp_path, settings, said):
    config = tmp_path / "percept.toml"
    config.write_text(settings)
    command = [binary(), "serve", "--config", config, "--data-dir", tmp_path / "data"]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=30)
    assert ended.returncode != 0
    assert said in ended.stderr
