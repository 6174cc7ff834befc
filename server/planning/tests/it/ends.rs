use crate::{drawn, hall, path, reason};
use nalgebra::Point2;
use percept_geometry::GridGeometry;
use percept_mapping::{DenseGrid, MappingError, OccupancyGrid, OccupancyParams};
use percept_planning::{NoPathReason, PlanError, PlanOutcome, PlanParams, plan, plan_dense};

#[test]
fn an_open_hall_is_crossed_straight_from_exactly_start_to_exactly_goal() {
    let (start, goal) = ([1.013, 1.027], [6.031, 3.044]);
    let found = path(&hall(80, 50), start, goal, &PlanParams::default());
    assert_eq!(found.waypoints[0].position, Point2::from(start));
    assert_eq!(found.waypoints.last().unwrap().position, Point2::from(goal));
    let straight = (Point2::from(goal) - Point2::from(start)).norm();
    assert!((found.length_m - straight).abs() < 1e-3 * straight, "{} for {straight}", found.length_m);
    assert!((found.waypoints[0].yaw_rad - (goal[1] - start[1]).atan2(goal[0] - start[0])).abs() < 0.02);
    let nearest = 1.013 - 0.1;
    assert!((found.min_clearance_m.unwrap() - nearest).abs() < 1e-9);
}

#[test]
fn start_and_goal_in_one_place_is_a_path_without_length() {
    let found = path(&hall(50, 50), [2.0, 2.0], [2.0, 2.0], &PlanParams::default());
    assert_eq!((found.length_m, found.waypoints.len()), (0.0, 2));
}

#[test]
fn each_bad_end_is_told_apart() {
    let mut grid = hall(50, 50);
    (20..30).for_each(|y| (20..30).for_each(|x| grid.cells[y * 50 + x] = 100));
    (35..45).for_each(|y| (5..15).for_each(|x| grid.cells[y * 50 + x] = -1));
    let params = PlanParams { start_tolerance_m: 0.2, ..PlanParams::default() };
    let (free, block, unseen, outside) = ([1.0, 1.0], [2.5, 2.5], [1.0, 4.0], [-0.01, 1.0]);
    assert_eq!(reason(&grid, outside, free, &params), NoPathReason::StartOutsideMap);
    assert_eq!(reason(&grid, free, outside, &params), NoPathReason::GoalOutsideMap);
    assert_eq!(reason(&grid, block, free, &params), NoPathReason::StartOccupied);
    assert_eq!(reason(&grid, free, block, &params), NoPathReason::GoalOccupied);
    assert_eq!(reason(&grid, unseen, free, &params), NoPathReason::StartUnknown);
    assert_eq!(reason(&grid, free, unseen, &params), NoPathReason::GoalUnknown);
    assert_eq!(reason(&grid, free, [3.15, 2.5], &params), NoPathReason::GoalDoesNotFit, "0.15 m from the block");
    assert_eq!(reason(&grid, free, [1.6, 4.0], &params), NoPathReason::GoalDoesNotFit, "0.1 m from the unknown");
    let brave = PlanParams { allow_unknown: true, ..params };
    assert!(path(&grid, unseen, free, &brave).length_m >= 3.0);
    assert!(path(&grid, free, unseen, &brave).length_m >= 3.0);
}

#[test]
fn a_closed_room_is_unreachable_and_a_door_lets_in_who_fits() {
    let mut grid = hall(60, 40);
    (0..40).for_each(|y| grid.cells[y * 60 + 30] = 100);
    let params = PlanParams::default();
    assert_eq!(reason(&grid, [1.0, 2.0], [5.0, 2.0], &params), NoPathReason::Unreachable);
    for (door, radius, fits) in [(5, 0.25, true), (5, 0.26, false), (1, 0.05, true), (1, 0.06, false), (1, 0.0, true)] {
        let mut grid = grid.clone();
        (20..20 + door).for_each(|y| grid.cells[y * 60 + 30] = 0);
        let params = PlanParams { robot_radius_m: radius, ..params };
        let outcome = plan_dense(&grid, Point2::new(1.0, 2.0), Point2::new(5.0, 2.0), &params).unwrap();
        match outcome {
            PlanOutcome::Path(p) => {
                assert!(fits && p.min_clearance_m.unwrap() >= radius - 1e-6, "{door} {radius} {p:?}")
            }
            PlanOutcome::NoPath { reason, .. } => {
                assert!(!fits, "{door} {radius}");
                assert_eq!(reason, NoPathReason::Unreachable);
            }
        }
    }
}

#[test]
fn a_robot_that_stands_too_near_a_wall_gets_away_without_going_nearer() {
    let grid = hall(50, 50);
    let start = [0.25, 2.5];
    let found = path(&grid, start, [4.0, 2.5], &PlanParams::default());
    assert!((found.min_clearance_m.unwrap() - 0.15).abs() < 1e-9, "{:?}", found.min_clearance_m);
    let strict = PlanParams { start_tolerance_m: 0.0, ..PlanParams::default() };
    assert_eq!(reason(&grid, [0.15, 2.5], [4.0, 2.5], &strict), NoPathReason::StartDoesNotFit);
}

#[test]
fn the_unseen_ground_under_the_robot_does_not_hold_it() {
    let rows = [
        "####################",
        "#??????............#",
        "#?????.............#",
        "#????..............#",
        "#???...............#",
        "#??????............#",
        "#??????............#",
        "#???...............#",
        "#????..............#",
        "#?????.............#",
        "#??????............#",
        "####################",
    ];
    let grid = drawn(&rows);
    let found = path(&grid, [0.55, 0.6], [1.5, 0.6], &PlanParams { start_tolerance_m: 0.6, ..PlanParams::default() });
    assert!(found.length_m < 1.2);
}

#[test]
fn the_way_keeps_off_the_wall_when_there_is_room() {
    // Around the end of a wall: the shortest way would graze it.
    let mut grid = hall(80, 60);
    (0..40).for_each(|y| grid.cells[y * 80 + 40] = 100);
    let with = path(&grid, [3.0, 1.0], [5.0, 1.0], &PlanParams::default());
    let without = path(&grid, [3.0, 1.0], [5.0, 1.0], &PlanParams { clearance_weight: 0.0, ..PlanParams::default() });
    assert!(with.min_clearance_m.unwrap() > without.min_clearance_m.unwrap() + 0.1, "{with:?} {without:?}");
    assert!(without.min_clearance_m.unwrap() >= 0.22);
    assert!(without.length_m <= with.length_m);
    // No sharp corner is left.
    let turn = with
        .waypoints
        .windows(2)
        .map(|w| percept_geometry::se3::wrap_angle(w[1].yaw_rad - w[0].yaw_rad).abs())
        .fold(0.0, f64::max);
    assert!(turn < 0.8, "{turn}");
}

#[test]
fn work_is_bounded_and_bad_requests_are_named() {
    let grid = hall(50, 50);
    let (a, b) = (Point2::new(1.0, 1.0), Point2::new(4.0, 4.0));
    let params = PlanParams::default();
    let limited = PlanParams { max_expansions: 5, ..params };
    assert_eq!(reason(&grid, [1.0, 1.0], [4.0, 4.0], &limited), NoPathReason::SearchLimit);
    let small = PlanParams { max_cells: 2499, ..params };
    assert_eq!(plan_dense(&grid, a, b, &small), Err(PlanError::GridTooLarge { cells: 2500, limit: 2499 }));
    assert!(plan_dense(&grid, a, b, &PlanParams { max_cells: 2500, ..params }).is_ok());
    let nan = plan_dense(&grid, Point2::new(f64::NAN, 0.0), b, &params);
    assert!(matches!(nan, Err(PlanError::NotFinite { field: "start", .. })));
    let bad = PlanParams { robot_radius_m: 0.6, ..params };
    assert!(matches!(plan_dense(&grid, a, b, &bad), Err(PlanError::InvalidParam { field: "inflation_radius_m", .. })));
    let lying = DenseGrid { width: 49, ..grid };
    assert!(matches!(plan_dense(&lying, a, b, &params), Err(PlanError::Map(MappingError::GridShape { .. }))));
}

#[test]
fn a_grid_with_negative_coordinates_and_another_origin_plans_in_the_map_frame() {
    let mut dense = hall(50, 50);
    dense.geometry = GridGeometry::new(0.1, Point2::new(-7.03, 100.01));
    let grid = OccupancyGrid::from_dense(&dense, OccupancyParams::default()).unwrap();
    let (a, b) = (Point2::new(-6.0, 101.0), Point2::new(-3.0, 104.0));
    let PlanOutcome::Path(found) = plan(&grid, a, b, &PlanParams::default()).unwrap() else { panic!("no path") };
    assert!((found.length_m - 18f64.sqrt()).abs() < 0.01);
    let empty = OccupancyGrid::new(OccupancyParams::default()).unwrap();
    let outcome = plan(&empty, a, b, &PlanParams::default()).unwrap();
    assert_eq!(outcome, PlanOutcome::NoPath { reason: NoPathReason::StartOutsideMap, blocking: None });
}
