use crate::hall;
use nalgebra::Point2;
use percept_geometry::Cell;
use percept_mapping::DenseGrid;
use percept_planning::{NoPathReason, PlanOutcome, PlanParams, plan_dense};

/// Brute force: distance from a point to the nearest square that is occupied, unknown or outside, metres.
pub(crate) fn distance_to_obstacles(grid: &DenseGrid, p: &Point2<f64>) -> f64 {
    let r = grid.geometry.resolution_m;
    let (width, height) = (grid.width as i32, grid.height as i32);
    let mut nearest = f64::INFINITY;
    for y in -1..=height {
        for x in -1..=width {
            let cell = Cell::new(x, y);
            if grid.value(cell).is_some_and(|v| v.is_some_and(|v| v < 70)) {
                continue;
            }
            let low = grid.geometry.corner(cell);
            let gap = |v: f64, low: f64| (low - v).max(v - low - r).max(0.0);
            nearest = nearest.min(gap(p.x, low.x).hypot(gap(p.y, low.y)));
        }
    }
    nearest
}

/// Small generator (Knuth's MMIX constants), so that the worlds are the same everywhere.
pub(crate) struct Random(pub(crate) u64);

impl Random {
    pub(crate) fn below(&mut self, n: usize) -> usize {
        self.0 = self.0.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (self.0 >> 33) as usize % n
    }
}

pub(crate) fn world(seed: u64) -> (DenseGrid, [Point2<f64>; 2]) {
    let mut random = Random(seed.wrapping_mul(0x9E3779B97F4A7C15) + 1);
    let (width, height) = (50, 40);
    let mut grid = hall(width, height);
    for _ in 0..8 + random.below(12) {
        let (x, y) = (random.below(width), random.below(height));
        let (w, h) = if random.below(2) == 0 { (1 + random.below(25), 1) } else { (1, 1 + random.below(25)) };
        let value = if random.below(5) == 0 { -1 } else { 100 };
        for y in y..(y + h).min(height) {
            (x..(x + w).min(width)).for_each(|x| grid.cells[y * width + x] = value);
        }
    }
    let mut free_point = || loop {
        let p = Point2::new(random.below(4999) as f64 / 1000.0, random.below(3999) as f64 / 1000.0);
        if distance_to_obstacles(&grid, &p) >= 0.3 {
            return p;
        }
    };
    let ends = [free_point(), free_point()];
    (grid, ends)
}

/// Brute force: whether a walk over cell centres at least `needed` from every obstacle joins the two cells.
fn joined(grid: &DenseGrid, ends: &[Point2<f64>; 2], needed: f64) -> bool {
    let open: Vec<bool> = (0..grid.cells.len())
        .map(|i| {
            let center = grid.geometry.center(Cell::new((i % grid.width) as i32, (i / grid.width) as i32));
            distance_to_obstacles(grid, &center) >= needed
        })
        .collect();
    let index = |p: &Point2<f64>| grid.index(grid.geometry.cell(p).unwrap()).unwrap();
    let (mut stack, mut seen) = (vec![index(&ends[0])], vec![false; open.len()]);
    while let Some(i) = stack.pop() {
        if open[i] && !std::mem::replace(&mut seen[i], true) {
            // The hall's walls are never open, so that neighbours exist.
            stack.extend([i - 1, i + 1, i - grid.width, i + grid.width]);
        }
    }
    seen[index(&ends[1])]
}

#[test]
fn paths_in_a_hundred_worlds_clear_every_obstacle_and_are_found_if_there_is_one() {
    let params = PlanParams { start_tolerance_m: 0.0, ..PlanParams::default() };
    let needed = params.robot_radius_m;
    let (mut found, mut none) = (0, 0);
    for seed in 0..100 {
        let (grid, ends) = world(seed);
        match plan_dense(&grid, ends[0], ends[1], &params).unwrap() {
            PlanOutcome::NoPath { reason, .. } => {
                none += 1;
                assert_eq!(reason, NoPathReason::Unreachable, "world {seed}");
                assert!(!joined(&grid, &ends, needed), "world {seed}");
            }
            PlanOutcome::Path(path) => {
                found += 1;
                assert!(joined(&grid, &ends, needed), "world {seed}");
                assert_eq!(path.waypoints[0].position, ends[0]);
                assert_eq!(path.waypoints[path.waypoints.len() - 1].position, ends[1]);
                let mut nearest = f64::INFINITY;
                for leg in path.waypoints.windows(2) {
                    let (a, b) = (leg[0].position, leg[1].position);
                    assert!((b - a).norm() <= params.waypoint_spacing_m * 2.5, "world {seed}");
                    for i in 0..=20 {
                        nearest = nearest.min(distance_to_obstacles(&grid, &(a + (b - a) * (f64::from(i) / 20.0))));
                    }
                }
                assert!(nearest >= params.robot_radius_m - 1e-9, "world {seed}: {nearest}");
                let told = path.min_clearance_m.unwrap();
                assert!(told <= nearest + 1e-9 && told >= nearest - 0.01, "world {seed}: {told}, {nearest}");
            }
        }
    }
    assert!(found >= 30 && none >= 10, "{found} paths, {none} without");
}

#[test]
fn smoothing_never_costs_more_than_the_cells_path() {
    for seed in 0..40 {
        let (grid, [start, goal]) = world(seed);
        let smooth = plan_dense(&grid, start, goal, &PlanParams::default()).unwrap();
        let rough = plan_dense(&grid, start, goal, &PlanParams { smooth: false, ..PlanParams::default() }).unwrap();
        match (smooth, rough) {
            (PlanOutcome::Path(smooth), PlanOutcome::Path(rough)) => {
                // Half-cell samples fall elsewhere on resampled legs.
                assert!(smooth.cost <= rough.cost * 1.02, "world {seed}: {} {}", smooth.cost, rough.cost);
            }
            (smooth, rough) => assert_eq!(smooth, rough),
        }
    }
}
