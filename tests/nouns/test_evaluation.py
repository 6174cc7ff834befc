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
        out.append(Pose.from_xy_yaw(2 * np.cos(a), 2 * np.sin(a), a + np.pi / 2).matrix)
    return np.array(out)


def test_a_moved_trajectory_has_no_error_once_aligned(client):
    moved = Pose.from_xyz(3, -2, 0.5, yaw_rad=1.0).matrix @ circle()
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


def test_first_poses_are_laid_onto_each_other_by_origin_alignment(client):
    moved = Pose.from_xy_yaw(3, -2, 1.0).matrix @ circle()
    metrics = client.evaluation.trajectory((STAMPS, circle()), estimate=(STAMPS, moved), alignment="origin")
    assert metrics.ate_m.max == pytest.approx(0, abs=1e-9)
    assert metrics.t_reference_estimate.matrix @ moved[0] == pytest.approx(circle()[0])


@pytest.mark.parametrize(
    ("delta", "unit", "all_pairs"),
    [
        (7, "frames", False),
        (7, "frames", True),
        (1, "metres", False),
        (0.5, "seconds", False),
        (20, "degrees", False),
    ],
)
def test_a_drift_of_a_hundredth_is_one_over_every_stretch(client, delta, unit, all_pairs):
    scaled = circle()
    scaled[:, :3, 3] *= 1.01
    metrics = client.evaluation.trajectory(
        (STAMPS, circle()), estimate=(STAMPS, scaled), delta=delta, delta_unit=unit, all_pairs=all_pairs
    )
    chord = 2 * 2 * np.sin(3 / (N - 1) / 2)
    stretch = {"frames": 7, "metres": np.ceil(1 / chord / 1.01), "seconds": 5, "degrees": 6}[unit]
    expected = 0.01 * 2 * 2 * np.sin(3 / (N - 1) * stretch / 2)
    assert metrics.rpe_trans_m.rmse == pytest.approx(expected, rel=1e-6)
    assert metrics.rpe_rot_deg.max == pytest.approx(0, abs=1e-5)


def test_a_stretch_longer_than_the_path_has_no_error(client):
    metrics = client.evaluation.trajectory((STAMPS, circle()), estimate=(STAMPS, circle()), delta=100)
    assert metrics.rpe_trans_m is None
    assert metrics.rpe_rot_deg is None
    for delta, unit in ((0.5, "frames"), (0, "metres"), (-1, "seconds"), (181, "degrees")):
        with pytest.raises(InvalidArgument):
            client.evaluation.trajectory((STAMPS, circle()), estimate=(STAMPS, circle()), delta=delta, delta_unit=unit)


def test_drift_over_segments_is_that_put_in(client):
    straight = np.tile(np.eye(4), (400, 1, 1))
    straight[:, 0, 3] = np.arange(400)
    longer = straight.copy()
    longer[:, 0, 3] *= 1.02
    stamps = np.arange(400, dtype=np.int64) * 100_000_000
    metrics = client.evaluation.trajectory((stamps, straight), estimate=(stamps, longer))
    # A segment ends at the first pose beyond its length: 101 m for 100 m.
    assert metrics.segment_drift.translation_percent == pytest.approx(2.0, abs=0.03)
    assert metrics.segment_drift.rotation_deg_per_m == pytest.approx(0, abs=1e-9)
    short = client.evaluation.trajectory((STAMPS, circle()), estimate=(STAMPS, circle()))
    assert short.segment_drift is None
    tenths = client.evaluation.trajectory((STAMPS, circle()), estimate=(STAMPS, circle()), segment_lengths_m=[1.0, 2.0])
    assert tenths.segment_drift.num_segments > 0


def test_an_offset_of_stamps_is_taken_out(client):
    late = STAMPS + 50_000_000
    metrics = client.evaluation.trajectory(
        (STAMPS, circle()), estimate=(late, circle()), estimate_offset_s=-0.05, return_pairs=True
    )
    assert metrics.num_pairs == N
    assert metrics.ate_m.max == pytest.approx(0, abs=1e-9)
    assert metrics.pairs.stamps_ns.tolist() == STAMPS.tolist()
    assert metrics.pairs.estimate == pytest.approx(metrics.pairs.reference, abs=1e-9)


def test_a_plot_shows_what_was_compared(client, tmp_path):
    pytest.importorskip("matplotlib")
    from percept import plot

    metrics = client.evaluation.trajectory((STAMPS, circle()), estimate=(STAMPS, circle()), return_pairs=True)
    plot.trajectories(metrics).savefig(tmp_path / "plot.png")
    assert (tmp_path / "plot.png").stat().st_size > 10_000
    bare = client.evaluation.trajectory((STAMPS, circle()), estimate=(STAMPS, circle()))
    with pytest.raises(ValueError, match="return_pairs"):
        plot.trajectories(bare)


def test_relations_are_judged_without_a_common_frame(client):
    poses = circle()
    # Forwards and backwards, the last over a wrong motion of 0.1 m.
    first, second = np.array([0, 20, 5]), np.array([10, 3, 40])
    motions = np.array([np.linalg.inv(poses[a]) @ poses[b] for a, b in zip(first, second, strict=True)])
    motions[2, 0, 3] += 0.1
    moved = Pose.from_xy_yaw(3, -2, 1.0).matrix @ poses
    relations = (STAMPS[first], STAMPS[second], motions)
    metrics = client.evaluation.relations((STAMPS, moved), relations=relations)
    assert (metrics.num_relations, metrics.num_missed, metrics.num_loops) == (3, 0, 0)
    assert metrics.translation_m.mean == pytest.approx(0.1 / 3)
    assert metrics.translation_m.max == pytest.approx(0.1)
    assert metrics.rotation_deg.max == pytest.approx(0, abs=1e-5)
    assert metrics.loop_translation_m is None
    part = client.evaluation.relations((STAMPS[:15], moved[:15]), relations=relations)
    assert (part.num_relations, part.num_missed) == (1, 2)
    with pytest.raises(InvalidArgument):
        client.evaluation.relations((STAMPS, moved), relations=relations, max_gap_s=0)


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
    pose = Pose.from_xyz(x, 0.0, size / 2)
    size_m = np.full(3, size)
    return LabelledBox(object_class=label, box=OrientedBox(t_frame_box=pose, size_m=size_m), confidence=confidence)


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
