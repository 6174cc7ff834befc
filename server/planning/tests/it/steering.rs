//! Curves of bounded curvature against closed forms, symmetries and a search by brute force.

use nalgebra::Point2;
use percept_planning::Pose2;
use percept_planning::steering::{Arc, curves, shortest_curve};
use proptest::prelude::*;
use std::f64::consts::{FRAC_PI_2, PI, TAU};

fn pose(x: f64, y: f64, yaw_rad: f64) -> Pose2 {
    Pose2 { position: Point2::new(x, y), yaw_rad }
}

fn apart(a: &Pose2, b: &Pose2) -> f64 {
    let turn = (a.yaw_rad - b.yaw_rad).rem_euclid(TAU);
    (a.position - b.position).norm().max(turn.min(TAU - turn))
}

fn length(from: &Pose2, to: &Pose2, radius: f64, allow_reverse: bool) -> f64 {
    shortest_curve(from, to, radius, allow_reverse).unwrap().length_m()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    #[test]
    fn every_word_ends_at_the_goal_and_goes_back_only_if_allowed(
        start in prop::array::uniform3(-5.0..5.0f64), goal in prop::array::uniform3(-5.0..5.0f64),
        radius in 0.2..3.0f64, allow_reverse in any::<bool>(),
    ) {
        let (start, goal) = (pose(start[0], start[1], start[2]), pose(goal[0], goal[1], goal[2]));
        let found = curves(&start, &goal, radius, allow_reverse);
        prop_assert!(!found.is_empty());
        for curve in found {
            prop_assert!(apart(&curve.end(&start), &goal) < 1e-6, "{curve:?}");
            prop_assert!(allow_reverse || curve.pieces().iter().all(|p| p.length > 0.0), "{curve:?}");
            prop_assert!(curve.length_m() >= (goal.position - start.position).norm() - 1e-9);
        }
    }

    #[test]
    fn the_shortest_curve_is_as_long_there_and_back_mirrored_and_scaled(
        goal in prop::array::uniform3(-4.0..4.0f64), scale in 0.2..3.0f64,
    ) {
        let (start, [x, y, yaw]) = (pose(0.0, 0.0, 0.0), goal);
        let goal = pose(x, y, yaw);
        let here = length(&start, &goal, 1.0, true);
        prop_assert!((length(&goal, &start, 1.0, true) - here).abs() < 1e-6);
        prop_assert!((length(&start, &pose(x, -y, -yaw), 1.0, true) - here).abs() < 1e-6);
        prop_assert!((length(&start, &pose(-x, y, -yaw), 1.0, true) - here).abs() < 1e-6);
        let scaled = pose(scale * x, scale * y, yaw);
        prop_assert!((length(&start, &scaled, scale, true) - scale * here).abs() < 1e-6);
        let forwards = length(&start, &goal, 1.0, false);
        prop_assert!(here <= forwards + 1e-9);
        // Turned round at both ends, what was driven backwards is driven forwards.
        let turned = length(&pose(x, y, yaw + PI), &pose(0.0, 0.0, PI), 1.0, false);
        prop_assert!((turned - forwards).abs() < 1e-6, "{turned} {forwards}");
    }

    /// No curve of up to four random pieces that ends at a pose is shorter than the shortest one to it.
    #[test]
    fn no_other_curve_is_shorter(
        turns in prop::array::uniform4(-1..=1i8), lengths in prop::array::uniform4(-3.0..3.0f64),
    ) {
        let start = pose(0.3, -0.2, 0.7);
        let mut at = start;
        let (mut driven, mut only_forwards) = (0.0, 0.0);
        let mut ahead = start;
        for (turn, length) in turns.iter().zip(lengths) {
            at = Arc { curvature: f64::from(*turn), length }.after(&at, length);
            ahead = Arc { curvature: f64::from(*turn), length }.after(&ahead, length.abs());
            driven += length.abs();
            only_forwards += length.abs();
        }
        prop_assert!(length(&start, &at, 1.0, true) <= driven + 1e-6);
        prop_assert!(length(&start, &ahead, 1.0, false) <= only_forwards + 1e-6);
    }
}

#[test]
fn known_shortest_curves_are_found() {
    let start = pose(0.0, 0.0, 0.0);
    let check = |goal: Pose2, radius: f64, reverse: bool, wanted: f64| {
        let found = length(&start, &goal, radius, reverse);
        assert!((found - wanted).abs() < 1e-9, "{goal:?}: {found}, not {wanted}");
    };
    check(pose(3.0, 0.0, 0.0), 1.0, true, 3.0);
    check(pose(-3.0, 0.0, 0.0), 1.0, true, 3.0);
    check(pose(0.0, 0.0, 0.0), 1.0, true, 0.0);
    check(pose(0.0, 0.0, 0.0), 1.0, false, 0.0);
    check(pose(2.0, 2.0, FRAC_PI_2), 2.0, true, PI);
    check(pose(0.0, 4.0, PI), 2.0, false, TAU);
    // Round on the spot: three arcs of a third of a half turn each, one of them backwards.
    check(pose(0.0, 0.0, PI), 1.0, true, PI);
    // Straight back without going back: Dubins' two circles and the straight piece between.
    let far = 10.0;
    check(pose(-far, 0.0, 0.0), 1.0, false, TAU + far);
    // To the side: two arcs that meet on the line between the circles, half way.
    let side = 2.0 - 3f64.sqrt();
    check(pose(1.0, side, 0.0), 1.0, false, PI / 3.0);
}
