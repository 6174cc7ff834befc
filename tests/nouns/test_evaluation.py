"""Metrics against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from percept import InvalidArgument, LabelledBox, OrientedBox, PerceptError, Pose

N = 50
STAMPS = np.arange(N, dtype=np.int64) * 100_000_000


def circle():
    """(N, 4, 4): a circle of 2 m with the heading along it."""
    out = []
    for a in np.linspace(0, 3, N):
        out.append(Pose.from_yaw(2 * np.cos(a), 2 * np.sin(a), a + np.pi / 2).matrix)
    return np.array(out)


def test_a_moved_trajectory_has_no_error_once_aligned(client):
    moved = Pose.from_yaw(3, -2, 1.0, z_m=0.5).matrix @ circle()
    metrics = client.evaluation.trajectory((STAMPS, circle()), estimate=(STAMPS, moved))
    assert metrics.num_pairs == N
    assert metrics.ate_m.rmse == pytest.approx(0, abs=1e-9)
    assert metrics.rpe_trans_m.rmse == pytest.approx(0, abs=1e-9)
    assert metrics.scale == 1
    chord = 2 * 2 * np.sin(3 / (N - 1) / 2)
    assert metrics.path_length_m == pytest.approx((N - 1) * chord)


def test_a_shift_is_an_error_without_alignment(client):
    shifted = circle()
    shifted[:, 0, 3] += 0.3
    metrics = client.evaluation.trajectory((STAMPS, circle()), estimate=(STAMPS, shifted), alignment="none")
    for value in (metrics.ate_m.rmse, metrics.ate_m.mean, metrics.ate_m.median, metrics.ate_m.max):
        assert value == pytest.approx(0.3)
    assert metrics.ate_m.std == pytest.approx(0, abs=1e-9)


def test_scale_is_found_by_sim3_alone(client):
    scaled = circle()
    scaled[:, :3, 3] *= 0.5
    sim3 = client.evaluation.trajectory((STAMPS, circle()), estimate=(STAMPS, scaled), alignment="sim3")
    se3 = client.evaluation.trajectory((STAMPS, circle()), estimate=(STAMPS, scaled), alignment="se3")
    assert sim3.ate_m.rmse == pytest.approx(0, abs=1e-9)
    assert sim3.scale == pytest.approx(2.0)
    assert se3.ate_m.rmse > 0.1


def test_stamps_that_do_not_meet_are_refused(client):
    with pytest.raises(PerceptError) as error:
        client.evaluation.trajectory((STAMPS, circle()), estimate=(STAMPS + 10**12, circle()))
    assert error.value.code in ("INVALID_ARGUMENT", "FAILED_PRECONDITION")
    with pytest.raises(InvalidArgument, match="reference stamps"):
        client.evaluation.trajectory((STAMPS / 1e9, circle()), estimate=(STAMPS, circle()))


def test_a_session_is_judged_against_truth(client, laser_session):
    from support import world

    estimate = laser_session.trajectory()
    truth = np.array(world.truth_in_map(world.drive(len(estimate))))
    metrics = client.evaluation.trajectory((estimate.stamps_ns, truth), estimate=estimate)
    assert metrics.num_pairs == 30
    assert metrics.ate_m.rmse < 0.02


def box(x, size=1.0, label="box", confidence=0.0):
    pose = Pose(np.array([x, 0.0, size / 2]))
    size_m = np.full(3, size)
    return LabelledBox(
        object_class=label, box=OrientedBox(t_frame_box=pose, size_m=size_m), confidence=confidence
    )


def test_boxes_are_matched_by_overlap_and_counted(client):
    truth = [box(0), box(3), box(6, label="chair")]
    found = [
        box(0, confidence=0.9),
        box(3.5, confidence=0.8),
        box(6, confidence=0.7),
        box(20, confidence=0.9),
    ]
    metrics = client.evaluation.detections(truth, detections=found)
    assert (metrics.true_positives, metrics.false_positives, metrics.false_negatives) == (3, 1, 0)
    assert (metrics.precision, metrics.recall) == (pytest.approx(0.75), pytest.approx(1.0))
    # Half a metre off: 0.5 shared of 1.5.
    assert metrics.mean_iou == pytest.approx((1 + 1 / 3 + 1) / 3)
    assert metrics.class_accuracy == pytest.approx(2 / 3)
    strict = client.evaluation.detections(truth, detections=found, min_iou=0.5)
    assert (strict.true_positives, strict.false_positives, strict.false_negatives) == (2, 2, 1)
