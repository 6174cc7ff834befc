"""`percept eval` has the figures of the tool evo on its own test data, to the six digits that it prints."""

from __future__ import annotations

import json
import subprocess

import numpy as np
import pytest

from support.server import binary, recorded

REFERENCES = {
    "freiburg1_xyz-rgbdslam.txt": "freiburg1_xyz-groundtruth.txt",
    "freiburg1_xyz-rgbdslam_drift.txt": "freiburg1_xyz-groundtruth.txt",
    "fr2_desk_ORB.txt": "fr2_desk_groundtruth.txt",
    "V102.txt": "V102_groundtruth.csv",
}
# evo 1.38.1: evo_ape and evo_rpe with -a (se3), -as (sim3) or --align_origin, -d DELTA -u UNIT, --all_pairs.
# rmse, mean and max of APE translation (m), APE rotation (deg), RPE translation (m), RPE rotation (deg).
FIGURES = [
    (
        "freiburg1_xyz-rgbdslam.txt",
        "se3",
        "1",
        "frames",
        False,
        [0.01347, 0.012024, 0.03476],
        [2.0577, 2.024695, 3.639591],
        [0.005764, 0.004816, 0.020866],
        [0.353613, 0.300307, 1.633296],
    ),
    (
        "freiburg1_xyz-rgbdslam.txt",
        "se3",
        "10",
        "frames",
        False,
        [0.01347, 0.012024, 0.03476],
        [2.0577, 2.024695, 3.639591],
        [0.01461, 0.012477, 0.043154],
        [0.701571, 0.628792, 1.593853],
    ),
    (
        "freiburg1_xyz-rgbdslam.txt",
        "se3",
        "10",
        "frames",
        True,
        [0.01347, 0.012024, 0.03476],
        [2.0577, 2.024695, 3.639591],
        [0.014041, 0.012023, 0.048023],
        [0.674778, 0.589748, 1.722177],
    ),
    (
        "freiburg1_xyz-rgbdslam.txt",
        "se3",
        "0.5",
        "m",
        False,
        [0.01347, 0.012024, 0.03476],
        [2.0577, 2.024695, 3.639591],
        [0.024082, 0.02258, 0.034115],
        [0.909862, 0.859777, 1.450724],
    ),
    (
        "freiburg1_xyz-rgbdslam.txt",
        "se3",
        "0.5",
        "m",
        True,
        [0.01347, 0.012024, 0.03476],
        [2.0577, 2.024695, 3.639591],
        [0.024811, 0.022371, 0.053937],
        [1.048276, 0.916749, 3.033853],
    ),
    (
        "freiburg1_xyz-rgbdslam.txt",
        "se3",
        "5",
        "deg",
        False,
        [0.01347, 0.012024, 0.03476],
        [2.0577, 2.024695, 3.639591],
        [0.014841, 0.013028, 0.030429],
        [0.714737, 0.616805, 1.412087],
    ),
    (
        "freiburg1_xyz-rgbdslam.txt",
        "se3",
        "5",
        "deg",
        True,
        [0.01347, 0.012024, 0.03476],
        [2.0577, 2.024695, 3.639591],
        [0.016533, 0.01472, 0.050646],
        [0.809994, 0.710881, 2.678202],
    ),
    (
        "freiburg1_xyz-rgbdslam_drift.txt",
        "se3",
        "1",
        "frames",
        False,
        [0.01347, 0.012025, 0.03476],
        [2.057702, 2.024698, 3.639637],
        [0.005764, 0.004816, 0.020865],
        [0.353614, 0.300308, 1.633284],
    ),
    (
        "freiburg1_xyz-rgbdslam_drift.txt",
        "se3",
        "10",
        "frames",
        False,
        [0.01347, 0.012025, 0.03476],
        [2.057702, 2.024698, 3.639637],
        [0.01461, 0.012477, 0.043155],
        [0.701577, 0.628797, 1.593892],
    ),
    (
        "freiburg1_xyz-rgbdslam_drift.txt",
        "se3",
        "10",
        "frames",
        True,
        [0.01347, 0.012025, 0.03476],
        [2.057702, 2.024698, 3.639637],
        [0.014041, 0.012023, 0.048023],
        [0.674779, 0.58975, 1.722246],
    ),
    (
        "freiburg1_xyz-rgbdslam_drift.txt",
        "se3",
        "0.5",
        "m",
        False,
        [0.01347, 0.012025, 0.03476],
        [2.057702, 2.024698, 3.639637],
        [0.024082, 0.022581, 0.034115],
        [0.909836, 0.859752, 1.450691],
    ),
    (
        "freiburg1_xyz-rgbdslam_drift.txt",
        "se3",
        "0.5",
        "m",
        True,
        [0.01347, 0.012025, 0.03476],
        [2.057702, 2.024698, 3.639637],
        [0.024811, 0.022371, 0.053938],
        [1.048279, 0.916752, 3.033881],
    ),
    (
        "freiburg1_xyz-rgbdslam_drift.txt",
        "se3",
        "5",
        "deg",
        False,
        [0.01347, 0.012025, 0.03476],
        [2.057702, 2.024698, 3.639637],
        [0.014841, 0.013028, 0.030429],
        [0.714733, 0.616801, 1.412133],
    ),
    (
        "freiburg1_xyz-rgbdslam_drift.txt",
        "se3",
        "5",
        "deg",
        True,
        [0.01347, 0.012025, 0.03476],
        [2.057702, 2.024698, 3.639637],
        [0.016533, 0.01472, 0.050646],
        [0.810006, 0.710886, 2.678218],
    ),
    (
        "freiburg1_xyz-rgbdslam_drift.txt",
        "sim3",
        "0.5",
        "m",
        False,
        [0.013389, 0.011987, 0.034846],
        [2.057702, 2.024698, 3.639637],
        [0.02466, 0.023367, 0.036498],
        [0.959249, 0.908081, 1.613479],
    ),
    (
        "freiburg1_xyz-rgbdslam_drift.txt",
        "sim3",
        "0.5",
        "m",
        True,
        [0.013389, 0.011987, 0.034846],
        [2.057702, 2.024698, 3.639637],
        [0.024454, 0.022112, 0.052305],
        [1.041666, 0.911782, 3.033881],
    ),
    (
        "freiburg1_xyz-rgbdslam_drift.txt",
        "origin",
        "1",
        "frames",
        False,
        [0.019368, 0.017349, 0.042177],
        [0.691038, 0.619983, 1.758827],
        [0.005764, 0.004816, 0.020865],
        [0.353614, 0.300308, 1.633284],
    ),
    (
        "fr2_desk_ORB.txt",
        "sim3",
        "1",
        "frames",
        False,
        [0.006123, 0.005586, 0.021477],
        [0.989036, 0.959473, 2.024871],
        [0.003485, 0.00303, 0.020908],
        [0.280519, 0.229556, 1.259404],
    ),
    (
        "fr2_desk_ORB.txt",
        "sim3",
        "10",
        "frames",
        False,
        [0.006123, 0.005586, 0.021477],
        [0.989036, 0.959473, 2.024871],
        [0.006248, 0.005424, 0.020927],
        [0.420645, 0.354345, 1.479956],
    ),
    (
        "fr2_desk_ORB.txt",
        "sim3",
        "10",
        "frames",
        True,
        [0.006123, 0.005586, 0.021477],
        [0.989036, 0.959473, 2.024871],
        [0.005844, 0.005167, 0.022172],
        [0.395902, 0.337938, 1.651198],
    ),
    (
        "fr2_desk_ORB.txt",
        "sim3",
        "0.5",
        "m",
        False,
        [0.006123, 0.005586, 0.021477],
        [0.989036, 0.959473, 2.024871],
        [0.009446, 0.008755, 0.021005],
        [0.607135, 0.535392, 1.341995],
    ),
    (
        "fr2_desk_ORB.txt",
        "sim3",
        "0.5",
        "m",
        True,
        [0.006123, 0.005586, 0.021477],
        [0.989036, 0.959473, 2.024871],
        [0.008901, 0.008237, 0.02213],
        [0.521598, 0.466854, 1.761977],
    ),
    (
        "fr2_desk_ORB.txt",
        "sim3",
        "5",
        "deg",
        False,
        [0.006123, 0.005586, 0.021477],
        [0.989036, 0.959473, 2.024871],
        [0.00675, 0.005982, 0.020908],
        [0.425949, 0.367332, 1.200402],
    ),
    (
        "fr2_desk_ORB.txt",
        "sim3",
        "5",
        "deg",
        True,
        [0.006123, 0.005586, 0.021477],
        [0.989036, 0.959473, 2.024871],
        [0.007755, 0.007033, 0.023446],
        [0.467263, 0.405263, 2.257501],
    ),
    (
        "V102.txt",
        "sim3",
        "1",
        "frames",
        False,
        [0.083841, 0.074841, 0.226652],
        [2.716771, 2.308505, 9.911251],
        [0.014711, 0.006023, 0.213029],
        [0.357616, 0.089876, 4.939155],
    ),
    (
        "V102.txt",
        "sim3",
        "10",
        "frames",
        False,
        [0.083841, 0.074841, 0.226652],
        [2.716771, 2.308505, 9.911251],
        [0.055485, 0.043414, 0.213285],
        [1.294371, 0.60175, 8.264775],
    ),
    (
        "V102.txt",
        "sim3",
        "10",
        "frames",
        True,
        [0.083841, 0.074841, 0.226652],
        [2.716771, 2.308505, 9.911251],
        [0.053807, 0.042289, 0.217471],
        [1.129583, 0.568077, 8.264775],
    ),
    (
        "V102.txt",
        "sim3",
        "0.5",
        "m",
        False,
        [0.083841, 0.074841, 0.226652],
        [2.716771, 2.308505, 9.911251],
        [0.03961, 0.027835, 0.215272],
        [1.01942, 0.374496, 8.789553],
    ),
    (
        "V102.txt",
        "sim3",
        "0.5",
        "m",
        True,
        [0.083841, 0.074841, 0.226652],
        [2.716771, 2.308505, 9.911251],
        [0.037295, 0.026149, 0.218556],
        [1.107978, 0.455303, 8.264775],
    ),
    (
        "V102.txt",
        "sim3",
        "5",
        "deg",
        False,
        [0.083841, 0.074841, 0.226652],
        [2.716771, 2.308505, 9.911251],
        [0.021969, 0.011351, 0.213376],
        [0.598657, 0.170919, 5.445312],
    ),
    (
        "V102.txt",
        "sim3",
        "5",
        "deg",
        True,
        [0.083841, 0.074841, 0.226652],
        [2.716771, 2.308505, 9.911251],
        [0.11292, 0.084326, 0.444502],
        [3.469374, 2.200782, 13.216055],
    ),
]
# What the data's own readme names: APE rmse after the alignment said there, RPE over one frame.
NAMED = [
    ("freiburg1_xyz-rgbdslam.txt", "se3", "ate_m", "rmse", 0.013470),
    ("freiburg1_xyz-rgbdslam.txt", "se3", "ate_m", "mean", 0.012024),
    ("freiburg1_xyz-rgbdslam.txt", "se3", "ate_m", "max", 0.034760),
    ("freiburg1_xyz-rgbdslam.txt", "se3", "rpe_trans_m", "rmse", 0.005764),
    ("fr2_desk_ORB.txt", "sim3", "ate_m", "rmse", 0.006123),
    ("V102.txt", "sim3", "ate_m", "rmse", 0.083841),
]


@pytest.fixture(scope="module")
def folder():
    found = recorded("trajectory-evo")
    if found is None:
        pytest.skip("recorded data is not there")
    return found


def evaluate(folder, estimate, *arguments):
    command = [binary(), "eval", "trajectory", folder / REFERENCES[estimate], folder / estimate, "--json"]
    done = subprocess.run([*command, *arguments], capture_output=True, text=True, timeout=60, check=True)
    return json.loads(done.stdout)


def assert_digits(actual, expected):
    assert abs(actual - expected) <= 1.0000001e-6 / 2, f"{actual:.9f} is not {expected:.6f}"


@pytest.mark.parametrize(("estimate", "align", "metric", "statistic", "expected"), NAMED)
def test_named_figures(folder, estimate, align, metric, statistic, expected):
    assert_digits(evaluate(folder, estimate, "--align", align)[metric][statistic], expected)


@pytest.mark.parametrize("row", FIGURES, ids=lambda row: "-".join(str(v) for v in row[:5]))
def test_figures_of_evo(folder, row):
    estimate, align, delta, unit, all_pairs, *expected = row
    arguments = ["--align", align, "--delta", delta, "--delta-unit", unit, *["--all-pairs"] * all_pairs]
    score = evaluate(folder, estimate, *arguments)
    for metric, figures in zip(("ate_m", "ate_rot_deg", "rpe_trans_m", "rpe_rot_deg"), expected, strict=True):
        for statistic, figure in zip(("rmse", "mean", "max"), figures, strict=True):
            assert_digits(score[metric][statistic], figure)


def test_the_server_has_the_figures_of_the_command(client, folder):
    def read(name):
        rows = np.loadtxt(folder / name)
        return (rows[:, 0] * 1e9).astype(np.int64), rows[:, 1:]

    estimate = "freiburg1_xyz-rgbdslam.txt"
    expected = evaluate(folder, estimate, "--delta", "0.5", "--delta-unit", "m")
    metrics = client.evaluation.trajectory(
        read(REFERENCES[estimate]), estimate=read(estimate), delta=0.5, delta_unit="metres", return_pairs=True
    )
    assert metrics.ate_m.rmse == pytest.approx(expected["ate_rmse_m"], abs=1e-6)
    assert metrics.rpe_trans_m.rmse == pytest.approx(expected["rpe_trans_rmse_m"], abs=1e-6)
    assert len(metrics.pairs) == expected["pairs"]


def test_raw_odometry_by_the_relations_of_intel(tmp_path):
    folder = recorded("lidar2d-intel")
    if folder is None:
        pytest.skip("recorded data is not there")
    out = tmp_path / "odometry.tum"
    with (folder / "intel.clf").open(errors="replace") as log, out.open("w") as tum:
        for line in log:
            if line.startswith("FLASER"):
                words = line.split()
                x, y, yaw, stamp = (words[2 + int(words[1]) + i] for i in (3, 4, 5, 6))
                half = float(yaw) / 2
                tum.write(f"{stamp} {x} {y} 0 0 0 {np.sin(half):.9f} {np.cos(half):.9f}\n")
    command = [binary(), "eval", "relations", out, folder / "intel.relations", "--json"]
    score = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
    # By an independent script over the same files.
    assert (score["relations"], score["missed"], score["loops"]) == (2984, 0, 1210)
    assert score["trans_mean_m"] == pytest.approx(7.37024, abs=1e-4)
    assert score["trans_std_m"] == pytest.approx(14.34912, abs=1e-4)
    assert score["rot_mean_deg"] == pytest.approx(39.1663, abs=1e-3)
    assert score["rot_std_deg"] == pytest.approx(53.79055, abs=1e-3)
