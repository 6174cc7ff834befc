"""The examples run on a server, and find what is there."""

from __future__ import annotations

import os
import re
import subprocess
import sys

import pytest

from support.server import REPO, recorded

EXAMPLES = REPO / "examples"


def run(server, name, *arguments):
    """What a script prints."""
    command = [sys.executable, EXAMPLES / name, *arguments]
    environment = {**os.environ, "PERCEPT_SERVER": server.grpc}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=240)
    assert done.returncode == 0, done.stderr
    return done.stdout


def number(pattern, text):
    found = re.search(pattern, text)
    assert found, text
    return float(found.group(1))


def test_a_robot_is_found_in_a_map_of_another(server):
    told = run(server, "map_and_find.py")
    # The drive is a round of 7.2 m, less its last step.
    assert number(r"mapped ([\d.]+) m", told) == pytest.approx(7.1, abs=0.1)
    assert number(r"found by scan \d+ of \d+, ([\d.]+) m", told) < 0.1
    tracked, of = re.search(r"then (\d+) of (\d+)", told).groups()
    assert tracked == of


def test_a_robot_is_found_in_a_recorded_map(server):
    folder = recorded("lidar2d-intel")
    if folder is None:
        pytest.skip("recorded data is not there")
    told = run(server, "map_and_find.py", str(folder / "intel.clf"))
    assert number(r"found by scan \d+ of \d+, ([\d.]+) m", told) < 0.3


def test_a_path_is_followed_to_its_goal(server):
    told = run(server, "plan_and_follow.py")
    assert number(r"stands ([\d.]+) m from the goal", told) < 0.1


def test_a_crate_that_is_brought_is_told(server):
    told = run(server, "watch_things.py")
    came = number(r"the crate came at ([\d.]+) s", told)
    boxes = [float(seconds) for seconds in re.findall(r"([\d.]+) s: box \d+ (?:appeared|reclassified)", told)]
    assert any(seconds > came for seconds in boxes), told
    assert {"table", "shelf", "box"} <= set(re.findall(r"\w+", told.split("there:")[1]))


def test_the_lesson_finds_what_stands_in_the_room(server):
    told = run(server, "lesson.py")
    kinds = set(re.findall(r"^(wall|floor|ceiling) ", told, re.M))
    assert {"wall", "floor"} <= kinds
    # The furniture is four boxes, in parts.
    assert number(r"(\d+) clusters", told) >= 3
    assert number(r"icp: converged, (\d+) mm", told) < 20
    assert number(r"m of way, (\d+) mm off", told) < 30
    assert len(re.findall(r"^(?:box|chair|table|shelf) \d+: [\d.]+ at", told, re.M)) >= 3
    assert re.search(r"to \w+ \d+: [\d.]+ m", told)


def test_the_notebook_is_the_script():
    subprocess.run([sys.executable, EXAMPLES / "notebook.py", "--check"], check=True)
