//! Paths that a robot steers.

use crate::checker::{check, overlaps};
use crate::exhaustive::Exhaustive;
use crate::worlds::world;
use crate::{drawn, hall};
use nalgebra::Point2;
use percept_mapping::DenseGrid;
use percept_planning::{
    Footprint, Goal, HybridParams, NoPathReason, PathRequest, PlanError, PlanOutcome, PlanParams, Planner, Pose2,
    plan_path,
};
use std::f64::consts::{FRAC_PI_2, PI};
use std::sync::atomic::{AtomicUsize, Ordering};

const BOX: [[f64; 2]; 4] = [[0.3, 0.2], [-0.3, 0.2], [-0.3, -0.2], [0.3, -0.2]];

fn polygon(corners: &[[f64; 2]]) -> Footprint {
    Footprint::Polygon(corners.iter().map(|c| Point2::from(*c)).collect())
}

fn pose(x: f64, y: f64, yaw_rad: f64) -> Pose2 {
    Pose2 { position: Point2::new(x, y), yaw_rad }
}

fn steer(grid: &DenseGrid, start: Pose2, goal: Pose2, hybrid: HybridParams) -> PlanOutcome {
    let params = PlanParams { start_tolerance_m: 0.0, max_expansions: 200_000, ..PlanParams::default() };
    let footprint = polygon(&BOX);
    let request = PathRequest {
        start,
        goal: Goal { position: goal.position, yaw_rad: Some(goal.yaw_rad) },
        planner: Planner::Hybrid(hybrid),
        footprint: Some(&footprint),
        ..PathRequest::new(start.position, goal.position, &params)
    };
    plan_path(grid, &request).unwrap()
}

#[test]
fn steered_paths_in_many_worlds_fit_turn_no_tighter_and_meet_both_headings() {
    let (mut found, mut reversed) = (0, 0);
    for seed in 0..60 {
        let (grid, [start, goal]) = world(seed);
        let yaw = |k: u64| (seed * k % 17) as f64 * 0.37 - PI;
        let (start, goal) = (pose(start.x, start.y, yaw(5)), pose(goal.x, goal.y, yaw(7)));
        let hybrid = HybridParams { turning_radius_m: 0.5, allow_reverse: seed % 3 != 0, ..HybridParams::default() };
        match steer(&grid, start, goal, hybrid) {
            PlanOutcome::Path(path) => {
                found += 1;
                let (first, last) = (path.waypoints[0], path.waypoints[path.waypoints.len() - 1]);
                assert_eq!((first.position, last.position), (start.position, goal.position));
                let off = |a: f64, b: f64| percept_geometry::se3::wrap_angle(a - b).abs();
                assert!(off(first.yaw_rad, start.yaw_rad) < 1e-9 && off(last.yaw_rad, goal.yaw_rad) < 1e-6);
                let reverse = check(&grid, &BOX, &path, hybrid.turning_radius_m);
                assert!(hybrid.allow_reverse || !reverse, "world {seed}");
                reversed += usize::from(reverse);
            }
            PlanOutcome::NoPath { .. } => {}
        }
    }
    assert!(found >= 12 && reversed >= 3, "{found} found, {reversed} with reverse");
}

#[test]
fn paths_are_within_three_per_cent_of_the_shortest_that_an_exhaustive_search_finds() {
    let (mut compared, mut bent) = (0, 0);
    for seed in 0..40 {
        let (grid, [start, goal]) = world(seed);
        let yaw = |k: u64| (seed * k % 17) as f64 * 0.37 - PI;
        let (start, goal) = (pose(start.x, start.y, yaw(5)), pose(goal.x, goal.y, yaw(7)));
        let exhaustive = Exhaustive {
            grid: &grid,
            half: [0.3, 0.2],
            turning_radius_m: 0.5,
            allow_reverse: true,
            cell_m: 0.05,
            num_headings: 72,
            max_expansions: 4000,
        };
        if !exhaustive.fits(&start) || !exhaustive.fits(&goal) {
            continue;
        }
        let shortest = exhaustive.search(start, goal);
        let (Some(length), true) = (shortest.length_m, shortest.is_done) else { continue };
        // Length alone counts.
        let hybrid = HybridParams {
            turning_radius_m: 0.5,
            reverse_cost: 1.0,
            turning_cost: 1.0,
            direction_change_cost_m: 0.0,
            refine_expansions: 20_000,
            ..HybridParams::default()
        };
        let params = PlanParams { start_tolerance_m: 0.0, clearance_weight: 0.0, ..PlanParams::default() };
        let footprint = polygon(&BOX);
        let request = PathRequest {
            start,
            goal: Goal { position: goal.position, yaw_rad: Some(goal.yaw_rad) },
            planner: Planner::Hybrid(hybrid),
            footprint: Some(&footprint),
            ..PathRequest::new(start.position, goal.position, &params)
        };
        let PlanOutcome::Path(path) = plan_path(&grid, &request).unwrap() else { panic!("world {seed}: {length} m") };
        check(&grid, &BOX, &path, 0.5);
        assert!(path.length_m <= 1.03 * length, "world {seed}: {} {length}", path.length_m);
        compared += 1;
        bent += usize::from(shortest.expansions > 20);
    }
    assert!(compared >= 10 && bent >= 3, "{compared}, {bent} with something in the way");
}

#[test]
fn in_the_open_the_path_is_the_shortest_curve() {
    let grid = hall(120, 120);
    let (start, goal) = (pose(3.0, 6.0, 0.0), pose(9.0, 6.0, 0.0));
    let PlanOutcome::Path(found) = steer(&grid, start, goal, HybridParams::default()) else { panic!("no path") };
    assert!((found.length_m - 6.0).abs() < 1e-6, "{}", found.length_m);
    // An eighth of a turn, the way between the circles' centres, an eighth of a turn.
    let goal = pose(5.8, 8.8, FRAC_PI_2);
    let PlanOutcome::Path(found) = steer(&grid, start, goal, HybridParams::default()) else { panic!("no path") };
    let wanted = 8f64.sqrt() + 0.8 * FRAC_PI_2;
    assert!((found.length_m - wanted).abs() < 1e-6, "{}", found.length_m);
}

#[test]
fn a_dead_end_is_left_backwards_or_not_at_all() {
    // A corridor 0.6 m wide, closed at its right end; the robot is 0.6 m long and 0.4 m wide.
    let mut rows = vec!["#".repeat(50); 22];
    (8..14).for_each(|i| rows[i] = format!("#{}{}", ".".repeat(40), "#".repeat(9)));
    (1..21).for_each(|i| rows[i].replace_range(1..21, &".".repeat(20)));
    let rows: Vec<&str> = rows.iter().map(String::as_str).collect();
    let grid = drawn(&rows);
    let (start, goal) = (pose(3.7, 1.1, 0.0), pose(1.0, 1.1, 0.0));
    let PlanOutcome::Path(found) = steer(&grid, start, goal, HybridParams::default()) else { panic!("no path") };
    assert!(check(&grid, &BOX, &found, 0.8));
    assert!((found.length_m - 2.7).abs() < 1e-3, "straight back: {}", found.length_m);
    let forwards = HybridParams { allow_reverse: false, ..HybridParams::default() };
    let outcome = steer(&grid, start, goal, forwards);
    assert_eq!(outcome, PlanOutcome::NoPath { reason: NoPathReason::NotSteerable, blocking: None });
}

#[test]
fn a_long_robot_fits_through_a_gap_along_but_its_disc_does_not() {
    // A gap of 0.5 m: wider than the robot's 0.4 m, narrower than the 0.72 m of the disc that holds it.
    let mut grid = hall(60, 40);
    (0..40).filter(|y| !(18..23).contains(y)).for_each(|y| (29..31).for_each(|x| grid.cells[y * 60 + x] = 100));
    let (start, goal) = (pose(1.5, 2.05, 0.0), pose(4.5, 2.05, 0.0));
    let PlanOutcome::Path(found) = steer(&grid, start, goal, HybridParams::default()) else { panic!("no path") };
    check(&grid, &BOX, &found, 0.8);
    let (params, footprint) = (PlanParams::default(), polygon(&BOX));
    let request = PathRequest::new(start.position, goal.position, &params);
    let as_disc = plan_path(&grid, &PathRequest { footprint: Some(&footprint), ..request }).unwrap();
    assert!(matches!(as_disc, PlanOutcome::NoPath { .. }), "planned for as a disc");
}

#[test]
fn without_a_goal_heading_any_will_do() {
    let grid = hall(80, 80);
    let (params, footprint) = (PlanParams::default(), polygon(&BOX));
    let start = pose(2.0, 4.0, 0.0);
    let request = PathRequest {
        start,
        goal: Goal { position: Point2::new(5.0, 5.0), yaw_rad: None },
        planner: Planner::Hybrid(HybridParams::default()),
        footprint: Some(&footprint),
        ..PathRequest::new(start.position, start.position, &params)
    };
    let PlanOutcome::Path(found) = plan_path(&grid, &request).unwrap() else { panic!("no path") };
    check(&grid, &BOX, &found, 0.8);
    assert!(found.length_m < 10f64.sqrt() * 1.1, "{}", found.length_m);
}

#[test]
fn the_caller_can_stop_the_search_and_the_same_question_has_the_same_answer() {
    let (grid, start, goal) = (hall(80, 80), pose(2.0, 4.0, 0.0), pose(5.0, 5.0, 2.0));
    let asked = AtomicUsize::new(0);
    let stop = || {
        asked.fetch_add(1, Ordering::Relaxed);
        true
    };
    // Two walls 0.4 m apart, with gaps of 0.4 m that do not face each other: wide enough for the disc within the robot.
    let mut closed = grid.clone();
    (0..80).filter(|y| !(38..42).contains(y)).for_each(|y| closed.cells[y * 80 + 35] = 100);
    (0..80).filter(|y| !(50..54).contains(y)).for_each(|y| closed.cells[y * 80 + 40] = 100);
    let (params, footprint) = (PlanParams { start_tolerance_m: 0.0, ..PlanParams::default() }, polygon(&BOX));
    let request = PathRequest {
        start,
        goal: Goal { position: goal.position, yaw_rad: Some(goal.yaw_rad) },
        planner: Planner::Hybrid(HybridParams::default()),
        footprint: Some(&footprint),
        stop: Some(&stop),
        ..PathRequest::new(start.position, goal.position, &params)
    };
    let outcome = plan_path(&closed, &request).unwrap();
    assert_eq!(outcome, PlanOutcome::NoPath { reason: NoPathReason::Stopped, blocking: None });
    assert_eq!(asked.load(Ordering::Relaxed), 1);
    let hybrid = HybridParams::default();
    assert_eq!(steer(&grid, start, goal, hybrid), steer(&grid, start, goal, hybrid));
}

#[test]
fn the_checker_tells_an_overlap_from_a_touch() {
    let grid = hall(50, 50);
    // The wall's inner edge is at 0.1 m.
    assert!(!overlaps(&grid, &BOX, &pose(0.4, 2.0, 0.0)));
    assert!(overlaps(&grid, &BOX, &pose(0.39, 2.0, 0.0)));
    assert!(!overlaps(&grid, &BOX, &pose(0.31, 2.0, FRAC_PI_2)));
}

#[test]
fn footprints_that_make_no_sense_are_refused_by_what_is_wrong() {
    let refused = |footprint: Footprint| match footprint.validate() {
        Err(PlanError::InvalidParam { field, value, .. }) => (field, value),
        other => panic!("{footprint:?}: {other:?}"),
    };
    for radius_m in [0.0, -1.0, f64::NAN, 100.1] {
        let (field, value) = refused(Footprint::Disc { radius_m });
        assert_eq!((field, value.to_bits()), ("footprint.radius_m", radius_m.to_bits()));
    }
    assert_eq!(refused(polygon(&[[1.0, 0.0], [0.0, 1.0]])), ("footprint.polygon", 2.0));
    assert_eq!(refused(polygon(&[[1.0, 1.0], [-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0]])), ("footprint.polygon", 0.0));
    assert!(refused(polygon(&[[f64::NAN, 1.0], [-1.0, 0.0], [0.0, -1.0]])).1.is_nan());
    assert_eq!(refused(polygon(&[[101.0, 0.0], [-1.0, 1.0], [-1.0, -1.0]])).1, 101.0);
    assert_eq!(refused(polygon(&[[2.0, 0.0], [1.0, 1.0], [1.0, -1.0]])), ("footprint.polygon", 1.0), "base outside");
    assert_eq!(refused(polygon(&[[1.0, 0.0], [-1.0, 0.0], [0.5, 0.0]])).0, "footprint.polygon", "flat");
    assert_eq!(Footprint::rectangle(0.9, 0.6).validate(), Ok(()));
    assert_eq!(Footprint::Disc { radius_m: 100.0 }.validate(), Ok(()));
    // An L, with the base on its inner corner.
    let bent = [[1.0, -1.0], [1.0, 0.0], [0.0, 0.0], [0.0, 1.0], [-1.0, 1.0], [-1.0, -1.0]];
    assert_eq!(polygon(&bent).validate(), Ok(()));
    assert_eq!(polygon(&bent).inscribed_radius_m(), 0.0);
    assert_eq!(Footprint::rectangle(0.8, 0.6).circumscribed_radius_m(), 0.5);
    let (params, bad) = (PlanParams::default(), Footprint::Disc { radius_m: 0.0 });
    let request = PathRequest::new(Point2::new(1.0, 1.0), Point2::new(2.0, 2.0), &params);
    let outcome = plan_path(&hall(50, 50), &PathRequest { footprint: Some(&bad), ..request });
    assert!(matches!(outcome, Err(PlanError::InvalidParam { field: "footprint.radius_m", .. })));
}
