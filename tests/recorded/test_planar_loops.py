"""A building driven through again and again with a planar lidar: relative poses that were checked by hand."""

from __future__ import annotations

import json
import subprocess

import pytest

from support.server import binary, recorded


def test_a_map_with_loops_has_every_place_where_it_was_seen_before(tmp_path):
    folder = recorded("lidar2d-intel")
    if folder is None:
        pytest.skip("recorded data is not there")

    def percept(*words):
        done = subprocess.run([binary(), *words, "--json"], check=True, capture_output=True)
        return json.loads(done.stdout)

    report = percept("replay", folder, "--out", tmp_path)
    assert report["tracked"] == report["frames"] == 13631
    assert report["loops"] > 100
    score = percept("eval", "relations", tmp_path / "trajectory.tum", folder / "intel.relations")
    assert (score["relations"], score["missed"]) == (2984, 0)
    assert score["trans_mean_m"] < 0.03
    assert score["rot_mean_deg"] < 1.0
