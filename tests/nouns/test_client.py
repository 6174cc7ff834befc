"""What the Python client does by itself when a server goes away, and what its options change."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import threading

import pytest
from percept import AsyncClient, Client, InvalidArgument, StreamBroken, Unavailable

from support import world
from support.server import Server, free_port

FRAMES = 60


@pytest.fixture
def fixed_server(tmp_path):
    """A server that comes back at the same address."""
    server = Server(tmp_path / "data", grpc=f"127.0.0.1:{free_port()}")
    yield server
    server.kill()


@pytest.fixture(scope="module")
def scans():
    return [world.scan(pose) for pose in world.drive(FRAMES)]


def restarted(server, end):
    """Ends the server and starts it again, beside the caller."""

    def work():
        end(server)
        server.start()

    thread = threading.Thread(target=work)
    thread.start()
    return thread


class Cable:
    """A way to a server that can be cut."""

    def __init__(self, address):
        host, _, port = address.rpartition(":")
        self._server = (host, int(port))
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.address = f"127.0.0.1:{self._listener.getsockname()[1]}"
        self._ends = []
        threading.Thread(target=self._accept, daemon=True).start()

    def cut(self):
        while self._ends:
            with contextlib.suppress(OSError):
                self._ends.pop().shutdown(socket.SHUT_RDWR)

    def close(self):
        self._listener.close()
        self.cut()

    def _accept(self):
        with contextlib.suppress(OSError):
            while True:
                near, _ = self._listener.accept()
                far = socket.create_connection(self._server)
                self._ends += [near, far]
                for pair in ((near, far), (far, near)):
                    threading.Thread(target=self._carry, args=pair, daemon=True).start()

    @staticmethod
    def _carry(source, target):
        with contextlib.suppress(OSError):
            while data := source.recv(65536):
                target.sendall(data)
        with contextlib.suppress(OSError):
            target.shutdown(socket.SHUT_RDWR)


def assert_every_frame_arrived_once(session, summary):
    assert (summary.sent, summary.accepted, summary.rejected) == (FRAMES, FRAMES, 0)
    assert summary.durable == FRAMES
    assert session.trajectory().stamps_ns.tolist() == [world.stamp(i) for i in range(FRAMES)]
    sensor = session.sensors.list()[0]
    assert sensor.last_stamp_ns == world.stamp(FRAMES - 1)


@pytest.mark.parametrize("end", [Server.kill, Server.stop])
@pytest.mark.parametrize("after", [1, 23, FRAMES - 1])
def test_a_stream_goes_on_by_itself_when_the_server_is_back(fixed_server, scans, end, after):
    with Client(fixed_server.grpc) as client:
        session = client.sessions.create("robot", sensors=[world.LASER])
        with session.stream(max_in_flight=8) as stream:
            for i, scan in enumerate(scans):
                if i == after:
                    restarting = restarted(fixed_server, end)
                stream.send_scan("laser", stamp_ns=world.stamp(i), **scan)
            acks = list(stream.acks())
        restarting.join()
        assert [a.stamp_ns for a in acks] == [world.stamp(i) for i in range(FRAMES)]
        assert_every_frame_arrived_once(session, stream.summary)


def test_a_stream_survives_one_kill_after_the_other(fixed_server, scans):
    with Client(fixed_server.grpc) as client:
        session = client.sessions.create("robot", sensors=[world.LASER])
        with session.stream(max_in_flight=4) as stream:
            for i, scan in enumerate(scans):
                if i % 15 == 7:
                    fixed_server.kill()
                    fixed_server.start()
                stream.send_scan("laser", stamp_ns=world.stamp(i), **scan)
        assert_every_frame_arrived_once(session, stream.summary)


@pytest.mark.parametrize("max_in_flight", [1, 16])
def test_a_cut_cable_loses_nothing_and_doubles_nothing(server, client, name, scans, max_in_flight):
    cable = Cable(server.grpc)
    session = client.sessions.create(name, sensors=[world.LASER])
    with Client(cable.address) as distant:
        with distant.session(name).stream(max_in_flight=max_in_flight) as stream:
            for i, scan in enumerate(scans):
                if i % 7 == 5:
                    cable.cut()
                stream.send_scan("laser", stamp_ns=world.stamp(i), **scan)
        cable.close()
    assert_every_frame_arrived_once(session, stream.summary)


def test_an_asyncio_stream_goes_on_by_itself_too(fixed_server, scans):
    async def scenario():
        async with AsyncClient(fixed_server.grpc) as client:
            session = await client.sessions.create("robot", sensors=[world.LASER])
            async with session.stream(max_in_flight=8) as stream:
                for i, scan in enumerate(scans):
                    if i == 23:
                        restarting = restarted(fixed_server, Server.kill)
                    await stream.send_scan("laser", stamp_ns=world.stamp(i), **scan)
            restarting.join()
            return stream.summary

    summary = asyncio.run(scenario())
    with Client(fixed_server.grpc) as client:
        assert_every_frame_arrived_once(client.session("robot"), summary)


def test_frames_that_find_no_room_in_the_buffer_wait_until_others_are_durable(client, name, scans):
    session = client.sessions.create(name, sensors=[world.LASER])
    with session.stream(resume_buffer_bytes=6_000) as stream:
        for i, scan in enumerate(scans):
            stream.send_scan("laser", stamp_ns=world.stamp(i), **scan)
    assert_every_frame_arrived_once(session, stream.summary)


def test_a_stream_gives_up_and_says_how_many_frames_are_durable(own_server, scans):
    with Client(own_server.grpc) as client:
        session = client.sessions.create("robot", sensors=[world.LASER])
        stream = session.stream(resume_timeout_s=0.5)
        for i, scan in enumerate(scans[:10]):
            stream.send_scan("laser", stamp_ns=world.stamp(i), **scan)
        list(stream.acks())
        own_server.kill()
        with pytest.raises(StreamBroken) as error:
            for i, scan in enumerate(scans[10:], 10):
                stream.send_scan("laser", stamp_ns=world.stamp(i), **scan)
            stream.close()
        stream.cancel()
    durable = error.value.durable
    assert f"{durable} of {error.value.sent} frames are durable" in error.value.message
    assert stream.summary.durable == durable
    own_server.start()
    with Client(own_server.grpc) as client:
        assert len(client.session("robot").trajectory()) >= durable


def test_a_stream_that_shall_not_resume_ends_with_what_broke_it(fixed_server, scans):
    with Client(fixed_server.grpc) as client:
        session = client.sessions.create("robot", sensors=[world.LASER])
        with pytest.raises(Unavailable) as error, session.stream(resume=False) as stream:
            for i, scan in enumerate(scans):
                if i == 5:
                    fixed_server.kill()
                    fixed_server.start()
                stream.send_scan("laser", stamp_ns=world.stamp(i), **scan)
    assert not isinstance(error.value, StreamBroken)


def test_a_stamp_that_was_sent_twice_is_still_refused_after_a_resume(fixed_server, scans):
    with Client(fixed_server.grpc) as client:
        session = client.sessions.create("robot", sensors=[world.LASER])
        with session.stream() as stream:
            for i, scan in enumerate(scans[:10]):
                stream.send_scan("laser", stamp_ns=world.stamp(i), **scan)
            fixed_server.kill()
            fixed_server.start()
            stream.send_scan("laser", stamp_ns=world.stamp(3), **scans[3])
            stream.send_scan("laser", stamp_ns=world.stamp(10), **scans[10])
        summary = stream.summary
    assert (summary.sent, summary.accepted, summary.durable) == (12, 11, 12)
    assert [r.stamp_ns for r in summary.rejections] == [world.stamp(3)]
    assert summary.rejections[0].rejection.reason == "STAMP_NOT_INCREASING"


def test_a_call_is_tried_again_until_the_server_is_back(fixed_server):
    with Client(fixed_server.grpc, retries=30) as client:
        session = client.sessions.create("robot", sensors=[world.LASER])
        fixed_server.kill()
        restarting = threading.Thread(target=fixed_server.start)
        restarting.start()
        assert session.info().session_id == "robot"
        restarting.join()
        fixed_server.kill()
        with pytest.raises(Unavailable):
            session.with_options(timeout_s=0.5).info()


def test_a_token_travels_readably_only_on_this_machine(server):
    with Client(server.grpc, token="secret") as client:
        assert client.health()
    with pytest.raises(InvalidArgument) as error:
        Client("percept.example:50051", token="secret")
    assert (error.value.reason, error.value.field) == ("TOKEN_UNPROTECTED", "address")
    assert "secret" not in str(error.value)
