"""What sessions are sent, recorded: files that others read, and that give the same way when they are replayed."""

from __future__ import annotations

import asyncio
import json
import os
import pathlib
import subprocess

import httpx
import numpy as np
import pytest
from percept import AsyncClient, Client, FailedPrecondition, NotFound
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

    def started(*arguments: str, **options: str) -> tuple[Server, Client]:
        servers.append(Server(tmp_path / "data", *arguments, **options))
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


def test_a_recording_is_replayed_with_the_parameters_of_its_session(start, tmp_path):
    folder = tmp_path / "recorded"
    server, client = start("--record", str(folder))
    keyframe = {"distance_m": 0.07, "angle_rad": 0.05}
    params = {"map": {"occupancy": {"resolution_m": 0.1}}, "slam": {"odometry": {"keyframe": keyframe}}}
    session = client.sessions.create(sensors=[world.LASER], params=params)
    scans(session, range(20))
    session.update(params={"detection": {"enabled": False}})
    scans(session, range(20, 24))
    went, keyframes = session.trajectory(), session.info().num_keyframes
    assert server.stop() == 0
    recording = only(folder, session.session_id)

    def run(*arguments: str) -> tuple[dict, str]:
        command = [binary(), *arguments, "--json"]
        done = subprocess.run(command, capture_output=True, text=True, timeout=120)
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout), done.stderr

    out = tmp_path / "again"
    report, said = run("replay", recording, "--out", out)
    assert report["keyframes"] == keyframes
    assert "resolution: 0.1" in (out / "map.yaml").read_text()
    assert "distance_m = 0.07" in said
    assert "changed while it was recorded" in said
    again = np.loadtxt(out / "trajectory.tum")
    assert np.abs(again[:, 1:4] - went.positions).max() < 1e-3
    assert any("distance_m = 0.07" in note for note in run("info", recording)[0]["notes"])
    by_default, _ = run("replay", recording, "--default-params")
    assert by_default["keyframes"] < keyframes

    # Into a server, too; and a recording that begins later tells what it lacks.
    server, client = start("--record", str(tmp_path / "second"))
    run("replay", recording, "--server", server.grpc, "--session", "again")
    played = client.session("again")
    assert played.info().params["slam"]["odometry"]["keyframe"]["distance_m"] == pytest.approx(0.07)
    assert played.info().num_keyframes == keyframes
    played.recordings.stop()
    played.recordings.start()
    # It is called as its topic is.
    laser = played.sensors.list()[0].spec.sensor_id
    for i, pose in enumerate(world.drive(26)[24:], 24):
        played.send_scan(laser, stamp_ns=world.stamp(i), **world.scan(pose))
    assert server.stop() == 0
    newest = sorted((tmp_path / "second" / "default" / "again").iterdir(), key=lambda p: int(p.name))[-1]
    assert f"had a map of {keyframes} keyframes" in run("info", newest)[0]["notes"][-1]


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


#: What a file that was ended ends with: https://mcap.dev/spec
MCAP_MAGIC = b"\x89MCAP0\r\n"


def by_call(tmp_path, more: str = "") -> tuple[str, str]:
    """The arguments of a server that records whom it is told to."""
    config = tmp_path / "percept.toml"
    config.write_text(f'[recording]\ndir = "{tmp_path / "recorded"}"\nsessions = ""\n{more}')
    return "--config", str(config)


def scans(session, numbers: range) -> None:
    poses = world.drive(numbers.stop)
    for i in numbers:
        session.send_scan("laser", stamp_ns=world.stamp(i), **world.scan(poses[i]))


def num_scans(recording: pathlib.Path) -> int:
    with AnyReader(sorted(recording.glob("*.mcap"))) as reader:
        return sum(c.msgcount for c in reader.connections if c.topic == "/laser/scan")


def test_calls_begin_and_end_recordings_that_are_listed_and_removed(start, tmp_path):
    _, client = start(*by_call(tmp_path))
    session = client.sessions.create(sensors=[world.LASER])
    scans(session, range(2))
    assert not session.info().recorded
    assert session.info().recording is None
    assert list(session.recordings.list()) == []
    begun = session.recordings.start()
    assert (begun.state, begun.end, begun.num_frames) == ("waiting", "unspecified", 0)
    assert session.recordings.start().recording_id == begun.recording_id
    scans(session, range(2, 7))
    info = session.info()
    assert (info.recorded, info.recording.state, info.recording.recording_id) == (True, "running", begun.recording_id)
    assert session.recordings.start().recording_id == begun.recording_id
    with pytest.raises(FailedPrecondition, match="stop it first") as refused:
        session.recordings.delete(begun.recording_id)
    assert (refused.value.reason, refused.value.field) == ("RECORDING_UNDER_WAY", "recording_id")
    (listed,) = session.recordings.list()
    assert (listed.recording_id, listed.open) == (begun.recording_id, True)

    ended = session.recordings.stop()
    assert (ended.state, ended.end, ended.num_frames, ended.num_files) == ("ended", "stopped", 5, 1)
    assert ended.dropped.num_too_slow == ended.dropped.num_no_shared_room == ended.dropped.num_unwritable == 0
    assert session.recordings.stop().recording_id == ended.recording_id
    scans(session, range(7, 9))
    assert not session.info().recorded
    folder = tmp_path / "recorded" / ended.folder
    assert folder == only(tmp_path / "recorded", session.session_id)
    assert num_scans(folder) == 5
    (listed,) = session.recordings.list()
    assert (listed.num_bytes, listed.open) == (ended.num_bytes, False)
    (file,) = listed.files
    assert (file.name, file.num_bytes) == ("recording_0000.mcap", (folder / "recording_0000.mcap").stat().st_size)
    assert listed.last_write_time_ns >= ended.start_time_ns

    again = session.recordings.start()
    assert int(again.recording_id) > int(ended.recording_id)
    scans(session, range(9, 11))
    session.recordings.stop()
    assert [r.recording_id for r in session.recordings.list(page_size=1)] == [ended.recording_id, again.recording_id]
    session.recordings.delete(ended.recording_id)
    assert not folder.exists()
    assert [r.recording_id for r in session.recordings.list()] == [again.recording_id]
    for none in (ended.recording_id, "..", "0", "x", ""):
        with pytest.raises(NotFound) as refused:
            session.recordings.delete(none)
        assert refused.value.reason == "RECORDING_NOT_FOUND"


def test_what_cannot_be_recorded_is_told_with_a_remedy(start, tmp_path):
    server, client = start()
    session = client.sessions.create(sensors=[world.LASER])
    calls = (
        session.recordings.start,
        session.recordings.stop,
        lambda: list(session.recordings.list()),
        lambda: session.recordings.delete("1"),
    )
    for call in calls:
        with pytest.raises(FailedPrecondition, match="--record FOLDER") as refused:
            call()
        assert refused.value.reason == "RECORDING_OFF"
    assert not session.info().recorded

    server.kill()
    _, client = start(*by_call(tmp_path))
    counted = client.sessions.create(mode="ingest_only", sensors=[world.LASER])
    with pytest.raises(FailedPrecondition, match="mode is INGEST_ONLY") as refused:
        counted.recordings.start()
    assert refused.value.reason == "SESSION_NOT_MAPPING"
    with pytest.raises(FailedPrecondition, match="start it first") as refused:
        counted.recordings.stop()
    assert refused.value.reason == "NOT_RECORDED"
    unknown = client.session("unknown")
    for call in (unknown.recordings.start, unknown.recordings.stop, lambda: list(unknown.recordings.list())):
        with pytest.raises(NotFound) as refused:
            call()
        assert refused.value.reason == "SESSION_NOT_FOUND"


def test_whose_the_session_is_alone_has_its_recordings(start, tmp_path):
    keys = tmp_path / "keys.json"

    def key(tenant: str, scope: str) -> str:
        given = ("--file", keys, "--name", tenant + scope, "--tenant", tenant, "--scope", scope)
        return subprocess.check_output([binary(), "keys", "create", *given], text=True).strip()

    ours, reader, theirs = key("ours", "admin"), key("ours", "read"), key("theirs", "admin")
    server, _ = start(*by_call(tmp_path, f'[auth]\nmode = "required"\nkeys_file = "{keys}"\n'), zenoh="")
    session = Client(server.grpc, token=ours).sessions.create("robot-7", sensors=[world.LASER])
    session.recordings.start()
    scans(session, range(2))
    stranger = Client(server.grpc, token=theirs).session("robot-7").recordings
    for call in (stranger.start, stranger.stop, lambda: list(stranger.list()), lambda: stranger.delete("1")):
        with pytest.raises(NotFound) as refused:
            call()
        assert refused.value.reason == "SESSION_NOT_FOUND"
    seen = Client(server.grpc, token=reader).session("robot-7")
    assert seen.info().recording.folder.startswith("ours/robot-7/")
    assert [r.open for r in seen.recordings.list()] == [True]
    for call in (seen.recordings.start, seen.recordings.stop, lambda: seen.recordings.delete("1")):
        with pytest.raises(Exception, match="this needs") as denied:
            call()
        assert denied.value.reason == "PERMISSION_DENIED"


def test_a_recording_by_call_goes_on_after_sleep_and_not_after_a_restart(start, tmp_path):
    arguments = by_call(tmp_path, "[limits]\nsleep_after_s = 1\n")
    server, client = start(*arguments)
    session = client.sessions.create(sensors=[world.LASER])
    first = session.recordings.start()
    scans(session, range(3))
    assert eventually(lambda: session.info().state == "asleep", seconds=30)
    info = session.info()
    assert (info.recorded, info.recording.state, info.recording.end) == (True, "ended", "slept")
    scans(session, range(3, 6))
    assert session.info().recording.recording_id != first.recording_id
    assert server.stop() == 0
    server, client = start(*arguments)
    session = client.session(session.session_id)
    scans(session, range(6, 8))
    assert not session.info().recorded
    assert session.info().recording is None
    stored = list(session.recordings.list())
    assert len(stored) >= 2
    folders = [tmp_path / "recorded" / "default" / session.session_id / r.recording_id for r in stored]
    assert sum(num_scans(folder) for folder in folders) == 6


def test_what_is_configured_is_stopped_and_started_by_calls_too(start, tmp_path):
    _, client = start("--record", str(tmp_path / "recorded"))
    session = client.sessions.create(sensors=[world.LASER])
    assert session.info().recorded
    scans(session, range(2))
    assert session.recordings.stop().num_frames == 2
    scans(session, range(2, 4))
    session.recordings.start()
    scans(session, range(4, 7))
    assert session.recordings.stop().num_frames == 3


def test_two_sessions_are_recorded_at_once_and_a_deleted_one_leaves_its_files(start, tmp_path):
    server, client = start(*by_call(tmp_path))
    one, other = (client.sessions.create(sensors=[world.LASER]) for _ in range(2))
    folders = [tmp_path / "recorded" / session.recordings.start().folder for session in (one, other)]
    for i in range(4):
        scans(one, range(i, i + 1))
        scans(other, range(i, i + 1))
    one.delete()

    def is_whole(recording: pathlib.Path) -> bool:
        return all(file.read_bytes().endswith(MCAP_MAGIC) for file in recording.glob("*.mcap"))

    # It ends when the deletion is through, which the caller does not wait for.
    assert eventually(lambda: is_whole(folders[0]), seconds=30)
    assert num_scans(folders[0]) == 4
    with pytest.raises(NotFound):
        one.recordings.stop()
    scans(other, range(4, 6))
    ended = other.recordings.stop()
    assert (ended.num_frames, num_scans(folders[1])) == (6, 6)
    assert server.stop() == 0


def test_a_disk_without_room_is_told_and_harms_no_session(start, tmp_path):
    _, client = start(*by_call(tmp_path, f"min_free_mb = {1 << 40}\n"))
    session = client.sessions.create(sensors=[world.LASER])
    session.recordings.start()
    scans(session, range(2))
    assert eventually(lambda: session.info().recording.end == "disk_full", seconds=30)
    info = session.info()
    assert (info.recorded, info.recording.state) == (False, "ended")
    assert "make room" in info.recording.end_message
    scans(session, range(2, 4))
    assert session.info().recording.dropped.num_after_end > 0
    assert session.recordings.stop().end == "disk_full"


def test_rest_the_command_line_and_the_async_client_record_too(start, tmp_path):
    server, client = start(*by_call(tmp_path))
    session = client.sessions.create("robot-7", sensors=[world.LASER])
    url = "/v1/sessions/robot-7/recordings"
    with httpx.Client(base_url=server.rest_url, timeout=30) as http:
        paths = http.get("/openapi.json").json()["paths"]
        described = "/v1/sessions/{session_id}/recordings"
        assert set(paths[described]) == {"get"}
        assert "post" in paths[f"{described}/start"]
        assert "post" in paths[f"{described}/stop"]
        assert "delete" in paths[described + "/{recording_id}"]
        assert http.post(f"{url}/stop", json={}).json()["reason"] == "NOT_RECORDED"
        begun = http.post(f"{url}/start", json={}).json()["recording"]
        assert begun["state"] == "RECORDING_STATE_WAITING"
        scans(session, range(3))
        assert http.delete(f"{url}/{begun['recording_id']}").status_code == 409
        assert http.get("/v1/sessions/robot-7").json()["session"]["recorded"] is True
        assert http.post(f"{url}/stop", json={}).json()["recording"]["num_frames"] == "3"
        assert len(http.get(url).json()["recordings"]) == 1
        assert http.delete(f"{url}/{begun['recording_id']}").status_code == 200
        assert http.delete(f"{url}/{begun['recording_id']}").status_code == 404

    def record(*arguments: str) -> subprocess.CompletedProcess:
        command = [binary(), "record", *arguments, "--server", server.grpc]
        return subprocess.run(command, capture_output=True, text=True, timeout=60)

    assert record("start", "robot-7").returncode == 0
    scans(session, range(3, 5))
    stopped = record("stop", "robot-7")
    assert "2 frames, 1 file" in stopped.stdout, stopped
    (line,) = record("list", "robot-7", "--json").stdout.splitlines()
    recording_id = json.loads(line)["recording_id"]
    assert record("delete", "robot-7", recording_id).returncode == 0
    assert record("list", "robot-7").stdout == ""
    refused = record("delete", "robot-7", recording_id)
    assert (refused.returncode, recording_id in refused.stderr) == (1, True)

    async def run() -> int:
        async with AsyncClient(server.grpc) as other:
            recordings = other.session("robot-7").recordings
            await recordings.start()
            scans(session, range(5, 9))
            ended = await recordings.stop()
            assert [r.recording_id async for r in recordings.list()] == [ended.recording_id]
            await recordings.delete(ended.recording_id)
            return ended.num_frames

    assert asyncio.run(run()) == 4
