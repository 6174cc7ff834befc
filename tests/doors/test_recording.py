"""What sessions are sent, recorded: files that others read, and that give the same way when they are replayed."""

from __future__ import annotations

import json
import os
import pathlib
import subprocess

import numpy as np
import pytest
from percept import Client
from rosbags.highlevel import AnyReader

from support import world
from support.server import Server, binary, eventually


def only(folder: pathlib.Path, session_id: str) -> pathlib.Path:
    """The folder of a session's only recording."""
    (found,) = (folder / "default" / session_id).iterdir()
    return found


def replayed(recording: pathlib.Path, out: pathlib.Path) -> np.ndarray:
    """(N, 8): stamps in seconds and poses as TUM has them."""
    command = [binary(), "replay", recording, "--out", out, "--json"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["refused"] == 0
    return np.loadtxt(out / "trajectory.tum")


@pytest.fixture
def start(tmp_path):
    servers = []

    def started(*arguments: str) -> tuple[Server, Client]:
        servers.append(Server(tmp_path / "data", *arguments))
        return servers[-1], Client(servers[-1].grpc)

    yield started
    for server in servers:
        server.kill()


def send_all_kinds(session, last: int) -> None:
    """A drive with a depth camera that leads, and wheels."""
    poses = world.drive(last)
    with session.stream() as stream:
        for i, pose in enumerate(poses):
            stream.send_odometry("wheels", stamp_ns=world.stamp(i) - 1000, t_odom_base=pose)
            stream.send_depth("camera", stamp_ns=world.stamp(i), depth=world.depth_image(pose), metres_per_unit=0.001)
    assert stream.summary.rejected == 0, stream.summary.rejections


def test_a_session_is_recorded_as_others_read_it_and_replays_to_the_same_way(start, tmp_path):
    folder = tmp_path / "recorded"
    server, client = start("--record", str(folder))
    session = client.sessions.create(sensors=[world.CAMERA, world.WHEELS])
    send_all_kinds(session, 20)
    went = session.trajectory()
    assert server.stop() == 0
    recording = only(folder, session.session_id)
    with AnyReader(sorted(recording.glob("*.mcap"))) as reader:
        counts = {c.topic: c.msgcount for c in reader.connections}
        assert counts["/camera/depth/image_raw"] == counts["/wheels/odometry"] == 20
        depth = [c for c in reader.connections if c.topic == "/camera/depth/image_raw"]
        _, _, raw = next(reader.messages(depth))
        image = reader.deserialize(raw, depth[0].msgtype)
        metres = np.frombuffer(image.data, np.float32).reshape(image.height, image.width)
        assert np.allclose(metres, world.depth_image(world.drive(1)[0]) / 1000, atol=1e-6)
    again = replayed(recording, tmp_path / "again")
    assert len(again) == len(went) == 20
    assert np.abs(again[:, 1:4] - went.positions).max() < 1e-6


def test_sleep_ends_a_recording_and_waking_begins_another(start, tmp_path):
    folder = tmp_path / "recorded"
    config = tmp_path / "percept.toml"
    config.write_text(f'[recording]\ndir = "{folder}"\nsessions = "robot-*"\n[limits]\nsleep_after_s = 1\n')
    server, client = start("--config", str(config))
    session = client.sessions.create(session_id="robot-7", sensors=[world.LASER])
    client.sessions.create(session_id="other", sensors=[world.LASER])
    poses = world.drive(8)

    def send(session_id: str, numbers: range) -> None:
        for i in numbers:
            client.session(session_id).send_scan("laser", stamp_ns=world.stamp(i), **world.scan(poses[i]))

    send("other", range(2))
    send("robot-7", range(4))
    assert eventually(lambda: client.session("robot-7").info().state == "asleep", seconds=30)
    send("robot-7", range(4, 8))
    assert server.stop() == 0
    assert [p.name for p in (folder / "default").iterdir()] == ["robot-7"]
    counts = []
    for recording in sorted((folder / "default" / session.session_id).iterdir()):
        with AnyReader(sorted(recording.glob("*.mcap"))) as reader:
            counts.append(sum(c.msgcount for c in reader.connections if c.topic == "/laser/scan"))
    # It may have slept between two frames, too.
    assert sum(counts) == 8
    assert len(counts) >= 2


def test_a_killed_server_leaves_what_it_recorded_and_a_bad_folder_harms_no_session(start, tmp_path):
    folder = tmp_path / "recorded"
    server, client = start("--record", str(folder))
    session = client.sessions.create(sensors=[world.CAMERA, world.WHEELS])
    send_all_kinds(session, 10)

    def num_written() -> int:
        told = subprocess.run(
            [binary(), "info", only(folder, session.session_id), "--json"], capture_output=True, text=True
        )
        return json.loads(told.stdout)["frames"] if told.returncode == 0 else 0

    # Handed to the system every two seconds.
    assert eventually(lambda: num_written() == 10, seconds=30)
    server.kill()
    assert len(replayed(only(folder, session.session_id), tmp_path / "again")) == 10

    nowhere = tmp_path / "file"
    nowhere.write_text("no folder")
    server, client = start("--record", str(nowhere))
    other = client.sessions.create(sensors=[world.LASER])
    other.send_scan("laser", stamp_ns=world.stamp(0), **world.scan(world.drive(1)[0]))
    assert other.info().pose is not None
    assert server.stop() == 0
    assert "a session is not recorded any more" in server.tail()
    assert os.fspath(nowhere) in server.tail()
