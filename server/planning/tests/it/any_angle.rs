//! Legs at any angle.

use crate::worlds::{distance_to_obstacles, world};
use crate::{hall, path};
use nalgebra::Point2;
use percept_planning::{PathRequest, PlanOutcome, PlanParams, Planner, plan_dense, plan_path};

#[test]
fn paths_at_any_angle_are_never_dearer_than_those_over_cells_and_as_clear() {
    for smooth in [false, true] {
        for weight in [0.0, 3.0] {
            let params =
                PlanParams { start_tolerance_m: 0.0, smooth, clearance_weight: weight, ..PlanParams::default() };
            let mut shorter = 0;
            for seed in 0..60 {
                let (grid, [start, goal]) = world(seed);
                let request = PathRequest { planner: Planner::AnyAngle, ..PathRequest::new(start, goal, &params) };
                let by_cells = plan_dense(&grid, start, goal, &params).unwrap();
                let (any, by_cells) = match (plan_path(&grid, &request).unwrap(), by_cells) {
                    (PlanOutcome::Path(any), PlanOutcome::Path(by_cells)) => (any, by_cells),
                    (any, by_cells) => {
                        assert_eq!(any, by_cells);
                        continue;
                    }
                };
                assert!(any.cost <= by_cells.cost * (1.0 + 1e-12), "world {seed}: {} {}", any.cost, by_cells.cost);
                if weight == 0.0 {
                    assert!(any.length_m <= by_cells.length_m * (1.0 + 1e-9), "world {seed}");
                }
                shorter += usize::from(any.cost < by_cells.cost * 0.99);
                for leg in any.waypoints.windows(2) {
                    for i in 0..=40 {
                        let p = leg[0].position + (leg[1].position - leg[0].position) * (f64::from(i) / 40.0);
                        assert!(distance_to_obstacles(&grid, &p) >= params.robot_radius_m - 1e-6, "world {seed}");
                    }
                }
            }
            assert!(smooth || shorter >= 15, "{shorter} shorter");
        }
    }
}

#[test]
fn an_open_hall_is_one_leg() {
    let params = PlanParams { smooth: false, clearance_weight: 0.0, ..PlanParams::default() };
    let (start, goal) = (Point2::new(1.05, 1.05), Point2::new(6.05, 3.05));
    let request = PathRequest { planner: Planner::AnyAngle, ..PathRequest::new(start, goal, &params) };
    let grid = hall(80, 50);
    let PlanOutcome::Path(found) = plan_path(&grid, &request).unwrap() else { panic!("no path") };
    assert!((found.length_m - 29f64.sqrt()).abs() < 1e-9, "{}", found.length_m);
    let by_cells = path(&grid, start.into(), goal.into(), &params);
    assert!((by_cells.length_m - (3.0 + 8f64.sqrt())).abs() < 1e-9, "30 cells straight and 20 diagonally");
}
