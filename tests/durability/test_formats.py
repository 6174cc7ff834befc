"""Data that earlier versions have written open, with all that was in them, and go on."""

from __future__ import annotations

import json
import pathlib
import tarfile

import numpy as np
import pytest
from percept import Client

from support import world
from support.server import Server

FORMATS = pathlib.Path(__file__).with_name("formats")


def written_by(number: int, folder: pathlib.Path) -> tuple[pathlib.Path, dict]:
    """A data directory as format `number` has it, and what is in it."""
    with tarfile.open(FORMATS / f"{number}.tar.xz") as archive:
        archive.extractall(folder, filter="data")
    return folder / "data", json.loads((FORMATS / f"{number}.json").read_text())


def check(client: Client, expected: dict) -> None:
    assert sorted(s.session_id for s in client.sessions.list()) == sorted(expected)
    for session_id, there in expected.items():
        session = client.session(session_id)
        pose, info = session.pose(), session.info()
        assert info.display_name == there["display_name"]
        assert [s.spec.sensor_id for s in info.sensors] == there["sensors"]
        assert info.num_keyframes == there["keyframes"]
        assert [o.object_id for o in session.scene.objects()] == there["objects"]
        assert len(session.trajectory()) == there["trajectory"]
        if there["position_m"] is None:
            assert pose is None
        else:
            assert np.allclose(pose.t_map_base.translation, there["position_m"], atol=1e-6)


@pytest.mark.parametrize("number", [1])
def test_data_of_an_earlier_format_open_and_go_on(tmp_path, number):
    data_dir, expected = written_by(number, tmp_path)
    server = Server(data_dir)
    try:
        with Client(server.grpc) as client:
            check(client, expected)
            # What an earlier version took in is still known to be taken in.
            assert client.sessions.create(request_id="once").session_id == "laser"
            laser = client.session("laser")
            for i, pose in enumerate(world.drive(90)[80:], start=80):
                laser.send_scan("laser", stamp_ns=world.stamp(i), **world.scan(pose))
            assert laser.pose().state == "tracking"
        # Killed, it is of the current format, and the earlier one is gone from the disk.
        server.kill()
        server.start()
        assert not (data_dir / "records").exists()
        assert not (data_dir / "blobs").exists()
        expected["laser"]["trajectory"] = 90
        del expected["laser"]["position_m"], expected["laser"]["keyframes"]
        with Client(server.grpc) as client:
            laser = client.session("laser")
            assert len(laser.trajectory()) == 90
            check(client, {k: v for k, v in expected.items() if k != "laser"} | {"laser": whole(laser)})
    finally:
        server.kill()


def whole(session) -> dict:
    info, pose = session.info(), session.pose()
    return {
        "display_name": info.display_name,
        "sensors": [s.spec.sensor_id for s in info.sensors],
        "keyframes": info.num_keyframes,
        "objects": [o.object_id for o in session.scene.objects()],
        "trajectory": len(session.trajectory()),
        "position_m": list(pose.t_map_base.translation),
    }


@pytest.mark.parametrize("number", [1])
def test_a_migration_that_is_killed_is_done_again(tmp_path, number):
    data_dir, expected = written_by(number, tmp_path)
    # Half done: a session's entry is there already, the rest is not, and the number says that it was not finished.
    first = Server(data_dir)
    first.kill()
    redone, _ = written_by(number, tmp_path / "again")
    for name in ("FORMAT", "records", "blobs"):
        target = data_dir / name
        (redone / name).rename(target) if not target.exists() else target.write_text((redone / name).read_text())
    (data_dir / "catalogue" / "rooms").joinpath("0" * 16).unlink()
    server = Server(data_dir)
    try:
        with Client(server.grpc) as client:
            check(client, expected)
    finally:
        server.kill()
