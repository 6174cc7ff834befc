"""Recorded pose graphs: as low a chi2 as any solver is known to reach, from whatever start, and proven so."""

from __future__ import annotations

import json
import subprocess

import pytest

from support.server import binary, recorded

#: Best known chi2, by g2o's definition of the error.
BEST = {
    "intel": 45.0047,
    "MIT": 41.1633,
    "manhattan": 3549.04,
    "smallGrid3D": 458.154,
    "parking-garage": 1.2387,
    "sphere2500": 727.15,
}


def optimised(path, *more):
    done = subprocess.run(
        [binary(), "eval", "graph", path, "--json", *more], check=True, capture_output=True, text=True
    )
    return json.loads(done.stdout)


@pytest.mark.parametrize("name", BEST)
def test_a_recorded_graph_is_explained_as_well_as_is_known(name, tmp_path):
    folder = recorded("posegraph")
    if folder is None:
        pytest.skip("recorded data is not there")
    out = tmp_path / "optimised.g2o"
    report = optimised(folder / f"{name}.g2o", "--out", out)
    assert report["converged"]
    assert report["certified"]
    assert report["chi2"] == pytest.approx(BEST[name], rel=1e-3)
    # What was written is where it began.
    assert optimised(out)["chi2_start"] == pytest.approx(report["chi2"], rel=1e-6)
