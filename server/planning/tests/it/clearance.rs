use crate::hall;
use nalgebra::Point2;
use percept_geometry::{Cell, clearance_in_cells};
use percept_planning::{Costmap, PlanParams};
use proptest::prelude::*;

proptest! {
    #[test]
    fn the_distance_transform_is_exact(
        width in 1..25usize, height in 1..25usize, share in 0..4u32, seed in prop::collection::vec(0..100u32, 625),
    ) {
        let blocked: Vec<bool> = (0..width * height).map(|i| seed[i] < [1, 5, 30, 100][share as usize]).collect();
        let found = clearance_in_cells(&blocked, width, height);
        for (i, found) in found.iter().map(|v| f64::from(*v)).enumerate() {
            let gap = |a: usize, b: usize| (a.abs_diff(b) as f64 - 0.5).max(0.0);
            let expected = (0..blocked.len()).filter(|j| blocked[*j])
                .map(|j| gap(i % width, j % width).hypot(gap(i / width, j / width)))
                .fold(f64::INFINITY, f64::min);
            prop_assert!(found == expected || (found - expected).abs() < 1e-5,
                "{} at {i}, not {expected}", found);
        }
    }

    #[test]
    fn the_clearance_of_a_segment_is_exact(
        ends in prop::array::uniform4(0.5..4.5f64), boxes in prop::collection::vec((1..49usize, 1..49usize), 0..30),
        limit in prop::sample::select(vec![0.2, 1.0, f64::INFINITY]),
    ) {
        let mut grid = hall(50, 50);
        boxes.iter().for_each(|(x, y)| grid.cells[y * 50 + x] = 100);
        let (a, b) = (Point2::new(ends[0], ends[1]), Point2::new(ends[2], ends[3]));
        let costmap = Costmap::new(&grid, &a, &PlanParams::default());
        let found = costmap.segment_clearance(&a, &b, limit);
        // Densely sampled, never below the truth and above it by less than half the step.
        let steps = 400;
        let sampled = (0..=steps).map(|i| {
            let p = a + (b - a) * (f64::from(i) / f64::from(steps));
            crate::worlds::distance_to_obstacles(&grid, &p)
        }).fold(f64::INFINITY, f64::min);
        let slack = 0.5 * (b - a).norm() / f64::from(steps);
        prop_assert!(found <= sampled.min(limit) + 1e-9, "{found} > {sampled}");
        prop_assert!(found >= (sampled - slack).min(limit) - 1e-9, "{found} < {sampled}");
    }
}

#[test]
fn cost_falls_with_clearance_and_ends_at_the_inflation_radius() {
    let params = PlanParams::default();
    let costmap = Costmap::new(&hall(40, 40), &Point2::new(2.0, 2.0), &params);
    let factor = |x: i32| costmap.factors()[20 * costmap.width() + x as usize];
    // Column 0 is the rim, 1 the wall; column x has its centre (x - 1.5) * 0.1 m from the wall's edge.
    assert!((costmap.clearance_m(Cell::new(4, 20)).unwrap() - 0.25).abs() < 1e-6);
    assert!((f64::from(factor(4)) - (1.0 + 3.0 * (-5.0f64 * (0.25 - 0.22)).exp())).abs() < 1e-5);
    assert!(factor(4) > factor(5) && factor(5) > factor(6));
    assert_eq!(factor(7), 1.0);
}
