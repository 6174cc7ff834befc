"""Robots stream to two servers that share a directory, and one of them goes: their streams go on at the
other, nothing that was acknowledged is lost, and no frame is there twice.
"""

from __future__ import annotations

import signal
import threading
from concurrent.futures import ThreadPoolExecutor

import grpc
import pytest
from percept import Client
from percept.v1 import sensors_service_pb2

from support import robots, world
from support.server import Server

#: Frames before the server goes, and after it.
BEFORE, AFTER = 40, 40


@pytest.fixture
def pair(tmp_path, monkeypatch):
    monkeypatch.setenv("PERCEPT_STORAGE_SHARED", "true")
    servers = [Server(tmp_path / "data", log=tmp_path / f"{name}.log") for name in ("one", "two")]
    yield servers
    for server in servers:
        server.process.send_signal(signal.SIGCONT)
        server.kill()


class Robot:
    """Streams scans; it knows both servers, and its session begins at the first."""

    def __init__(self, name: str, servers: list[Server]) -> None:
        self.name, self.frames = name, 0
        self.client = Client([server.grpc for server in servers])
        self.session = self.client.sessions.create(name, sensors=[world.LASER])
        self.is_under_way = threading.Event()

    def drive(self, gone: threading.Event):
        """Streams until some time after the server has gone."""
        last = None
        with self.session.stream(resume_timeout_s=100) as stream:
            while last is None or self.frames < last:
                stream.send_scan("laser", stamp_ns=world.stamp(self.frames), **robots.scan(self.frames % 100))
                self.frames += 1
                if self.frames == BEFORE:
                    self.is_under_way.set()
                if last is None and gone.is_set():
                    last = self.frames + AFTER
        self.client.close()
        return stream.summary


def kill(server: Server) -> None:
    server.kill()


def stop(server: Server) -> None:
    server.process.send_signal(signal.SIGTERM)


def pause(server: Server) -> None:
    server.process.send_signal(signal.SIGSTOP)


@pytest.mark.parametrize("goes", [kill, stop, pause])
def test_robots_of_a_server_that_goes_stream_on_at_the_other(pair, goes):
    one, two = pair
    fleet = [Robot(f"robot-{k}", [one, two] if k % 2 == 0 else [two, one]) for k in range(4)]
    gone = threading.Event()
    with ThreadPoolExecutor(len(fleet)) as pool:
        drives = [pool.submit(robot.drive, gone) for robot in fleet]
        try:
            for robot in fleet:
                assert robot.is_under_way.wait(30)
            goes(one)
        finally:
            gone.set()
        summaries = [drive.result(timeout=110) for drive in drives]
    if goes is pause:
        one.process.send_signal(signal.SIGCONT)
    with Client(two.grpc) as client:
        for robot, summary in zip(fleet, summaries, strict=True):
            assert (summary.rejected, summary.sent) == (0, robot.frames), summary.rejections
            assert summary.accepted == summary.durable == robot.frames
            session = client.session(robot.name)
            stamps = [world.stamp(i) for i in range(robot.frames)]
            assert session.trajectory().stamps_ns.tolist() == stamps


def test_a_stream_that_turned_a_frame_away_takes_no_later_one(pair):
    """Else the frame comes back too late: its stamp is older than what was taken meanwhile."""
    one, two = pair
    with Client(one.grpc) as client:
        robots.mapped(client, "robot")
    outcomes, acknowledged = [], threading.Semaphore(1)

    def frames():
        for i in range(10, 2000):
            acknowledged.acquire()
            yield sensors_service_pb2.StreamFramesRequest(message=robots.scan_message("robot", i))

    with grpc.insecure_channel(two.grpc) as channel:
        send = channel.stream_stream(
            "/percept.v1.SensorsService/StreamFrames",
            request_serializer=sensors_service_pb2.StreamFramesRequest.SerializeToString,
            response_deserializer=sensors_service_pb2.StreamFramesResponse.FromString,
        )
        answers = send(frames(), timeout=30)
        with pytest.raises(grpc.RpcError) as ended:
            for answer in answers:
                outcomes.append(answer.ack.rejection.reason)
                if outcomes == ["SESSION_ELSEWHERE"]:
                    one.kill()
                if outcomes[-1] == "":
                    break
                acknowledged.release()
    assert ended.value.code() is grpc.StatusCode.UNAVAILABLE
    assert set(outcomes) == {"SESSION_ELSEWHERE"}
