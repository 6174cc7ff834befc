"""`percept store`: what an operator does with stored sessions, while a server runs and while none does."""

from __future__ import annotations

import json
import subprocess
import threading

import pytest
from percept import Client

from support import robots, s3, world
from support.server import Server, binary, eventually


def store(*arguments: object, code: int = 0) -> subprocess.CompletedProcess[str]:
    """Runs `percept store ...`; fails if it ends with another code."""
    done = subprocess.run(
        [binary(), "store", *map(str, arguments)], capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == code, done.stdout + done.stderr
    return done


def reports(*arguments: object, code: int = 0) -> dict[str, dict]:
    lines = store("check", "--json", *arguments, code=code).stdout.splitlines()
    return {report["session"]: report for report in map(json.loads, lines)}


def stamps(client: Client, name: str) -> list[int]:
    return client.sessions.get(name).trajectory().stamps_ns.tolist()


@pytest.fixture
def filled(tmp_path):
    """A running server with two mapped sessions and an empty one."""
    server = Server(tmp_path / "data")
    with Client(server.grpc) as client:
        for phase, name in enumerate(("north", "south")):
            robots.mapped(client, name, phase=phase)
        client.sessions.create("empty")
        yield server, client
    server.kill()


@pytest.mark.parametrize("is_running", [True, False], ids=["running", "stopped"])
def test_a_check_reads_everything_and_names_what_is_damaged(filled, is_running):
    server, _ = filled
    if not is_running:
        assert server.stop() == 0
    found = reports("--data-dir", server.data_dir)
    assert set(found) == {"north", "south", "empty"}
    assert found["north"]["records"] > 0 and found["north"]["scans"] > 0 and found["empty"]["records"] == 0
    assert all(report["faults"] == [] for report in found.values())
    assert "whole" in store("check", "--data-dir", server.data_dir).stdout

    scan, lost = (next((server.data_dir / "sessions" / name).glob("*/blobs/*")) for name in ("north", "south"))
    damaged = bytearray(scan.read_bytes())
    damaged[len(damaged) // 2] ^= 1
    scan.write_bytes(damaged)
    lost.unlink()
    found = reports("--data-dir", server.data_dir, code=1)
    for name, code, blob in (("north", "SCAN_DAMAGED", scan), ("south", "SCAN_MISSING", lost)):
        (fault,) = found[name]["faults"]
        assert fault["code"] == code and blob.name in fault["message"]
    assert found["empty"]["faults"] == []
    told = store("check", "--data-dir", server.data_dir, code=1)
    assert "DAMAGED" in told.stdout and "2 of 3 sessions" in told.stderr


def test_an_export_moves_sessions_from_one_running_server_to_another(filled, tmp_path):
    server, client = filled
    other = Server(tmp_path / "other")
    try:
        file = tmp_path / "sessions.percept"
        store("export", "--data-dir", server.data_dir, "--session", "north", "--session", "empty", file)
        store("import", "--data-dir", other.data_dir, file)
        with Client(other.grpc) as another:
            assert eventually(lambda: {i.session_id for i in another.sessions.list()} == {"north", "empty"})
            assert stamps(another, "north") == stamps(client, "north")
            assert robots.send_scans(another.sessions.get("north"), 10, 15) == 5
        # What is there stays as it is.
        told = store("import", "--data-dir", other.data_dir, file, code=1)
        assert "exists" in told.stderr
    finally:
        other.kill()


def test_an_export_goes_through_a_pipe_into_a_place_that_nobody_serves(filled, tmp_path):
    server, client = filled
    export = subprocess.run(
        [binary(), "store", "export", "--data-dir", server.data_dir, "-"], capture_output=True, check=True, timeout=60
    )
    subprocess.run(
        [binary(), "store", "import", "--data-dir", tmp_path / "new", "-"], input=export.stdout, check=True, timeout=60
    )
    before = {name: stamps(client, name) for name in ("north", "south")}
    server.kill()
    copy = Server(tmp_path / "new")
    try:
        with Client(copy.grpc) as another:
            assert {name: stamps(another, name) for name in before} == before
    finally:
        copy.kill()


def test_what_is_no_export_or_half_of_one_is_refused_and_leaves_nothing(filled, tmp_path):
    server, _ = filled
    file, cut, other = tmp_path / "all", tmp_path / "cut", tmp_path / "other"
    store("export", "--data-dir", server.data_dir, file)
    cut.write_bytes(file.read_bytes()[:-100])
    assert "export" in store("import", "--data-dir", other, cut, code=1).stderr
    other_text = tmp_path / "text"
    other_text.write_text("hello")
    assert "export" in store("import", "--data-dir", other, other_text, code=1).stderr
    assert "no-such" in store("import", "--data-dir", other, tmp_path / "no-such", code=1).stderr
    # Sessions that were whole before the cut are there; the last, which was not, is not.
    assert "south" not in reports("--data-dir", other)
    assert reports("--data-dir", other, code=0).keys() <= {"empty", "north"}
    told = store("export", "--data-dir", server.data_dir, "--session", "west", tmp_path / "x", code=1)
    assert "west" in told.stderr and not (tmp_path / "x").exists() and not (tmp_path / "x.part").exists()
    told = store("check", "--data-dir", tmp_path / "nowhere", code=1)
    assert not (tmp_path / "nowhere").exists(), told.stderr
    assert "s3://" in store("check", "--store-url", "ftp://somewhere", code=1).stderr


def test_a_backup_of_a_server_at_work_is_whole_and_copies_only_what_changed(filled, tmp_path):
    server, client = filled
    to = tmp_path / "backup"
    stop = threading.Event()
    session = client.sessions.get("south")

    def drive() -> None:
        with session.stream() as stream:
            for i in range(10, 2000):
                if stop.is_set():
                    break
                stream.send_scan("laser", stamp_ns=world.stamp(i), **robots.scan(i))

    driving = threading.Thread(target=drive)
    driving.start()
    try:
        first = json.loads(store("backup", "--data-dir", server.data_dir, to).stdout)
        second = json.loads(store("backup", "--data-dir", server.data_dir, to).stdout)
    finally:
        stop.set()
        driving.join()
    assert first["sessions"] == second["sessions"] == 3 and first["blobs"] > 0
    assert all(report["faults"] == [] for report in reports("--data-dir", to).values())
    client.sessions.delete("empty")
    last = json.loads(store("backup", "--data-dir", server.data_dir, to).stdout)
    assert last["sessions"] == 2
    nothing = json.loads(store("backup", "--data-dir", server.data_dir, to).stdout)
    assert (nothing["records"], nothing["blobs"]) == (0, 0)
    copy = Server(to)
    try:
        with Client(copy.grpc) as another:
            assert stamps(another, "south") == stamps(client, "south")
            assert stamps(another, "north") == stamps(client, "north")
    finally:
        copy.kill()


def test_a_backup_goes_to_a_bucket_and_is_restored_from_it(filled, tmp_path, monkeypatch):
    server, client = filled
    before = stamps(client, "north")
    with s3.server() as address:
        for name, value in {
            **s3.KEYS,
            "PERCEPT_STORAGE_S3_ENDPOINT": address,
            "PERCEPT_STORAGE_S3_ALLOW_HTTP": "true",
        }.items():
            monkeypatch.setenv(name, value)
        url = f"s3://{s3.BUCKET}/backup"
        store("backup", "--data-dir", server.data_dir, url)
        server.kill()
        assert set(reports("--store-url", url)) == {"north", "south", "empty"}
        store("backup", "--store-url", url, tmp_path / "restored")
    restored = Server(tmp_path / "restored")
    try:
        with Client(restored.grpc) as another:
            assert stamps(another, "north") == before
    finally:
        restored.kill()
