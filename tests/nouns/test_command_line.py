"""What a person at a shell does: plan on a map file, import a map into a session, plan through it."""

from __future__ import annotations

import csv
import json
import subprocess

import numpy as np
import pytest
from percept import CoverageOptions, CoveragePath, Path, SensorSpec

from support.server import binary, recorded

#: A hall of 8 x 4 m with a wall across it that has a door of 1 m.
CELLS = np.full((80, 160), 254, np.uint8)
CELLS[:, 80] = 0
CELLS[30:50, 80] = 254
START, GOAL = "0.5,4.0", "6.0,4.5"


def percept(*arguments: object, code: int = 0) -> subprocess.CompletedProcess[str]:
    done = subprocess.run([binary(), *map(str, arguments)], capture_output=True, text=True, timeout=120)
    assert done.returncode == code, (done.stdout, done.stderr)
    return done


def nav2(folder, name: str, pixels, mode: str = "trinary"):
    height, width = pixels.shape
    (folder / f"{name}.pgm").write_bytes(b"P5 %d %d 255\n" % (width, height) + pixels[::-1].tobytes())
    path = folder / f"{name}.yaml"
    path.write_text(
        f"image: {name}.pgm\nmode: {mode}\nresolution: 0.05\norigin: [-1, 2, 0]\nnegate: 0\n"
        "occupied_thresh: 0.65\nfree_thresh: 0.25\n"
    )
    return path


@pytest.fixture
def hall(tmp_path):
    return nav2(tmp_path, "hall", CELLS)


def test_a_path_on_a_map_file_is_told_written_and_drawn(client, hall, tmp_path):
    table, picture = tmp_path / "path.csv", tmp_path / "path.png"
    told = percept("plan", hall, "--start", START, "--goal", GOAL, "--out", table, "--picture", picture).stdout
    path = client.toolbox.plan_on_map(hall, (0.5, 4.0), (6.0, 4.5))
    assert isinstance(path, Path)
    assert f"{path.length_m:.2f} m" in told
    assert f"{path.duration_s:.1f} s" in told
    rows = list(csv.DictReader(table.open()))
    assert [(float(r["x_m"]), float(r["y_m"])) for r in rows] == [(x, y) for x, y in path.waypoints]
    assert float(rows[-1]["time_s"]) == path.duration_s
    assert client.toolbox.decode_colour(picture.read_bytes()).shape[1] > 900
    whole = tmp_path / "path.json"
    percept("plan", hall, "--start", START, "--goal", GOAL, "--out", whole)
    assert json.loads(whole.read_text())["length_m"] == path.length_m


def test_no_path_is_a_failure_that_says_why_and_draws_it(hall, tmp_path):
    picture = tmp_path / "path.png"
    question = ("plan", hall, "--start", START, "--goal", GOAL)
    failed = percept(*question, "--radius", "0.8", "--picture", picture, code=1)
    assert failed.stdout == ""
    assert "no way wide enough" in failed.stderr
    assert "(unreachable); first blocked at" in failed.stderr
    assert picture.read_bytes().startswith(b"\x89PNG")
    answer = json.loads(percept(*question, "--radius", "0.8", "--json", code=1).stdout)
    assert answer["no_path"]["reason"] == "NO_PATH_REASON_UNREACHABLE"


def test_outline_planner_and_masks_are_those_of_the_question(hall, tmp_path):
    question = ("plan", hall, "--start", START, "--goal", GOAL, "--json")

    def path(*more: str):
        return json.loads(percept(*question, *more).stdout)["path"]

    usual = path()
    car = ("--planner", "hybrid", "--footprint", "0.45,0.2 -0.25,0.2 -0.25,-0.2 0.45,-0.2", "--turning-radius", "0.6")
    assert path(*car, "--goal-yaw", "0.0")["steering_cost"] > 0
    assert path("--planner", "any-angle")["length_m"] <= usual["length_m"] + 0.05
    assert path("--max-speed", "0.25")["duration_s"] > 1.8 * usual["duration_s"]
    shut = np.full_like(CELLS, 254)
    shut[:, 100] = 0
    failed = percept(*question, "--keep-out", nav2(tmp_path, "shut", shut), code=1)
    assert "keep out" in failed.stderr
    slow = nav2(tmp_path, "slow", np.full_like(CELLS, 20), "raw")
    assert path("--speed-mask", slow)["duration_s"] > 4 * usual["duration_s"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("plan", "--goal", GOAL), "required"),
        (("plan", "MAP", "--goal", GOAL), "--start"),
        (("plan", "MAP", "--start", START, "--goal", "nan,1"), "no place"),
        (("plan", "MAP", "--start", START, "--goal", GOAL, "--footprint", "0,0 1,0"), "at least three"),
        (("plan", "MAP", "--start", START, "--goal", GOAL, "--planner", "best"), "possible values"),
        (("plan", "MAP", "--server", "localhost:1", "--session", "a", "--goal", GOAL), "cannot be used with"),
    ],
)
def test_questions_that_are_none_are_usage_errors(hall, arguments, words):
    failed = percept(*(hall if a == "MAP" else a for a in arguments), code=2)
    assert words in failed.stderr


def test_files_that_are_none_are_named(hall, tmp_path):
    question = ("--start", START, "--goal", GOAL)
    assert "nothing.yaml" in percept("plan", tmp_path / "nothing.yaml", *question, code=1).stderr
    assert "hall.pgm" in percept("plan", tmp_path / "hall.pgm", *question, code=1).stderr
    (tmp_path / "hall.pgm").write_bytes(b"P5 160 80 255\n\0")
    assert "hall.pgm" in percept("plan", hall, *question, code=1).stderr
    assert ".csv or .json" in percept("plan", hall, *question, "--out", tmp_path / "path.txt", code=1).stderr
    refused = percept("import-map", tmp_path / "hall.pgm", "--server", "127.0.0.1:1", code=1)
    assert "yaml" in refused.stderr
    gone = percept("import-map", hall, "--server", "127.0.0.1:1", code=1)
    assert "cannot read" in gone.stderr or "cannot reach" in gone.stderr


def test_a_map_is_imported_and_planned_through(server, client, hall, name, tmp_path):
    told = percept("import-map", hall, "--server", server.grpc, "--session", name, "--create", "--json").stdout
    assert json.loads(told)["session_id"] == name
    session = client.session(name)
    assert session.map.summary().occupancy is not None
    picture, through = tmp_path / "path.png", ("--server", server.grpc, "--session", name)
    told = percept("plan", *through, "--start", START, "--goal", GOAL, "--picture", picture).stdout
    assert f"{session.plan((6.0, 4.5), start=(0.5, 4.0)).length_m:.2f} m" in told
    assert picture.read_bytes() == session.draw_path((6.0, 4.5), start=(0.5, 4.0)).png
    lost = percept("plan", *through, "--goal", GOAL, code=1)
    assert "does not know where it is" in lost.stderr
    again = percept("import-map", hall, "--server", server.grpc, "--session", name, code=1)
    assert "map" in again.stderr
    nobody = percept("plan", "--server", server.grpc, "--session", "nobody", "--goal", GOAL, code=1)
    assert "nobody" in nobody.stderr


def test_points_and_voxels_are_imported_too(server, client, lidar_session, name, tmp_path):
    for suffix, file_format in (("ply", "cloud_ply"), ("bt", "voxels_bt")):
        file = tmp_path / f"map.{suffix}"
        file.write_bytes(lidar_session.map.export(file_format).data)
        session = f"{name}-{suffix}"
        percept("import-map", file, "--server", server.grpc, "--session", session, "--create", "--start", "0,0,0")
        assert client.session(session).map.summary().num_keyframes > 0


def test_a_path_through_a_depot_that_nobody_here_has_drawn(tmp_path):
    maps = recorded("planning-ros-maps")
    if maps is None:
        pytest.skip("the maps of nav2 are not there")
    question = ("plan", maps / "depot.yaml", "--start", "3,8", "--goal", "26,11", "--json")
    free = json.loads(percept(*question).stdout)["path"]
    kept = json.loads(percept(*question, "--keep-out", maps / "depot_keepout.yaml").stdout)["path"]
    assert kept["length_m"] > free["length_m"]


#: The same with nothing known to the right of the door's room.
OPEN = np.hstack([CELLS, np.full((80, 20), 205, np.uint8)])


def test_coverage_of_a_map_file_and_of_a_session_is_told_written_and_drawn(server, client, hall, name, tmp_path):
    table, picture, drawn = tmp_path / "sweep.csv", tmp_path / "sweep.png", tmp_path / "drawn.png"
    question = ("--start", START, "--tool-width", "0.6")
    told = percept("coverage", hall, *question, "--out", table, "--picture", picture).stdout
    rows = list(csv.DictReader(table.open()))
    assert len(rows) > 10
    assert "covers" in told
    assert client.toolbox.decode_colour(picture.read_bytes()).shape[1] > 900
    percept("import-map", hall, "--server", server.grpc, "--session", name, "--create")
    through = ("--server", server.grpc, "--session", name)
    answer = json.loads(percept("coverage", *through, *question, "--json", "--picture", drawn).stdout)
    session = client.session(name)
    sweep = session.plan_coverage(start=(0.5, 4.0), coverage=CoverageOptions(tool_width_m=0.6))
    assert isinstance(sweep, CoveragePath)
    assert answer["path"]["covered_share"] == sweep.covered_share
    assert answer["path"]["path"]["length_m"] == sweep.path.length_m
    assert picture.read_bytes()[:4] == drawn.read_bytes()[:4] == b"\x89PNG"
    failed = percept("coverage", hall, "--start", "3.02,3.0", "--radius", "0.2", code=1)
    assert "no path: the start is in an obstacle" in failed.stderr
    shut = np.full_like(CELLS, 254)
    shut[:, 75:85] = 0
    half = json.loads(percept("coverage", hall, *question, "--keep-out", nav2(tmp_path, "shut", shut), "--json").stdout)
    assert half["path"]["coverable_m2"] < 0.6 * answer["path"]["coverable_m2"]


def test_frontiers_of_a_map_file_and_of_a_session_are_listed_and_written(server, client, name, tmp_path):
    hall = nav2(tmp_path, "open", OPEN)
    # Beyond the edge of the file nothing is known, either.
    told = percept("frontiers", hall, "--start", START).stdout
    assert told.count("m wide") == 2
    table, whole = tmp_path / "edges.csv", tmp_path / "edges.json"
    percept("frontiers", hall, "--start", START, "--out", table)
    percept("frontiers", hall, "--start", START, "--out", whole)
    rows, edges = list(csv.DictReader(table.open())), json.loads(whole.read_text())["frontiers"]
    assert [float(r["goal_x_m"]) for r in rows] == [e["goal"]["x"] for e in edges]
    assert [float(r["length_m"]) for r in rows] == [e["length_m"] for e in edges]
    assert edges[0]["goal"]["x"] < 3.0 < 6.0 < edges[1]["goal"]["x"]
    # Beyond a door that is shut nobody looks.
    shut = np.full_like(OPEN, 254)
    shut[:, 78:82] = 0
    told = percept("frontiers", hall, "--start", START, "--keep-out", nav2(tmp_path, "shut", shut)).stdout
    assert told.count("m wide") == 1
    percept("import-map", hall, "--server", server.grpc, "--session", name, "--create")
    through = ("--server", server.grpc, "--session", name)
    answer = json.loads(percept("frontiers", *through, "--start", START, "--min-length", "1", "--json").stdout)
    found = client.session(name).frontiers(start=(0.5, 4.0), min_length_m=1.0)
    assert [f["length_m"] for f in answer["frontiers"]] == [f.length_m for f in found]
    lost = percept("frontiers", *through, code=1)
    assert "does not know where it is" in lost.stderr


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("coverage", "--start", START), "required"),
        (("frontiers", "MAP"), "--start"),
        (("frontiers", "MAP", "--server", "localhost:1", "--session", "a"), "cannot be used with"),
    ],
)
def test_questions_about_ground_that_are_none_are_usage_errors(hall, arguments, words):
    failed = percept(*(hall if a == "MAP" else a for a in arguments), code=2)
    assert words in failed.stderr


def test_a_stream_may_go_into_a_session_that_exists(server, client, name):
    """As into one whose map was imported; what it lacks of sensors is declared."""
    drive = ("sim", "--server", server.grpc, "--sensors", "lidar2d", "--duration-s", "2")
    assert "does not exist" in percept(*drive, "--into", name, code=1).stderr
    session = client.sessions.create(name)
    percept(*drive, "--into", name)
    assert all(s.accepted > 10 and s.rejected == 0 for s in session.sensors.list())
    (laser,) = [s.spec for s in session.sensors.list() if s.spec.kind == "lidar2d"]
    other = client.sessions.create(sensors=[SensorSpec(laser.sensor_id, kind="lidar3d")])
    assert "SENSOR_KIND_LIDAR3D" in percept(*drive, "--into", other.session_id, code=1).stderr


@pytest.mark.parametrize("content", [b"", b"no cloud at all"])
def test_a_file_that_is_none_is_no_recording(tmp_path, content):
    (tmp_path / "cloud.ply").write_bytes(content)
    assert "cloud.ply" in percept("info", tmp_path / "cloud.ply", code=1).stderr
    (tmp_path / "more.ply").write_bytes(content)
    assert "its first frame cannot be read" in percept("info", tmp_path).stdout


@pytest.mark.parametrize("command", [["config"], ["completions", "bash"]])
def test_a_reader_may_leave_before_the_end(command):
    """As `percept config | head -1` does."""
    with subprocess.Popen(
        [binary(), *command], stdout=subprocess.PIPE, stderr=subprocess.PIPE, pipesize=4096
    ) as process:
        process.stdout.read(1)
        process.stdout.close()
        assert (process.stderr.read(), process.wait(timeout=30)) == (b"", 0)


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_a_shell_completes_commands(shell):
    script = percept("completions", shell).stdout
    assert all(command in script for command in ("replay", "doctor", "import-map"))
    if shell == "bash":
        # The script itself, in the shell itself: what follows `percept doc`.
        ask = "COMP_WORDS=(percept doc); COMP_CWORD=1; _percept percept doc percept; echo ${COMPREPLY[@]}"
        done = subprocess.run(["bash", "-c", f"{script}\n{ask}"], capture_output=True, text=True, timeout=60)
        assert done.stdout.split() == ["doctor"], done.stderr


def test_clouds_that_have_nothing_to_do_with_each_other_are_no_drive(tmp_path):
    clouds = recorded("cloud-pcl")
    if clouds is None:
        pytest.skip("no cloud-pcl in PERCEPT_DATA")
    for cloud in sorted(clouds.glob("*.pcd")):
        (tmp_path / cloud.name).write_bytes(cloud.read_bytes())
    told = percept("replay", tmp_path, code=1).stderr
    assert "clouds lie on those before them: they are hardly of one drive" in told
