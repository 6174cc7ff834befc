//! Paths that cover: by samples of the path, without the planner's own account.

use crate::worlds::{Random, distance_to_obstacles};
use crate::{drawn, hall};
use nalgebra::Point2;
use percept_geometry::Cell;
use percept_mapping::DenseGrid;
use percept_planning::coverage::{CoverageDirection, CoverageLegKind};
use percept_planning::{
    CoverageOutcome, CoverageParams, CoveragePath, NoPathReason, PathRequest, PlanError, PlanParams, plan_coverage,
};

fn params() -> PlanParams {
    PlanParams { robot_radius_m: 0.2, start_tolerance_m: 0.0, ..PlanParams::default() }
}

fn covered(grid: &DenseGrid, start: Point2<f64>, coverage: &CoverageParams) -> CoveragePath {
    let params = params();
    match plan_coverage(grid, &PathRequest::new(start, start, &params), coverage).unwrap() {
        CoverageOutcome::Path(path) => path,
        CoverageOutcome::NoPath { reason, .. } => panic!("no path: {reason:?}"),
    }
}

/// Centres of cells where the robot fits, joined to the start's over such cells.
fn reached(grid: &DenseGrid, start: Point2<f64>) -> Vec<Point2<f64>> {
    let center = |i: usize| grid.geometry.center(Cell::new((i % grid.width) as i32, (i / grid.width) as i32));
    let open: Vec<bool> = (0..grid.cells.len()).map(|i| fits(grid, &center(i))).collect();
    let (mut stack, mut seen) =
        (vec![grid.index(grid.geometry.cell(&start).unwrap()).unwrap()], vec![false; open.len()]);
    while let Some(i) = stack.pop() {
        if open[i] && !std::mem::replace(&mut seen[i], true) {
            stack.extend([i - 1, i + 1, i - grid.width, i + grid.width]);
        }
    }
    (0..seen.len()).filter(|i| seen[*i]).map(center).collect()
}

/// Share of the free cells that a disc of this radius touches from anywhere that is reached, which it touches from the path.
fn share(grid: &DenseGrid, start: Point2<f64>, path: &CoveragePath, radius: f64) -> f64 {
    let touched = |legs: &[[Point2<f64>; 2]]| {
        let mut out = vec![false; grid.cells.len()];
        for [a, b] in legs {
            let reach = nalgebra::Vector2::repeat(radius + grid.geometry.resolution_m);
            let low = grid.geometry.cell(&(a.inf(b) - reach)).unwrap();
            let high = grid.geometry.cell(&(a.sup(b) + reach)).unwrap();
            for cell in (low.y..=high.y).flat_map(|y| (low.x..=high.x).map(move |x| Cell::new(x, y))) {
                let Some(index) = grid.index(cell).filter(|i| grid.cells[*i] == 0) else { continue };
                let (p, along) = (grid.geometry.center(cell), b - a);
                let share = ((p - a).dot(&along) / along.norm_squared().max(1e-12)).clamp(0.0, 1.0);
                out[index] |= (a + along * share - p).norm() <= radius + 1e-6;
            }
        }
        out
    };
    let legs: Vec<_> = path.path.waypoints.windows(2).map(|leg| [leg[0].position, leg[1].position]).collect();
    let places: Vec<_> = reached(grid, start).into_iter().map(|p| [p, p]).collect();
    let (wanted, done) = (touched(&places), touched(&legs));
    let num = wanted.iter().filter(|w| **w).count();
    wanted.iter().zip(done).filter(|(wanted, done)| **wanted && *done).count() as f64 / num as f64
}

fn clear(grid: &DenseGrid, path: &CoveragePath) {
    for leg in path.path.waypoints.windows(2) {
        let (a, b) = (leg[0].position, leg[1].position);
        let steps = ((b - a).norm() / 0.02).ceil().max(1.0);
        for i in 0..=steps as usize {
            let p = a + (b - a) * (i as f64 / steps);
            assert!(fits(grid, &p), "{p}");
        }
    }
}

/// Whether a disc of 0.2 m touches no cell but free ones.
fn fits(grid: &DenseGrid, p: &Point2<f64>) -> bool {
    let middle = grid.geometry.cell(p).unwrap();
    let mut around = (-3..=3).flat_map(|dx| (-3..=3).map(move |dy| Cell::new(middle.x + dx, middle.y + dy)));
    around.all(|cell| {
        let off = (p - grid.geometry.center(cell)).map(|v| (v.abs() - 0.05).max(0.0)).norm();
        grid.value(cell) == Some(Some(0)) || off >= 0.2 - 1e-6
    })
}

fn rooms() -> DenseGrid {
    // Two rooms and a corridor, with doors, pillars and a niche.
    let mut grid = hall(120, 90);
    let mut wall = |x: std::ops::Range<usize>, y: std::ops::Range<usize>, value: i8| {
        y.for_each(|y| x.clone().for_each(|x| grid.cells[y * 120 + x] = value));
    };
    wall(0..120, 40..42, 100);
    wall(60..62, 42..90, 100);
    wall(0..120, 28..30, 100);
    for (x, y) in [(20, 40), (90, 40), (50, 28), (60, 70)] {
        wall(x..x + 8, y..y + 8, 0);
    }
    wall(30..33, 60..66, 100);
    wall(80..95, 70..73, 100);
    wall(100..101, 5..20, 100);
    grid
}

#[test]
fn an_open_hall_is_covered_in_lanes_with_little_more_way_than_its_area_needs() {
    let grid = hall(100, 60);
    let start = Point2::new(0.45, 0.45);
    for direction in [CoverageDirection::AlongX, CoverageDirection::AlongY, CoverageDirection::Shorter] {
        let coverage = CoverageParams { direction, ..CoverageParams::default() };
        let path = covered(&grid, start, &coverage);
        clear(&grid, &path);
        let share = share(&grid, start, &path, 0.2);
        assert!(share >= 0.99 && (share - path.covered_share).abs() < 0.01, "{share} {}", path.covered_share);
        // Lanes 0.3 m apart (three cells), both ends of each 0.2 m from the walls.
        let least = path.coverable_m2 / 0.3;
        assert!(path.path.length_m < 1.2 * least, "{} {least}", path.path.length_m);
        assert_eq!(path.num_regions, 1);
        assert!(path.path.is_final);
    }
}

#[test]
fn rooms_corridors_and_pillars_are_covered_and_nothing_is_touched() {
    let (grid, start) = (rooms(), Point2::new(1.05, 5.05));
    for (tool_width_m, overlap) in [(0.4, 0.1), (0.4, 0.5), (0.6, 0.0), (0.25, 0.1), (0.1, 0.0)] {
        let coverage = CoverageParams { tool_width_m, overlap, ..CoverageParams::default() };
        let path = covered(&grid, start, &coverage);
        clear(&grid, &path);
        assert_eq!(path.path.waypoints[0].position, start);
        let share = share(&grid, start, &path, 0.5 * tool_width_m);
        assert!(share >= 0.98, "{tool_width_m} {overlap}: {share}");
        assert!(path.path.is_final && path.covered_share >= 0.99);
        let least = path.coverable_m2 / (tool_width_m * (1.0 - overlap));
        assert!(path.path.length_m < 1.7 * least, "{tool_width_m} {overlap}: {} {least}", path.path.length_m);
        let kinds = path.legs.windows(2).all(|l| l[0].kind != l[1].kind && l[0].first_waypoint < l[1].first_waypoint);
        assert!(kinds && path.legs.iter().any(|l| l.kind == CoverageLegKind::Lane));
    }
}

#[test]
fn cluttered_worlds_are_covered() {
    for seed in 0..20 {
        let mut random = Random(seed);
        let mut grid = hall(80, 60);
        for _ in 0..12 {
            let (x, y, w, h) = (random.below(80), random.below(60), 1 + random.below(8), 1 + random.below(8));
            for y in y..(y + h).min(60) {
                (x..(x + w).min(80)).for_each(|x| grid.cells[y * 80 + x] = if seed % 2 == 0 { 100 } else { -1 });
            }
        }
        let start = loop {
            let p = Point2::new(random.below(800) as f64 / 100.0, random.below(600) as f64 / 100.0);
            if distance_to_obstacles(&grid, &p) >= 0.35 {
                break p;
            }
        };
        let path = covered(&grid, start, &CoverageParams::default());
        clear(&grid, &path);
        let share = share(&grid, start, &path, 0.2);
        assert!(share >= 0.98, "world {seed}: {share}");
    }
}

#[test]
fn what_cannot_be_reached_is_not_covered_and_starts_are_refused_as_for_paths() {
    let mut rows = vec![format!("#{}#{}#", ".".repeat(30), ".".repeat(20)); 30];
    rows.insert(0, "#".repeat(53));
    rows.push("#".repeat(53));
    let grid = drawn(&rows.iter().map(String::as_str).collect::<Vec<_>>());
    let path = covered(&grid, Point2::new(1.0, 1.0), &CoverageParams { enough: 1.0, ..CoverageParams::default() });
    // The base keeps 0.25 m from the walls, so that three cells in each corner of 3 x 3 m are out of the disc's reach.
    assert!((path.coverable_m2 - 8.88).abs() < 1e-9, "{}", path.coverable_m2);
    assert_eq!(path.covered_share, 1.0);
    assert!(path.path.waypoints.iter().all(|w| w.position.x < 3.1));
    let params = params();
    let refused = |start: Point2<f64>, params: &PlanParams| {
        let request = PathRequest::new(start, start, params);
        match plan_coverage(&grid, &request, &CoverageParams::default()).unwrap() {
            CoverageOutcome::NoPath { reason, .. } => reason,
            CoverageOutcome::Path(path) => panic!("{path:?}"),
        }
    };
    assert_eq!(refused(Point2::new(-1.0, 0.0), &params), NoPathReason::StartOutsideMap);
    assert_eq!(refused(Point2::new(0.05, 1.0), &params), NoPathReason::StartOccupied);
    assert_eq!(refused(Point2::new(0.15, 1.0), &params), NoPathReason::StartDoesNotFit);
    // Too few expansions: the best so far, and it says so.
    let few = PlanParams { max_expansions: 1, ..params };
    let request = PathRequest::new(Point2::new(1.0, 1.0), Point2::new(1.0, 1.0), &few);
    let outcome = plan_coverage(&grid, &request, &CoverageParams::default()).unwrap();
    assert!(matches!(outcome, CoverageOutcome::Path(path) if !path.path.is_final && path.covered_share < 0.5));
    let stop = || true;
    let request =
        PathRequest { stop: Some(&stop), ..PathRequest::new(Point2::new(1.0, 1.0), Point2::origin(), &params) };
    let outcome = plan_coverage(&grid, &request, &CoverageParams::default()).unwrap();
    assert!(matches!(outcome, CoverageOutcome::NoPath { reason: NoPathReason::Stopped, .. }));
}

#[test]
fn tools_that_make_no_sense_are_refused() {
    let refused = |coverage: CoverageParams| match coverage.validate() {
        Err(PlanError::InvalidParam { field, .. }) => field,
        other => panic!("{other:?}"),
    };
    let default = CoverageParams::default();
    assert_eq!(refused(CoverageParams { tool_width_m: 0.0, ..default }), "coverage.tool_width_m");
    assert_eq!(refused(CoverageParams { tool_width_m: f64::NAN, ..default }), "coverage.tool_width_m");
    assert_eq!(refused(CoverageParams { overlap: 0.91, ..default }), "coverage.overlap");
    assert_eq!(refused(CoverageParams { enough: 0.0, ..default }), "coverage.enough");
    assert_eq!(default.validate(), Ok(()));
}
