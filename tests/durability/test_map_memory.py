"""A map that is larger than its memory: what does not fit lies on the disk, and nothing of the map is missing."""

from __future__ import annotations

import subprocess

import numpy as np
import pytest
from percept import Client

from support.server import Server, binary

#: Long enough for some submaps of 5 m in two rooms.
DRIVE = ("--duration-s", "90", "--sensors", "lidar2d", "--rooms", "2", "--seed", "5")


def driven(folder, monkeypatch, max_map_mb: int):
    monkeypatch.setenv("PERCEPT_LIMITS_MAX_MAP_MB", str(max_map_mb))
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


def test_a_map_that_does_not_fit_into_memory_is_the_same_map(tmp_path, monkeypatch):
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    trajectory, grid, summary, files = driven(tmp_path / "a", monkeypatch, 256)
    small_trajectory, small_grid, small, small_files = driven(tmp_path / "b", monkeypatch, 1)
    assert summary.memory.submaps_bytes > 2 << 20, "the map is too small to tell"
    assert small.memory.submaps_bytes < summary.memory.submaps_bytes / 2
    assert small.missing_submaps == summary.missing_submaps == ()
    assert np.array_equal(small_trajectory.stamps_ns, trajectory.stamps_ns)
    moved = small_trajectory.positions - trajectory.positions
    assert np.abs(moved).max() == pytest.approx(0.0, abs=1e-12)
    assert small_grid.cells.shape == grid.cells.shape
    assert (small_grid.cells == grid.cells).mean() > 0.995
    assert small_files == files, "what is out of memory has no name"
