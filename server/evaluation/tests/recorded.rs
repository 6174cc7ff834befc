//! The figures of the tool evo on its own test data; skipped where that is absent.

#![allow(clippy::unwrap_used, clippy::panic, reason = "all of it is tests")]

use percept_evaluation::{Alignment, Delta, Trajectory, TrajectoryParams, score_trajectory};
use percept_geometry::{Stamped, Timestamp, se3};
use std::path::Path;

percept_recorded::tests! {
    freiburg1_xyz_has_the_figures_of_evo: "trajectory-evo";
    monocular_estimates_have_the_figures_of_evo_after_similarity_alignment: "trajectory-evo";
    a_trajectory_against_itself_is_perfect: "trajectory-evo";
}

/// TUM (`seconds x y z qx qy qz qw`) or EuRoC (`nanoseconds,x,y,z,qw,qx,qy,qz,...`) text.
fn read(data: &Path, name: &str) -> Trajectory {
    let text = std::fs::read_to_string(data.join("trajectory-evo").join(name)).unwrap();
    let pose = |line: &str| {
        let euroc = line.contains(',');
        let fields: Vec<&str> = line.split([',', ' ']).filter(|f| !f.is_empty()).collect();
        let v: Vec<f64> = fields[1..8].iter().map(|f| f.trim().parse().unwrap()).collect();
        let (stamp, xyzw) = if euroc {
            (Timestamp(fields[0].parse().unwrap()), [v[4], v[5], v[6], v[3]])
        } else {
            (Timestamp::from_secs_f64(fields[0].parse().unwrap()), [v[3], v[4], v[5], v[6]])
        };
        Stamped { stamp, value: se3::pose_from_parts("pose", [v[0], v[1], v[2]], xyzw).unwrap() }
    };
    let lines = text.lines().map(str::trim).filter(|l| !l.is_empty() && !l.starts_with('#'));
    Trajectory::new(lines.map(pose).collect()).unwrap()
}

/// To the six digits that evo prints.
fn assert_digits(actual: f64, expected: f64) {
    assert!((actual - expected).abs() <= 0.5000001e-6, "{actual:.9} is not {expected:.6}");
}

fn freiburg1_xyz_has_the_figures_of_evo(data: &Path) {
    let (reference, estimate) = (read(data, "freiburg1_xyz-groundtruth.txt"), read(data, "freiburg1_xyz-rgbdslam.txt"));
    let score = score_trajectory(&reference, &estimate, &TrajectoryParams::default()).unwrap();
    assert_digits(score.absolute.translation_m.rmse, 0.013470);
    assert_digits(score.absolute.translation_m.mean, 0.012024);
    assert_digits(score.absolute.translation_m.max, 0.034760);
    assert_digits(score.relative.unwrap().translation_m.rmse, 0.005764);
    let free = TrajectoryParams { alignment: Alignment::None, ..TrajectoryParams::default() };
    let unaligned = score_trajectory(&reference, &estimate, &free).unwrap();
    assert_digits(unaligned.relative.unwrap().translation_m.rmse, 0.005764);
    assert!(unaligned.absolute.translation_m.rmse > score.absolute.translation_m.rmse);
}

fn monocular_estimates_have_the_figures_of_evo_after_similarity_alignment(data: &Path) {
    for (reference, estimate, rmse) in
        [("fr2_desk_groundtruth.txt", "fr2_desk_ORB.txt", 0.006123), ("V102_groundtruth.csv", "V102.txt", 0.083841)]
    {
        let (reference, estimate) = (read(data, reference), read(data, estimate));
        let params = TrajectoryParams { alignment: Alignment::Sim3, ..TrajectoryParams::default() };
        let score = score_trajectory(&reference, &estimate, &params).unwrap();
        assert_digits(score.absolute.translation_m.rmse, rmse);
        assert_eq!(score.absolute.similarity.rank, 3);
    }
}

fn a_trajectory_against_itself_is_perfect(data: &Path) {
    let reference = read(data, "freiburg1_xyz-groundtruth.txt");
    let params = TrajectoryParams { delta: Delta::Metres(1.0), ..TrajectoryParams::default() };
    let score = score_trajectory(&reference, &reference, &params).unwrap();
    assert!(score.absolute.translation_m.max < 1e-9 && score.absolute.rotation_deg.max < 1e-5);
    assert!(score.relative.unwrap().translation_m.max < 1e-9);
    assert!(score.end_drift_percent.unwrap() < 1e-9 && score.segment_drift.is_none());
}
