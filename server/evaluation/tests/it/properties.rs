//! What holds for every trajectory.

use percept_evaluation::{Alignment, Delta, EvaluationError, Trajectory, TrajectoryParams, score_trajectory};
use percept_geometry::{Pose, Stamped, Timestamp, se3};
use proptest::prelude::*;

fn trajectories() -> impl Strategy<Value = (Trajectory, Trajectory)> {
    let pose = (1i64..30, prop::array::uniform6(-0.3..0.3f64), prop::array::uniform6(-0.2..0.2f64));
    prop::collection::vec(pose, 3..25).prop_map(|steps| {
        let (mut stamp, mut reference, mut estimate) = (0, Vec::new(), Vec::new());
        for (i, (wait, xi, noise)) in steps.into_iter().enumerate() {
            stamp += wait * 1_000_000;
            // Along a parabola, so that the positions always span a plane.
            let x = i as f64;
            let truth = Pose::translation(x, 0.3 * x * x, 0.0) * se3::exp(&xi.into());
            reference.push(Stamped { stamp: Timestamp(stamp), value: truth });
            estimate.push(Stamped { stamp: Timestamp(stamp), value: truth * se3::exp(&noise.into()) });
        }
        (Trajectory::new(reference).unwrap(), Trajectory::new(estimate).unwrap())
    })
}

fn params(alignment: Alignment) -> TrajectoryParams {
    TrajectoryParams { alignment, ..TrajectoryParams::default() }
}

fn moved(trajectory: &Trajectory, t: &Pose) -> Trajectory {
    let pose = |p: &Stamped<Pose>| Stamped { stamp: p.stamp, value: t * p.value };
    Trajectory::new(trajectory.poses().iter().map(pose).collect()).unwrap()
}

proptest! {
    #[test]
    fn more_freedom_of_alignment_never_hurts((reference, estimate) in trajectories()) {
        let rmse = |a| score_trajectory(&reference, &estimate, &params(a)).unwrap().absolute.translation_m.rmse;
        prop_assert!(rmse(Alignment::Se3) <= rmse(Alignment::None) + 1e-9);
        prop_assert!(rmse(Alignment::Sim3) <= rmse(Alignment::Se3) + 1e-9);
    }

    #[test]
    fn the_frame_of_the_estimate_does_not_matter((reference, estimate) in trajectories(), xi in prop::array::uniform6(-2.0..2.0f64)) {
        let other = moved(&estimate, &se3::exp(&xi.into()));
        let a = score_trajectory(&reference, &estimate, &params(Alignment::Se3)).unwrap();
        let b = score_trajectory(&reference, &other, &params(Alignment::Se3)).unwrap();
        prop_assert!((a.absolute.translation_m.rmse - b.absolute.translation_m.rmse).abs() < 1e-9);
        prop_assert!((a.absolute.rotation_deg.mean - b.absolute.rotation_deg.mean).abs() < 1e-4);
        let (ra, rb) = (a.relative.unwrap(), b.relative.unwrap());
        prop_assert!((ra.translation_m.max - rb.translation_m.max).abs() < 1e-9);
        let (da, db) = (a.end_drift_percent.unwrap(), b.end_drift_percent.unwrap());
        prop_assert!((da - db).abs() < 1e-6 * (1.0 + da));
    }

    #[test]
    fn the_part_of_a_trajectory_that_is_there_is_compared((reference, estimate) in trajectories(), keep in 1usize..25) {
        let part: Vec<Stamped<Pose>> = estimate.poses().iter().take(keep).cloned().collect();
        let expected = part.len();
        let score = score_trajectory(&reference, &Trajectory::new(part).unwrap(), &params(Alignment::Se3)).unwrap();
        prop_assert_eq!(score.num_pairs, expected);
        prop_assert_eq!(score.relative.is_none(), expected < 2);
        prop_assert!(score.reference_length_m <= reference.path_length_m() + 1e-9);
    }
}

#[test]
fn a_body_at_rest_has_no_drift_and_no_scale() {
    let still = Trajectory::new(vec![Stamped { stamp: Timestamp(0), value: Pose::identity() }; 3]).unwrap();
    let score = score_trajectory(&still, &still, &TrajectoryParams::default()).unwrap();
    assert_eq!((score.end_drift_percent, score.absolute.translation_m.rmse), (None, 0.0));
    let bad = TrajectoryParams { delta: Delta::Metres(-1.0), ..TrajectoryParams::default() };
    assert!(matches!(score_trajectory(&still, &still, &bad), Err(EvaluationError::InvalidParam { .. })));
    let scaled = params(Alignment::Sim3);
    assert_eq!(score_trajectory(&still, &still, &scaled), Err(EvaluationError::ScaleUndetermined));
}
