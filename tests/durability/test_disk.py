"""Disks that fill, and signals: refused precisely, told to whoever asks, nothing acknowledged lost."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import threading
import time

import grpc
import httpx
import numpy as np
import pytest
from percept import Client, GridMap, PerceptError, ResourceExhausted

from support import raw, robots, world
from support.measure import disk_bytes
from support.server import Server, eventually

#: Of the disk that is filled.
DISK_MB = 48


@pytest.fixture
def client(own_server):
    with Client(own_server.grpc) as client:
        yield client


def test_deleting_gives_the_space_back_while_the_server_runs(own_server, client):
    empty = disk_bytes(own_server.data_dir)
    for k in range(3):
        session = client.sessions.create(f"r{k}", sensors=[world.LIDAR])
        robots.send_sweeps(session, 0, 60, phase=7 * k, stride=robots.HEAVY_STRIDE)
    full = disk_bytes(own_server.data_dir)
    for k in range(3):
        client.session(f"r{k}").delete()
    # What remains is the storage's own log, which goes in its own time.
    least = empty + (full - empty) * 0.35
    given_back = eventually(lambda: disk_bytes(own_server.data_dir) < least)
    kib = [size >> 10 for size in (empty, full, disk_bytes(own_server.data_dir))]
    assert given_back, f"{kib[0]} KiB when empty, {kib[1]} before, {kib[2]} after"


def test_what_others_still_use_is_not_deleted_with_a_session(own_server, client):
    """Two sessions saw the same, byte by byte; one goes."""
    kept, gone = (robots.mapped(client, name, frames=20) for name in ("kept", "gone"))
    gone.delete()
    before = kept.map.occupancy().cells
    own_server.kill()
    own_server.start()
    with Client(own_server.grpc) as client:
        again = client.session("kept")
        assert len(again.trajectory()) == 20
        assert again.map.occupancy().cells.shape == before.shape


@pytest.fixture
def small_disk(tmp_path):
    """A file system of its own that may be filled."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", f"size={DISK_MB}m", "percept-test", str(folder)]
    try:
        done = subprocess.run(mount, capture_output=True, check=False)
    except FileNotFoundError:
        pytest.skip("no mount command here")
    if done.returncode != 0:
        pytest.skip("mounting is not permitted here")
    yield folder
    subprocess.run(["umount", "-l", str(folder)], check=True)


class Ballast:
    """Takes all space that is left."""

    def __init__(self, folder) -> None:
        self._path = folder / "ballast"

    def fill(self) -> None:
        file = os.open(self._path, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        with contextlib.suppress(OSError):
            while True:
                os.write(file, bytes(1 << 12))
        os.close(file)

    def fill_but(self, num_bytes) -> None:
        with open(self._path, "wb") as file:
            os.posix_fallocate(file.fileno(), 0, free_bytes(self._path.parent) - num_bytes)

    def free(self) -> None:
        self._path.unlink()


@pytest.fixture
def disk_server(small_disk):
    server = Server(small_disk / "data", log=small_disk.with_name("disk.log"))
    yield server
    server.kill()


def send(session, index):
    """One frame that leaves a large scan; its refusal, or None."""
    try:
        session.send_cloud("lidar", stamp_ns=world.stamp(index), points=robots.sweep(index))
    except PerceptError as error:
        return error
    return None


def create(client, name):
    """Creates a session; the refusal, or None."""
    try:
        client.sessions.create(name)
    except PerceptError as error:
        return error
    return None


def send_until_refused(session, first, limit=60):
    """Sends frames until the disk refuses one; answers with the indices that were acknowledged, the first
    that was refused, and its refusal. What was taken in while the disk filled may say that it is undecided.
    """
    taken = []
    for i in range(first, first + limit):
        error = send(session, i)
        if error is None:
            taken.append(i)
        elif error.reason != "NOT_YET_DURABLE":
            return taken, i, error
    raise AssertionError("the disk did not fill")


def readiness(server):
    with httpx.Client(base_url=server.rest_url, timeout=5) as http:
        answer = http.get("/readyz")
        return answer.status_code, answer.text


def health(server):
    """What grpc.health.v1 says: 1 is SERVING, 2 NOT_SERVING."""
    with grpc.insecure_channel(server.grpc) as channel:
        answer = channel.unary_unary("/grpc.health.v1.Health/Check")(b"", timeout=5)
    return {b"\x08\x01": "SERVING", b"\x08\x02": "NOT_SERVING"}.get(answer, answer)


def test_a_full_disk_is_refused_told_and_left_behind(small_disk, disk_server):
    ballast = Ballast(small_disk)
    with Client(disk_server.grpc, timeout_s=60, retries=0) as client:
        session = client.sessions.create("robot", sensors=[world.LIDAR])
        assert send(session, 0) is None
        assert (readiness(disk_server)[0], health(disk_server)) == (200, "SERVING")
        ballast.fill()
        taken, refused, error = send_until_refused(session, 1)
        assert isinstance(error, ResourceExhausted)
        assert error.reason == "STORAGE_FULL"
        assert eventually(lambda: readiness(disk_server)[0] == 503), "it says that it is ready while the disk is full"
        assert "full" in readiness(disk_server)[1].lower(), "it does not say why"
        assert eventually(lambda: health(disk_server) == "NOT_SERVING")
        with httpx.Client(base_url=disk_server.rest_url) as http:
            assert http.get("/livez").status_code == 200
        assert session.pose() is not None, "queries go on"
        ballast.free()
        last = refused + 100
        assert eventually(lambda: send(session, last) is None)
        assert eventually(lambda: (readiness(disk_server)[0], health(disk_server)) == (200, "SERVING"))
    disk_server.kill()
    disk_server.start()
    with Client(disk_server.grpc) as client:
        stamps = set(client.session("robot").trajectory().stamps_ns.tolist())
    acknowledged = {world.stamp(i) for i in [0, *taken, last]}
    assert acknowledged <= stamps, "acknowledged, and lost"


def test_an_import_that_the_disk_does_not_take_says_so_and_leaves_the_session_empty(small_disk, disk_server):
    ballast = Ballast(small_disk)
    cells = np.zeros((200, 400), np.int8)
    cells[[0, -1], :] = cells[:, [0, -1]] = 100
    hall = GridMap(cells=cells, resolution_m=0.05, origin=(0.0, 0.0))
    with Client(disk_server.grpc, timeout_s=60, retries=0) as client:
        session = client.sessions.create("robot", sensors=[world.LASER])
        assert session.map.summary().num_keyframes == 0
        ballast.fill()
        with pytest.raises(ResourceExhausted) as error:
            session.map.import_map(hall)
        assert error.value.reason == "STORAGE_FULL"
        ballast.free()

        def summary():
            with contextlib.suppress(PerceptError):
                return session.map.summary()

        assert eventually(lambda: summary() is not None)
        assert (summary().num_keyframes, summary().num_points) == (0, 0)

        def imports():
            # The storage notices a moment later that there is room.
            with contextlib.suppress(ResourceExhausted):
                return session.map.import_map(hall).num_keyframes > 5

        assert eventually(imports)
        imported = session.map.summary().num_keyframes
    disk_server.kill()
    disk_server.start()
    with Client(disk_server.grpc) as client:
        assert client.session("robot").map.summary().num_keyframes == imported


def test_a_stream_that_resumes_loses_no_frame_to_a_full_disk(small_disk, disk_server):
    """Frames that were accepted, and only in memory when it filled, were told as refused and dropped."""
    ballast = Ballast(small_disk)
    with Client(disk_server.grpc, timeout_s=60) as client:
        session = client.sessions.create("robot", sensors=[world.LIDAR])
        robots.send_sweeps(session, 0, 5)
        with session.stream(max_in_flight=1) as stream:
            ballast.fill()
            for i in range(5, 40):
                stream.send_cloud("lidar", stamp_ns=world.stamp(i), points=robots.sweep(i))
            assert eventually(lambda: readiness(disk_server)[0] == 503)
            ballast.free()
        summary = stream.summary
    assert (summary.sent, summary.accepted, summary.rejected, summary.durable) == (35, 35, 0, 35)
    disk_server.kill()
    disk_server.start()
    with Client(disk_server.grpc) as client:
        stamps = client.session("robot").trajectory().stamps_ns.tolist()
    assert stamps == [world.stamp(i) for i in range(40)]


def test_a_frame_that_was_answered_with_storage_full_is_not_stored_later(small_disk, disk_server):
    ballast = Ballast(small_disk)
    with Client(disk_server.grpc, timeout_s=60, retries=0) as client:
        session = client.sessions.create("robot", sensors=[world.LIDAR])
        assert send(session, 0) is None
        ballast.fill()
        _, refused, _ = send_until_refused(session, 1)
        errors = [send(session, i) for i in range(refused + 1, refused + 10)]
        assert all(e and e.reason == "STORAGE_FULL" for e in errors), errors
        ballast.free()
        last = refused + 100
        assert eventually(lambda: send(session, last) is None)
        live = session.trajectory().stamps_ns.tolist()
    disk_server.kill()
    disk_server.start()
    with Client(disk_server.grpc) as client:
        stored = client.session("robot").trajectory().stamps_ns.tolist()
    assert stored[-1] == world.stamp(last)
    late = [i for i in range(refused, refused + 10) if world.stamp(i) in stored]
    assert not late, f"frames {late} of {refused} to {refused + 9} were refused, and are there"
    assert stored == live


def test_creating_and_deleting_on_a_full_disk_is_refused_or_done_for_good(small_disk, disk_server):
    """Deleting is what an operator does when the disk is full."""
    ballast = Ballast(small_disk)
    with Client(disk_server.grpc, timeout_s=60, retries=0) as client:
        for k in range(4):
            session = client.sessions.create(f"old{k}", sensors=[world.LIDAR])
            robots.send_sweeps(session, 0, 20, phase=30 * k)
        ballast.fill()
        made, refused = [], []
        for k in range(400):
            error = create(client, f"new{k:03}")
            (refused if error else made).append(f"new{k:03}")
            assert error is None or error.reason == "STORAGE_FULL", error
            if len(refused) == 3:
                break
        assert refused, "the disk did not fill"
        kept = [f"old{k}" for k in range(4)]
        for name in ("old0", "old1"):
            with contextlib.suppress(ResourceExhausted):
                client.session(name).delete()
                kept.remove(name)
        left = [s.session_id for s in client.sessions.list()]
        assert set(made) <= set(left)
        assert not set(left) & {f"old{k}" for k in range(4) if f"old{k}" not in kept}
        ballast.free()
    disk_server.kill()
    disk_server.start()
    with Client(disk_server.grpc) as client:
        after = {s.session_id for s in client.sessions.list()}
        assert set(made) <= after, "acknowledged, and lost"
        assert not after & set(refused), "refused, and there"
        assert set(kept) <= after
        assert not {"old0", "old1"} & after - set(kept), "deleted, and back"


def test_sleeping_sessions_on_a_full_disk_say_so_and_hold_nobody_up(small_disk, disk_server):
    """Waking writes; a store that takes nothing kept each that tried for ever, and the stop with them."""
    ballast = Ballast(small_disk)
    with Client(disk_server.grpc, timeout_s=60, retries=0) as client:
        for k in range(8):
            robots.mapped(client, f"s{k}", frames=10)
    assert disk_server.stop() == 0
    disk_server.start()
    ballast.fill()
    with Client(disk_server.grpc, timeout_s=20, retries=0) as client:
        for k in range(8):
            with pytest.raises(PerceptError) as refused:
                client.session(f"s{k}").map.summary()
            assert refused.value.reason in ("STORAGE_FULL", "STORAGE_FAULT"), refused.value
        ballast.free()
        assert eventually(lambda: len(client.session("s7").trajectory()) == 10)
        ballast.fill()
        with pytest.raises(PerceptError):
            client.session("s0").map.summary()
    assert disk_server.stop() == 0


def test_a_stop_on_a_full_disk_says_that_frames_were_given_up(small_disk, disk_server):
    ballast = Ballast(small_disk)
    with Client(disk_server.grpc, timeout_s=60, retries=0) as client:
        session = client.sessions.create("robot", sensors=[world.LIDAR])
        robots.send_sweeps(session, 0, 5)
        # One that resumes would wait for room.
        stream = session.stream(max_in_flight=32, resume=False)
        ballast.fill()
        with contextlib.suppress(PerceptError):
            for i in range(5, 40):
                stream.send_cloud("lidar", stamp_ns=world.stamp(i), points=robots.sweep(i))
            assert eventually(lambda: stream.summary.rejected > 0)
        summary = stream.summary
        accepted, durable = summary.accepted, summary.durable
        assert durable < accepted, "all that was accepted was stored; this shows nothing"
        code = disk_server.stop()
        stream.cancel()
    assert code != 0, "frames that were accepted are gone, and the exit code says that all is well"
    ballast.free()
    disk_server.start()
    with Client(disk_server.grpc) as client:
        kept = client.session("robot").trajectory().stamps_ns.tolist()
    assert len(kept) >= 5 + min(durable, summary.accepted)


def test_a_hangup_does_not_end_the_server(own_server, client):
    session = client.sessions.create("robot", sensors=[world.LASER])
    own_server.process.send_signal(signal.SIGHUP)
    for i in range(20):
        session.send_scan("laser", stamp_ns=world.stamp(i), **robots.scan(i))
    assert own_server.process.poll() is None


def test_requests_that_never_end_do_not_hold_up_a_stop(own_server):
    """Half a head, half a body, a stream that says nothing more: a stop waits for work, not for these."""
    half_head = b"POST /v1/sessions HTTP/1.1\r\nhost: 127.0.0.1\r\n"
    half_body = raw.request_head("POST", "/v1/sessions", content_type="application/json", content_length=500)
    open_ = []
    for data in (half_head, half_body + b'{"session_id": "ha', b""):
        s = raw.connect(own_server.rest)
        s.sendall(data)
        open_.append(s)
    for rpc in ("SensorsService/StreamFrames", "SensorsService/SendFrame"):
        h2 = raw.Http2(own_server.grpc)
        stream = h2.open_stream(rpc)
        h2.send(raw.frame(raw.DATA, 0, stream, raw.message_prefix(1000) + bytes(100)))
        open_.append(h2.socket)
    # Whatever the server has to do to notice them it has done when this is answered.
    with Client(own_server.grpc) as client:
        client.sessions.create("robot")
    own_server.process.send_signal(signal.SIGTERM)
    ended = eventually(lambda: own_server.process.poll() is not None, seconds=8)
    assert ended, "it waits for requests that never end"
    assert own_server.process.returncode == 0
    for s in open_:
        s.close()


def test_a_second_signal_is_not_needed_and_does_no_harm(own_server, client):
    robots.mapped(client, "robot", frames=5)
    os.kill(own_server.process.pid, signal.SIGTERM)
    os.kill(own_server.process.pid, signal.SIGTERM)
    assert own_server.stop() == 0
    own_server.start()
    with Client(own_server.grpc) as client:
        assert len(client.session("robot").trajectory()) == 5


class Feeder(threading.Thread):
    """Streams until the session refuses, and keeps what it said."""

    def __init__(self, session, **options) -> None:
        super().__init__(daemon=True)
        self._session, self._options = session, options
        self.refusal = None

    def run(self) -> None:
        try:
            with self._session.stream(**self._options) as stream:
                for i in range(100_000):
                    stream.send_cloud("lidar", stamp_ns=world.stamp(i), points=robots.sweep(i))
        except PerceptError as error:
            self.refusal = error


def free_bytes(folder):
    disk = os.statvfs(folder)
    return disk.f_bavail * disk.f_frsize


def test_what_robots_fill_a_disk_with_can_be_deleted_again(small_disk, disk_server):
    """Frames alone fill it, with no other writer; some room is kept for who deletes, and for a start."""
    with Client(disk_server.grpc, timeout_s=60, retries=0) as client:
        session = client.sessions.create("robot", sensors=[world.LIDAR])
        feeder = Feeder(session, resume_timeout_s=3600)
        Ballast(small_disk).fill_but(6 << 20)
        feeder.start()
        assert eventually(lambda: readiness(disk_server)[0] == 503, seconds=60), "it says that it is ready"
        assert eventually(lambda: health(disk_server) == "NOT_SERVING")
        assert "STORAGE_FULL" in small_disk.with_name("disk.log").read_text(), "its log does not say so"
        assert free_bytes(small_disk) > 1 << 20
        assert session.pose() is not None, "queries go on"
    disk_server.kill()
    disk_server.start()
    with Client(disk_server.grpc, timeout_s=60) as client:
        assert len(client.session("robot").trajectory()) > 0
        client.session("robot").delete()
        again = client.sessions.create("again", sensors=[world.LIDAR])
        assert eventually(lambda: send(again, 0) is None)
        assert eventually(lambda: readiness(disk_server)[0] == 200)


def test_a_list_after_a_crash_tells_what_sessions_hold(own_server, client):
    session = client.sessions.create("robot", sensors=[world.LIDAR])
    robots.send_sweeps(session, 0, 12)
    before = session.info()
    assert before.num_keyframes > 0
    time.sleep(11)
    own_server.kill()
    own_server.start()
    with Client(own_server.grpc) as again:
        (found,) = again.sessions.list()
        assert (found.num_keyframes, found.last_stamp_ns) == (before.num_keyframes, before.last_stamp_ns)
