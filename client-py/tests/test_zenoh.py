"""The zenoh side against a peer in this process."""

import json
import queue
import socket

import numpy as np
import pytest

zenoh = pytest.importorskip("zenoh")

import percept.zenoh as pz  # noqa: E402
from percept import DeadlineExceeded, Internal, InvalidArgument, NotFound, Unavailable  # noqa: E402
from percept.v1 import error_pb2, map_pb2, sensor_pb2, session_pb2  # noqa: E402


@pytest.fixture
def peer():
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{s.getsockname()[1]}"
    config = zenoh.Config()
    settings = {"mode": "peer", "listen/endpoints": [endpoint], "scouting/multicast/enabled": False}
    for key, value in (settings | {"scouting/gossip/enabled": False}).items():
        config.insert_json5(key, json.dumps(value))
    with zenoh.open(config) as session:
        yield session, endpoint


def test_frames_arrive_in_order_and_numbered(peer):
    server, endpoint = peer
    arrived = queue.Queue()
    server.declare_subscriber(
        "percept/*/*/frame", lambda s: arrived.put((str(s.key_expr), s.payload.to_bytes()))
    )
    with pz.SensorPublisher(endpoint, session_id="s") as publisher:
        for i in range(20):
            publisher.send_depth("d", stamp_ns=i, depth=np.full((4, 5), i, np.float32))
        got = [arrived.get(timeout=5) for _ in range(20)]
    assert {key for key, _ in got} == {"percept/s/d/frame"}
    messages = [sensor_pb2.SensorMessage.FromString(data) for _, data in got]
    assert [(m.session_id, m.sequence, m.stamp_ns) for m in messages] == [("s", i + 1, i) for i in range(20)]


def test_nobody_there_is_said(peer):
    _, endpoint = peer
    with pytest.raises(Unavailable):
        pz.SensorPublisher("tcp/127.0.0.1:1", session_id="s", timeout_s=0.5)
    with pz.SensorPublisher(endpoint, session_id="s", timeout_s=0.3) as publisher:
        with pytest.raises(Unavailable) as error:
            publisher.send_depth("d", stamp_ns=1, depth=np.ones((1, 1), np.float32))
        assert error.value.reason == "NO_SUBSCRIBER"


@pytest.mark.parametrize("endpoint", ["127.0.0.1:7447", "http://127.0.0.1:7447", "", None, 7447])
def test_an_endpoint_in_another_form_is_told_how_it_is_written(endpoint):
    # The address of gRPC is written without tcp/; zenoh's own error names files of its build.
    with pytest.raises(InvalidArgument, match="write tcp/host:port") as error:
        pz.SensorPublisher(endpoint, session_id="s")
    assert (error.value.reason, error.value.field) == ("ADDRESS_INVALID", "endpoint")


@pytest.mark.parametrize("session_id", ["", "*", "a/b", "x" * 65, None])
def test_a_session_that_cannot_be_is_refused(session_id):
    for kind in (pz.SensorPublisher, pz.MapReader):
        with pytest.raises(InvalidArgument, match="use 1 to 64 characters") as error:
            kind("tcp/127.0.0.1:1", session_id=session_id)
        assert (error.value.reason, error.value.field) == ("ID_INVALID", "session_id")


def test_queries_are_answered_or_raise_what_the_server_says(peer):
    server, endpoint = peer
    where = map_pb2.GridGeometry(resolution_m=0.1, width=2, height=2)
    grid = map_pb2.OccupancyGridChunk(geometry=where, cells=b"\xff\x00\x32\x64")
    error = error_pb2.ErrorInfo(
        reason="SESSION_NOT_FOUND", code="NOT_FOUND", field="session_id", message="no"
    )

    def answer(query):
        if str(query.key_expr) == "percept/s/map/occupancy":
            query.reply(query.key_expr, grid.SerializeToString())
        else:
            query.reply_err(error.SerializeToString())

    server.declare_queryable("percept/**", answer)
    with pz.MapReader(endpoint, session_id="s") as reader:
        assert reader.occupancy().cells.tolist() == [[-1, 0], [50, 100]]
        with pytest.raises(NotFound) as caught:
            reader.graph()
        assert (caught.value.reason, caught.value.field) == ("SESSION_NOT_FOUND", "session_id")


def test_a_question_that_is_not_answered_in_time_is_said_to_be_late(peer):
    server, endpoint = peer
    held = []
    server.declare_queryable("percept/**", held.append)
    with (
        pz.MapReader(endpoint, session_id="s", timeout_s=0.2) as reader,
        pytest.raises(DeadlineExceeded, match="percept/s/map/occupancy"),
    ):
        reader.occupancy()
    assert held


def test_an_answer_of_somebody_elses_is_said_to_be_none(peer):
    server, endpoint = peer

    def answer(query):
        reply = query.reply_err if str(query.key_expr).endswith("pose") else None
        if reply:
            query.reply_err(b"\xff\xff")
        else:
            query.reply(query.key_expr, b"\xff\xff")

    server.declare_queryable("percept/**", answer)
    with pz.MapReader(endpoint, session_id="s") as reader:
        for ask in (reader.pose, reader.occupancy):
            with pytest.raises(Internal) as error:
                ask()
            assert error.value.reason == "REPLY_INVALID"


def test_a_publisher_leaves_the_network_even_if_its_last_question_fails(peer, monkeypatch):
    server, endpoint = peer
    server.declare_subscriber("percept/*/*/frame", lambda _: None)
    publisher = pz.SensorPublisher(endpoint, session_id="s")
    publisher.send_depth("d", stamp_ns=1, depth=np.ones((1, 1), np.float32))
    # A key that no question can be asked by.
    monkeypatch.setattr(publisher, "_key", lambda rest: "#")
    with pytest.raises(zenoh.ZError):
        publisher.close()
    assert publisher._zenoh.is_closed()


def test_poses_are_received_as_they_are_published(peer):
    server, endpoint = peer
    with pz.MapReader(endpoint, session_id="s") as reader, reader.poses() as poses:
        publisher = server.declare_publisher("percept/s/pose")
        while not publisher.matching_status.matching:
            pass
        for i in range(3):
            publisher.put(session_pb2.PoseEstimate(stamp_ns=i, state=2).SerializeToString())
        received = [poses.receive(timeout_s=5) for _ in range(3)]
    assert [p.stamp_ns for p in received] == [0, 1, 2]
    assert received[0].state == "tracking"


def test_a_peer_with_a_certificate_and_a_password_is_let_in_and_no_other(tmp_path):
    trustme = pytest.importorskip("trustme")
    authority = trustme.CA()
    authority.cert_pem.write_to_path(tmp_path / "ca.pem")
    for name, identity in (("server", "127.0.0.1"), ("robot", "robot")):
        issued = authority.issue_cert(identity)
        issued.private_key_pem.write_to_path(tmp_path / f"{name}.key")
        issued.cert_chain_pems[0].write_to_path(tmp_path / f"{name}.pem")
    (tmp_path / "users").write_text("robot:secret\n")
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        endpoint = f"tls/127.0.0.1:{s.getsockname()[1]}"
    config = zenoh.Config()
    settings = {"mode": "peer", "listen/endpoints": [endpoint], "scouting/multicast/enabled": False}
    settings |= {
        "scouting/gossip/enabled": False,
        "transport/link/tls/root_ca_certificate": str(tmp_path / "ca.pem"),
        "transport/link/tls/listen_certificate": str(tmp_path / "server.pem"),
        "transport/link/tls/listen_private_key": str(tmp_path / "server.key"),
        "transport/link/tls/enable_mtls": True,
        "transport/auth/usrpwd/user": "server",
        "transport/auth/usrpwd/password": "other",
        "transport/auth/usrpwd/dictionary_file": str(tmp_path / "users"),
    }
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    robot = {
        "user": "robot",
        "password": "secret",
        "ca_file": tmp_path / "ca.pem",
        "cert_file": tmp_path / "robot.pem",
        "key_file": tmp_path / "robot.key",
    }
    assert "secret" not in repr(pz.Credentials(**robot))
    with zenoh.open(config):
        with pz.MapReader(endpoint, session_id="s", credentials=pz.Credentials(**robot)):
            pass
        for missing in ({"password": "wrong"}, {"cert_file": None, "key_file": None}, {"ca_file": None}):
            with pytest.raises(Unavailable):
                others = pz.Credentials(**(robot | missing))
                pz.MapReader(endpoint, session_id="s", timeout_s=1.0, credentials=others)


def test_credentials_that_contradict_themselves_are_refused(tmp_path):
    (tmp_path / "ca.pem").write_text("")
    for options, field in (
        ({"user": "a"}, "password"),
        ({"cert_file": "a"}, "key_file"),
        ({"ca_file": tmp_path / "ca.pem"}, "ca_file"),
        ({"ca_file": tmp_path / "none.pem"}, "ca_file"),
    ):
        with pytest.raises(InvalidArgument) as error:
            pz.MapReader("tcp/127.0.0.1:1", session_id="s", credentials=pz.Credentials(**options))
        assert error.value.field == field
