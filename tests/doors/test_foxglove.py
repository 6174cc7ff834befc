"""Foxglove opens a session directly: its WebSocket protocol, read here by a client written from its specification."""

from __future__ import annotations

import itertools
import json
import struct
import subprocess

import httpx
import numpy as np
import pytest
from percept import Client, Pose
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from support import ros2, world
from support.server import Server, binary, eventually

PROTOCOLS = ["foxglove.sdk.v1", "foxglove.websocket.v1"]
PATIENCE_S = 20.0
FRAMES = 12


class Foxglove:
    """As much of Foxglove as the tests need."""

    def __init__(self, rest: str, session: str, *, protocols=PROTOCOLS, query: str = "", **options) -> None:
        url = f"ws://{rest}/v1/sessions/{session}/foxglove{query}"
        self._connection = connect(url, subprotocols=protocols, max_size=None, **options)
        self.socket = self._connection.__enter__()
        self.info = self._json()
        self.channels = {c["topic"]: c for c in self._json()["channels"]}
        # Messages are read by the definitions that come with them.
        self.types = get_typestore(Stores.EMPTY)
        for channel in self.channels.values():
            known = get_types_from_msg(channel["schema"], channel["schemaName"])
            self.types.register({k: v for k, v in known.items() if k not in self.types.fielddefs})
        self.times: list[int] = []
        self.statuses: list[dict] = []

    def __enter__(self) -> Foxglove:
        return self

    def __exit__(self, *_) -> None:
        self._connection.__exit__(None, None, None)

    def _json(self) -> dict:
        return json.loads(self.socket.recv(timeout=PATIENCE_S))

    def subscribe(self, *topics: str) -> None:
        """Subscriptions are numbered as channels, and 100 more."""
        wanted = [{"id": 100 + self.channels[t]["id"], "channelId": self.channels[t]["id"]} for t in topics]
        self.socket.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))

    def publish(self, topic: str, schema: str, message: bytes, encoding: str = "cdr") -> None:
        """Advertises and sends."""
        channel = {"id": 7, "topic": topic, "encoding": encoding, "schemaName": schema}
        self.socket.send(json.dumps({"op": "advertise", "channels": [channel]}))
        self.socket.send(struct.pack("<BI", 1, 7) + message)

    def next(self) -> tuple[str, int, object] | dict:
        """The next message (topic, time, decoded), or what is said."""
        data = self.socket.recv(timeout=PATIENCE_S)
        if isinstance(data, str):
            said = json.loads(data)
            if said["op"] == "status":
                self.statuses.append(said)
            return said
        if data[0] == 2:
            self.times.append(struct.unpack_from("<Q", data, 1)[0])
            return {"op": "time"}
        op, subscription, time_ns = struct.unpack_from("<BIQ", data)
        assert op == 1
        channel = next(c for c in self.channels.values() if c["id"] + 100 == subscription)
        return channel["topic"], time_ns, self.types.deserialize_cdr(data[13:], channel["schemaName"])

    def until(self, *topics: str) -> dict[str, object]:
        """The first message of each topic."""
        got: dict[str, object] = {}
        while set(got) != set(topics):
            came = self.next()
            if isinstance(came, tuple):
                got.setdefault(came[0], came[2])
        return got

    def status(self) -> str:
        """The next that is said to a person."""
        while True:
            came = self.next()
            if isinstance(came, dict) and came["op"] == "status":
                return came["message"]


@pytest.fixture
def mapped(client, name):
    """A session that has seen a room."""
    session = client.sessions.create(name, sensors=[world.LASER])
    poses = world.drive(FRAMES)
    for i, pose in enumerate(poses):
        session.send_scan("laser", stamp_ns=world.stamp(i), **world.scan(pose))
    return session, poses


def test_all_that_is_known_comes_to_who_subscribes(server, mapped):
    session, _ = mapped
    with Foxglove(server.rest, session.session_id) as foxglove:
        assert foxglove.socket.subprotocol == "foxglove.sdk.v1"
        assert {"clientPublish", "time"} <= set(foxglove.info["capabilities"])
        topics = ["/tf", "/tf_static", "/percept/pose", "/map", "/percept/path", "/percept/cloud"]
        foxglove.subscribe(*topics, "/percept/objects", "/percept/detections")
        got = foxglove.until(*topics, "/percept/objects", "/percept/detections")
        expected = session.pose().t_map_base
        told = got["/percept/pose"].pose.pose.position
        np.testing.assert_allclose([told.x, told.y], expected.translation[:2], atol=1e-9)
        (transform,) = got["/tf"].transforms
        assert (transform.header.frame_id, transform.child_frame_id) == ("map", "base_link")
        (mount,) = got["/tf_static"].transforms
        assert (mount.header.frame_id, mount.child_frame_id) == ("base_link", "laser")
        grid = session.map.occupancy()
        assert (got["/map"].info.height, got["/map"].info.width) == grid.cells.shape
        assert len(got["/percept/path"].poses) == len(session.keyframes().all())
        assert got["/percept/cloud"].width * got["/percept/cloud"].height > 0
        assert foxglove.times[0] == world.stamp(FRAMES - 1), "the time is the robot's, not the server's"


def test_what_happens_later_comes_too_and_what_nobody_wants_does_not(server, mapped):
    session, _ = mapped
    with Foxglove(server.rest, session.session_id) as foxglove:
        foxglove.subscribe("/percept/pose")
        foxglove.until("/percept/pose")
        later = world.drive(FRAMES + 1)[-1]
        session.send_scan("laser", stamp_ns=world.stamp(FRAMES), **world.scan(later))
        topic, time_ns, message = next(m for m in iter(foxglove.next, None) if isinstance(m, tuple))
        assert (topic, time_ns) == ("/percept/pose", world.stamp(FRAMES))
        assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == world.stamp(FRAMES)
        subscription = 100 + foxglove.channels["/percept/pose"]["id"]
        foxglove.socket.send(json.dumps({"op": "unsubscribe", "subscriptionIds": [subscription]}))
        foxglove.subscribe("/tf")
        session.send_scan("laser", stamp_ns=world.stamp(FRAMES + 1), **world.scan(later))
        assert set(foxglove.until("/tf")) == {"/tf"}


def test_a_goal_comes_back_as_a_path_or_with_the_reason_why_there_is_none(server, mapped):
    session, _ = mapped
    with Foxglove(server.rest, session.session_id) as foxglove:
        foxglove.subscribe("/percept/plan")
        goal = Pose.from_xyz(0.6, 0.1, 0.0)
        foxglove.publish("/goal_pose", "geometry_msgs/PoseStamped", ros2.pose_stamped(world.stamp(0), "map", goal))
        path = foxglove.until("/percept/plan")["/percept/plan"]
        last = path.poses[-1].pose.position
        np.testing.assert_allclose([last.x, last.y], goal.translation[:2], atol=0.05)
        far = Pose.from_xyz(500.0, 0.0, 0.0)
        foxglove.publish("/goal_pose", "geometry_msgs/msg/PoseStamped", ros2.pose_stamped(world.stamp(0), "map", far))
        assert "no path" in foxglove.status()
        assert foxglove.until("/percept/plan")["/percept/plan"].poses == []
        of_odom = ros2.pose_stamped(world.stamp(0), "odom", goal)
        foxglove.publish("/goal_pose", "geometry_msgs/msg/PoseStamped", of_odom)
        assert "frame" in foxglove.status()


def test_where_the_robot_is_said_to_be_it_is_if_what_it_sees_fits(server, mapped):
    session, poses = mapped
    schema = "geometry_msgs/msg/PoseWithCovarianceStamped"

    def say(foxglove: Foxglove, frame: str, of: Pose) -> None:
        message = ros2.STORE.serialize_cdr(ros2.pose_estimate(frame, of), schema)
        foxglove.publish("/initialpose", schema, bytes(message))

    truth = Pose.from_matrix(world.truth_in_map([poses[0], poses[-1]])[1])
    with Foxglove(server.rest, session.session_id) as foxglove:
        say(foxglove, "odom", truth)
        assert "frame" in foxglove.status()
        stamps = itertools.count(FRAMES)

        def stand() -> bool:
            session.send_scan("laser", stamp_ns=world.stamp(next(stamps)), **world.scan(poses[-1]))
            return session.pose().tentative

        say(foxglove, "map", Pose.from_matrix(truth.matrix @ Pose.from_xy_yaw(0.0, 0.0, 1.6).matrix))
        assert not any(stand() for _ in range(30))
        assert "does not fit" in foxglove.status()
        say(foxglove, "map", Pose.from_matrix(truth.matrix @ Pose.from_xy_yaw(0.3, 0.1, 0.1).matrix))
        assert eventually(stand)
        assert world.position_error_m(session.pose().t_map_base, truth.matrix) < 0.08


@pytest.mark.parametrize(
    "said",
    [
        "no json",
        "[]",
        '{"op": "subscribe"}',
        '{"op": "subscribe", "subscriptions": [{"id": 1, "channelId": 99}]}',
        '{"op": "subscribe", "subscriptions": [{"id": -1, "channelId": 0}]}',
        b"",
        b"\x01\x00",
        b"\x01\x09\x00\x00\x00abc",
    ],
)
def test_what_cannot_be_read_is_told_and_the_rest_goes_on(server, mapped, said):
    session, _ = mapped
    with Foxglove(server.rest, session.session_id) as foxglove:
        foxglove.socket.send(said)
        assert foxglove.status()
        foxglove.subscribe("/map")
        foxglove.until("/map")


@pytest.mark.parametrize(
    ("topic", "schema", "message", "encoding"),
    [
        ("/goal_pose", "geometry_msgs/msg/PoseStamped", b"\x00\x01\x00\x00cut", "cdr"),
        ("/goal_pose", "geometry_msgs/msg/PoseStamped", b"{}", "json"),
        ("/initialpose", "geometry_msgs/msg/PoseWithCovarianceStamped", b"", "cdr"),
    ],
)
def test_what_is_published_and_not_taken_is_told(server, mapped, topic, schema, message, encoding):
    session, _ = mapped
    with Foxglove(server.rest, session.session_id) as foxglove:
        foxglove.publish(topic, schema, message, encoding)
        assert foxglove.status()


def test_who_does_not_speak_the_protocol_is_told_what_is_spoken(server, mapped):
    session, _ = mapped
    path = f"/v1/sessions/{session.session_id}/foxglove"
    answer = httpx.get(f"{server.rest_url}{path}")
    assert (answer.status_code, answer.json()["reason"]) == (426, "WEBSOCKET_REQUIRED")
    with pytest.raises(InvalidStatus) as refused:
        Foxglove(server.rest, session.session_id, protocols=["chat"])
    assert refused.value.response.status_code == 400
    with pytest.raises(InvalidStatus) as refused:
        Foxglove(server.rest, "nobody")
    assert refused.value.response.status_code == 404
    with pytest.raises(InvalidStatus) as refused:
        Foxglove(server.rest, session.session_id, origin="https://elsewhere.example")
    assert refused.value.response.status_code == 403


def test_the_key_may_be_in_the_address_since_foxglove_sends_no_header(tmp_path):
    keys, config = tmp_path / "keys.json", tmp_path / "percept.toml"
    create = [binary(), "keys", "create", "--file", keys, "--name", "robot", "--scope", "admin", "--json"]
    key = json.loads(subprocess.run(create, capture_output=True, text=True, check=True).stdout)["key"]
    config.write_text(f'[auth]\nmode = "required"\nkeys_file = "{keys}"\n')
    server = Server(tmp_path / "data", "--config", str(config), zenoh="")
    try:
        with Client(server.grpc, token=key) as client:
            session = client.sessions.create("kept", sensors=[world.LASER])
            session.send_scan("laser", stamp_ns=world.stamp(0), **world.scan(world.drive(1)[0]))
            for query in ("", "?access_token=wrong"):
                with pytest.raises(InvalidStatus) as refused:
                    Foxglove(server.rest, "kept", query=query)
                assert refused.value.response.status_code == 401
            with Foxglove(server.rest, "kept", query=f"?access_token={key}") as foxglove:
                foxglove.subscribe("/tf")
                foxglove.until("/tf")
            # Nowhere else.
            for path in ("kept", "foxglove", "a/b/foxglove"):
                assert httpx.get(f"{server.rest_url}/v1/sessions/{path}?access_token={key}").status_code == 401
    finally:
        server.kill()


def test_a_server_that_stops_says_so_and_a_session_that_goes_ends_nothing_else(tmp_path):
    server = Server(tmp_path / "data", zenoh="")
    try:
        with Client(server.grpc) as client:
            session = client.sessions.create("robot", sensors=[world.LASER])
            session.send_scan("laser", stamp_ns=world.stamp(0), **world.scan(world.drive(1)[0]))
            with Foxglove(server.rest, "robot") as foxglove:
                foxglove.subscribe("/tf")
                foxglove.until("/tf")
                session.delete()
                again = client.sessions.create("robot", sensors=[world.LASER])
                poses = world.drive(3)

                def moved() -> bool:
                    """Frames of the new session of that name come, too."""
                    moved.i += 1
                    again.send_scan("laser", stamp_ns=world.stamp(moved.i), **world.scan(poses[moved.i % 3]))
                    try:
                        came = foxglove.socket.recv(timeout=0.3)
                    except TimeoutError:
                        return False
                    return isinstance(came, bytes) and came[0] == 1

                moved.i = 0
                assert eventually(moved)
                assert server.stop() == 0
                assert eventually(lambda: _is_closed(foxglove))
    finally:
        server.kill()


def _is_closed(foxglove: Foxglove) -> bool:
    try:
        foxglove.next()
    except ConnectionClosed:
        return True
    except TimeoutError:
        return False
    return False
