//! Where to look next.

use crate::worlds::distance_to_obstacles;
use crate::{drawn, hall, path};
use nalgebra::Point2;
use percept_planning::{PlanError, PlanParams, frontiers, rank_frontiers};

#[test]
fn frontiers_that_can_be_reached_are_found_the_nearest_first() {
    // Two rooms; the left one is open to the unseen at its top and far bottom, the right one cannot be entered.
    let mut rows = vec![format!("#{}#{}#", "?".repeat(29), "?".repeat(20)); 3];
    rows.extend(vec![format!("#{}#{}#", ".".repeat(29), ".".repeat(20)); 24]);
    rows.push(format!("#{}??????{}#{}#", ".".repeat(20), ".".repeat(3), ".".repeat(20)));
    rows.push("#".repeat(52));
    let grid = drawn(&rows.iter().map(String::as_str).collect::<Vec<_>>());
    let (start, params) = (Point2::new(2.25, 0.95), PlanParams { start_tolerance_m: 0.0, ..PlanParams::default() });
    let found = frontiers(&grid, start, &params, 3).unwrap();
    assert_eq!(found.len(), 2, "{found:?}");
    // Beside the six unseen cells of the bottom row: eight above them, and one at either end.
    assert_eq!(found.iter().map(|f| f.cells.len()).collect::<Vec<_>>(), [10, 29]);
    assert!(found[0].cost <= found[1].cost);
    for frontier in &found {
        let goal = frontier.goal;
        assert!(distance_to_obstacles(&grid, &goal) >= params.robot_radius_m - 1e-6);
        let nearest = frontier.cells.iter().map(|c| (c - goal).norm()).fold(f64::INFINITY, f64::min);
        assert!(nearest <= params.robot_radius_m + 0.3, "{nearest}");
        assert!(path(&grid, start.into(), goal.into(), &params).length_m <= frontier.cost * 1.01 + 0.2);
    }
    assert_eq!(frontiers(&grid, start, &params, 11).unwrap().len(), 1);
    // Of 1 and 2.9 m, the larger one farther off: it comes first once a metre of it is worth as much of the way.
    let sizes = |gain: f64| {
        let mut ranked = found.clone();
        rank_frontiers(&mut ranked, gain).unwrap();
        ranked.iter().map(|f| (10.0 * f.size_m).round() as i32).collect::<Vec<_>>()
    };
    let apart = (found[1].cost - found[0].cost) / (found[1].size_m - found[0].size_m);
    assert!(apart > 0.0, "{apart}");
    assert_eq!((sizes(0.0), sizes(0.9 * apart), sizes(1.1 * apart)), (vec![10, 29], vec![10, 29], vec![29, 10]));
    assert!(matches!(rank_frontiers(&mut [], f64::NAN), Err(PlanError::InvalidParam { field: "gain", .. })));
    assert_eq!(frontiers(&grid, Point2::new(-1.0, 0.0), &params, 1).unwrap(), []);
}

#[test]
fn a_map_without_unknown_cells_has_no_frontier() {
    let params = PlanParams::default();
    assert_eq!(frontiers(&hall(40, 40), Point2::new(2.0, 2.0), &params, 1).unwrap(), []);
    let nan = frontiers(&hall(40, 40), Point2::new(f64::NAN, 2.0), &params, 1);
    assert!(matches!(nan, Err(PlanError::NotFinite { field: "start", .. })));
}
