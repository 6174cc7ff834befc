"""A map that is larger than its memory: what does not fit lies on the disk, and nothing of the map is missing."""

from __future__ import annotations

import subprocess

import numpy as np
import pytest
from percept import Client

from support.server import Server, binary

#: Long enough for submaps of 5 m in four rooms that take some megabytes.
DRIVE = ("--duration-s", "240", "--sensors", "lidar2d", "--rooms", "4", "--seed", "5")


def driven(folder, monkeypatch, max_session_memory_mb: int):
    monkeypatch.setenv("PERCEPT_LIMITS_MAX_SESSION_MEMORY_MB", str(max_session_memory_mb))
    server = Server(folder / "data")
    try:
        command = [binary(), "sim", "--server", server.grpc, "--session", "robot", *DRIVE]
        subprocess.run(command, check=True, capture_output=True, timeout=300)
        files = {path.name for path in server.data_dir.iterdir()}
        with Client(server.grpc) as client:
            session = client.session("robot")
            session.map.optimise()
            trajectory = session.trajectory()
            grid, summary = session.map.occupancy(), session.map.summary()
        with Client(server.grpc) as client:
            # Of what was composed some was given up meanwhile.
            assert np.array_equal(client.session("robot").map.occupancy().cells, grid.cells)
        return trajectory, grid, summary, files
    finally:
        server.stop()


def kinds(grid) -> np.ndarray:
    """Unknown, free, open or occupied, as nav2 tells cells apart."""
    return np.digitize(grid.cells, [0, 25, 65])


def test_a_map_that_does_not_fit_into_memory_is_the_same_map(tmp_path, monkeypatch):
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    trajectory, grid, summary, files = driven(tmp_path / "a", monkeypatch, 256)
    small_trajectory, small_grid, small, small_files = driven(tmp_path / "b", monkeypatch, 1)
    assert summary.memory.submaps_bytes > 1 << 20, "the map is too small to tell"
    # What was read last, and what the robot is in, stays.
    assert small.memory.submaps_bytes < 0.75 * summary.memory.submaps_bytes
    assert small.missing_submaps == summary.missing_submaps == ()
    assert np.array_equal(small_trajectory.stamps_ns, trajectory.stamps_ns)
    moved = small_trajectory.positions - trajectory.positions
    assert np.abs(moved).max() == pytest.approx(0.0, abs=1e-12)
    assert small_grid.cells.shape == grid.cells.shape
    # Submaps that lie askew by less than a quarter of a cell are built anew only while they are in memory.
    assert (kinds(small_grid) == kinds(grid)).mean() > 0.99
    assert small_files == files, "what is out of memory has no name"
