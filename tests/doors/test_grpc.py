"""What gRPC alone has: health, reflection, streams."""

from __future__ import annotations

import threading

import grpc
import numpy as np
import pytest
from percept import Client, ResourceExhausted

from support import world


@pytest.fixture
def channel(server):
    with grpc.insecure_channel(server.grpc) as channel:
        yield channel


def test_health_is_checked_and_watched(client, channel):
    assert client.health()
    watch = channel.unary_stream("/grpc.health.v1.Health/Watch")(b"", timeout=10)
    assert next(watch) == b"\x08\x01"
    watch.cancel()
    check = channel.unary_unary("/grpc.health.v1.Health/Check")
    one = b"percept.v1.MapsService"
    assert check(b"\x0a" + bytes([len(one)]) + one) == b"\x08\x01"
    with pytest.raises(grpc.RpcError) as error:
        check(b"\x0a\x04none")
    assert error.value.code() == grpc.StatusCode.NOT_FOUND


def test_reflection_lists_the_services(channel):
    info = channel.stream_stream("/grpc.reflection.v1.ServerReflection/ServerReflectionInfo")
    # list_services = 7, an empty string.
    answer = next(info(iter([b"\x3a\x00"]), timeout=10))
    for noun in ("Sessions", "Sensors", "Maps", "Scene", "Navigation", "ToolboxClouds", "Evaluation"):
        assert f"percept.v1.{noun}Service".encode() in answer


def test_a_stream_acknowledges_every_frame_in_order(client):
    session = client.sessions.create(sensors=[world.LASER])
    poses = world.drive(10)
    with session.stream(max_in_flight=4) as stream:
        for i, pose in enumerate(poses):
            # Every third stamp is repeated.
            stream.send_scan("laser", stamp_ns=world.stamp(i - (i % 3 == 2)), **world.scan(pose))
        acks = list(stream.acks())
    assert [a.sequence for a in acks] == list(range(1, 11))
    assert [a.accepted for a in acks] == [i % 3 != 2 for i in range(10)]
    assert {a.rejection.reason for a in acks if not a.accepted} == {"STAMP_REPEATED"}
    counts = [a.durable_count for a in acks]
    assert counts == sorted(counts)
    summary = stream.summary
    assert (summary.sent, summary.accepted, summary.rejected, summary.durable) == (10, 7, 3, 10)
    assert len(session.trajectory()) == 7


def test_frames_of_several_sensors_share_a_stream(client):
    session = client.sessions.create(sensors=[world.LASER, world.CAMERA])
    poses = world.drive(4)
    with session.stream() as stream:
        for i, pose in enumerate(poses):
            stream.send_scan("laser", stamp_ns=world.stamp(i), **world.scan(pose))
            depth = world.depth_image(pose)
            stream.send_depth("camera", stamp_ns=world.stamp(i) + 1000, depth=depth, metres_per_unit=0.001)
    assert stream.summary.accepted == 8
    assert [s.accepted for s in session.sensors.list()] == [4, 4]
    assert [s.gaps for s in session.sensors.list()] == [0, 0]


def test_a_message_over_the_limit_is_refused_in_words(client):
    session = client.sessions.create(sensors=[world.LIDAR])
    points = np.zeros((3 << 20, 3), np.float32)
    with pytest.raises(ResourceExhausted) as error:
        session.send_cloud("lidar", stamp_ns=1, points=points)
    assert error.value.reason == "MESSAGE_TOO_LARGE"
    assert session.pose() is None


def test_two_clients_stream_into_their_sessions_at_once(server):
    def run(results):
        with Client(server.grpc) as client:
            session = client.sessions.create(sensors=[world.LASER])
            with session.stream() as stream:
                for i, pose in enumerate(world.drive(10)):
                    stream.send_scan("laser", stamp_ns=world.stamp(i), **world.scan(pose))
            results.append(session.map.export("trajectory_tum").data)

    results: list[bytes] = []
    threads = [threading.Thread(target=run, args=[results]) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(results) == 2
    assert results[0] == results[1], "the same input gives the same bytes"
