//! Paths that get better, and what is proven about them.

use crate::worlds::world;
use crate::{hall, reason};
use nalgebra::Point2;
use percept_geometry::Cell;
use percept_mapping::DenseGrid;
use percept_planning::anytime::{AnytimeEnd, AnytimePath, AnytimeRequest, search};
use percept_planning::{
    AnytimeParams, GridPath, NoPathReason, PathRequest, PlanError, PlanOutcome, PlanParams, Planner, SearchGrid, Zone,
    ZoneKind, astar, plan_anytime, plan_dense, plan_path,
};
use proptest::prelude::*;
use std::sync::atomic::{AtomicUsize, Ordering};

proptest! {
    #[test]
    fn bounds_hold_at_every_step_and_the_last_path_is_that_of_a_star(
        width in 1..40usize, height in 1..40usize, seed in prop::collection::vec(0..100u32, 1600), share in 0..45u32,
        factored: bool, ends in prop::array::uniform2(0..1600usize), first_bound in 1.0..8.0f64, bound_step in 0.05..2.0f64,
    ) {
        let num = width * height;
        let blocked: Vec<bool> = (0..num).map(|i| seed[i] < share).collect();
        let factors: Vec<f32> = if factored { (0..num).map(|i| 1.0 + (seed[i] % 7) as f32).collect() } else { vec![] };
        let grid = SearchGrid { blocked: &blocked, factors: &factors, width, height };
        let cell = |i: usize| Cell::new((i % num % width) as i32, (i % num / width) as i32);
        let (start, goal) = (cell(ends[0]), cell(ends[1]));
        let request = AnytimeRequest {
            start, goal, params: AnytimeParams { first_bound, bound_step }, max_expansions: usize::MAX, stop: None,
        };
        let mut found: Vec<AnytimePath> = vec![];
        let ended = search(&grid, &request, &mut |path| found.push(path.clone()));
        let GridPath::Found { cost: least, .. } = astar::search(&grid, start, goal, usize::MAX) else {
            prop_assert_eq!((ended, found.len()), (AnytimeEnd::Unreachable, 0));
            return Ok(());
        };
        prop_assert_eq!(ended, AnytimeEnd::Optimal);
        prop_assert!(found[0].bound <= first_bound + 1e-12);
        for path in &found {
            prop_assert!(path.cost <= path.bound * least * (1.0 + 1e-6) + 1e-9, "{} {} {least}", path.cost, path.bound);
            prop_assert!((walked(&grid, &path.cells) - path.cost).abs() <= 1e-9 * path.cost);
            prop_assert_eq!((path.cells[0], path.cells[path.cells.len() - 1]), (start, goal));
        }
        for pair in found.windows(2) {
            prop_assert!(pair[1].cost <= pair[0].cost + 1e-9 && pair[1].bound <= pair[0].bound);
        }
        let last = &found[found.len() - 1];
        prop_assert_eq!(last.bound, 1.0);
        prop_assert!((last.cost - least).abs() <= 1e-6 * least, "{} {least}", last.cost);
        // Cut off anywhere, what was found by then stands, and its bound holds.
        for max_expansions in [0, 1, last.expansions / 3, last.expansions / 2, last.expansions.saturating_sub(1)] {
            let mut paths: Vec<AnytimePath> = vec![];
            let cut = AnytimeRequest { max_expansions, ..request };
            let ended = search(&grid, &cut, &mut |path| paths.push(path.clone()));
            prop_assert!(matches!(ended, AnytimeEnd::Limit | AnytimeEnd::Optimal));
            for path in &paths {
                prop_assert!(path.expansions <= max_expansions);
                prop_assert!(path.cost <= path.bound * least * (1.0 + 1e-6) + 1e-9);
                prop_assert!((walked(&grid, &path.cells) - path.cost).abs() <= 1e-9 * path.cost);
            }
        }
    }
}

/// Cost of a way from free cell to free cell beside it that cuts no corner, in cells.
fn walked(grid: &SearchGrid<'_>, cells: &[Cell]) -> f64 {
    let index = |c: Cell| c.y as usize * grid.width + c.x as usize;
    let factor = |c: Cell| if grid.factors.is_empty() { 1.0 } else { f64::from(grid.factors[index(c)]) };
    let step = |pair: &[Cell]| {
        let (a, b) = (pair[0], pair[1]);
        assert!(a.x.abs_diff(b.x) <= 1 && a.y.abs_diff(b.y) <= 1 && a != b);
        assert!([a, b, Cell::new(a.x, b.y), Cell::new(b.x, a.y)].into_iter().all(|c| !grid.blocked[index(c)]));
        f64::from(a.x - b.x).hypot(f64::from(a.y - b.y)) * 0.5 * (factor(a) + factor(b))
    };
    cells.windows(2).map(step).sum()
}

#[test]
fn over_maps_the_last_path_costs_no_more_than_that_of_one_search() {
    let params = PlanParams { start_tolerance_m: 0.0, ..PlanParams::default() };
    let anytime = AnytimeParams { first_bound: 5.0, bound_step: 1.0 };
    let mut better = 0;
    for seed in 0..60 {
        let (grid, [start, goal]) = world(seed);
        let mut told = vec![];
        let request = PathRequest::new(start, goal, &params);
        let found = plan_anytime(&grid, &request, &anytime, &mut |path| told.push(path.clone())).unwrap();
        match (found, plan_dense(&grid, start, goal, &params).unwrap()) {
            (PlanOutcome::Path(found), PlanOutcome::Path(once)) => {
                assert_eq!(told.last(), Some(&found));
                assert!(found.is_final && found.bound == Some(1.0));
                // Of ways that cost the same over cells, the two may take different ones, and so be smoothed otherwise.
                assert!(found.cost <= once.cost * 1.03, "world {seed}: {} {}", found.cost, once.cost);
                assert!(told.windows(2).all(|pair| pair[1].cost <= pair[0].cost));
                better += usize::from(told[0].cost > found.cost);
            }
            (found, once) => assert_eq!(found, once),
        }
    }
    assert!(better >= 5, "{better} got better");
}

#[test]
fn without_time_there_is_a_reason_and_with_little_the_best_so_far() {
    let (grid, params) = (hall(200, 200), PlanParams::default());
    let (start, goal) = (Point2::new(1.0, 1.0), Point2::new(18.0, 15.0));
    let anytime = AnytimeParams::default();
    let none = PlanOutcome::NoPath { reason: NoPathReason::Stopped, blocking: None };
    let stop = || true;
    let request = PathRequest { stop: Some(&stop), ..PathRequest::new(start, goal, &params) };
    assert_eq!(plan_anytime(&grid, &request, &anytime, &mut |_| panic!("a path")).unwrap(), none);
    let few = PlanParams { max_expansions: 2, ..params };
    let outcome = plan_anytime(&grid, &PathRequest::new(start, goal, &few), &anytime, &mut |_| ()).unwrap();
    assert_eq!(outcome, PlanOutcome::NoPath { reason: NoPathReason::SearchLimit, blocking: None });
    // A wall with its gap far off, so that the first way is not the best; stopped once a first way is known.
    let mut grid = grid;
    (0..200).filter(|y| !(180..192).contains(y)).for_each(|y| grid.cells[y * 200 + 100] = 100);
    let seen = AtomicUsize::new(0);
    let stop = || seen.load(Ordering::Relaxed) > 0;
    let request = PathRequest { stop: Some(&stop), ..PathRequest::new(start, goal, &params) };
    let mut first = |_: &percept_planning::Path| {
        seen.fetch_add(1, Ordering::Relaxed);
    };
    let PlanOutcome::Path(path) = plan_anytime(&grid, &request, &anytime, &mut first).unwrap() else { panic!() };
    assert!(!path.is_final && path.bound.is_some_and(|bound| bound > 1.0 && bound <= 3.0), "{:?}", path.bound);
    // Other reasons are those of one search.
    let inside = [10.05, 5.0];
    assert_eq!(reason(&grid, [1.0, 1.0], inside, &params), NoPathReason::GoalOccupied);
    let request = PathRequest::new(start, Point2::from(inside), &params);
    let outcome = plan_anytime(&grid, &request, &anytime, &mut |_| ()).unwrap();
    assert!(matches!(outcome, PlanOutcome::NoPath { reason: NoPathReason::GoalOccupied, .. }));
}

#[test]
fn bounds_below_one_are_refused() {
    let refused = |params: AnytimeParams| match params.validate() {
        Err(PlanError::InvalidParam { field, .. }) => field,
        other => panic!("{other:?}"),
    };
    assert_eq!(refused(AnytimeParams { first_bound: 0.99, ..AnytimeParams::default() }), "anytime.first_bound");
    assert_eq!(refused(AnytimeParams { first_bound: f64::NAN, ..AnytimeParams::default() }), "anytime.first_bound");
    assert_eq!(refused(AnytimeParams { bound_step: 0.0, ..AnytimeParams::default() }), "anytime.bound_step");
    assert_eq!(AnytimeParams { first_bound: 1.0, bound_step: 100.0 }.validate(), Ok(()));
}

/// By a planner that is told to stop when it has asked so often.
fn stopped_after(
    grid: &DenseGrid,
    (start, goal): (Point2<f64>, Point2<f64>),
    params: &PlanParams,
    (planner, asks): (Planner, usize),
) -> PlanOutcome {
    let asked = AtomicUsize::new(0);
    let stop = || asked.fetch_add(1, Ordering::Relaxed) >= asks;
    plan_path(grid, &PathRequest { stop: Some(&stop), planner, ..PathRequest::new(start, goal, params) }).unwrap()
}

#[test]
fn a_search_at_any_angle_that_is_stopped_answers_with_the_best_so_far() {
    let params = PlanParams { start_tolerance_m: 0.0, ..PlanParams::default() };
    let (mut over_cells, mut early, mut done) = (0, 0, 0);
    for seed in 0..60 {
        let (grid, ends) = world(seed);
        let request = PathRequest { planner: Planner::AnyAngle, ..PathRequest::new(ends[0], ends[1], &params) };
        let once = plan_path(&grid, &request).unwrap();
        for asks in [0, 1, 3, 8, 12, 16, 20, 30, usize::MAX] {
            match (stopped_after(&grid, (ends[0], ends[1]), &params, (Planner::AnyAngle, asks)), &once) {
                (PlanOutcome::Path(path), PlanOutcome::Path(at_any_angle)) => {
                    over_cells += usize::from(path.bound.is_some_and(|bound| bound > 1.0));
                    early += usize::from(!path.is_final && path.bound == Some(1.0));
                    if asks == usize::MAX {
                        done += 1;
                        // Of ways over cells that cost the same, another may have been found first.
                        let ratio = path.cost / at_any_angle.cost;
                        assert!(path.is_final && (ratio - 1.0).abs() < 0.05, "world {seed}: {ratio}");
                    }
                }
                (PlanOutcome::NoPath { reason: NoPathReason::Stopped, .. }, _) => assert!(asks < usize::MAX),
                (none, once) => assert_eq!(&none, once),
            }
        }
    }
    assert!(over_cells >= 5 && early >= 5 && done >= 10, "{over_cells} {early} {done}");
}

#[test]
fn a_grid_search_that_is_stopped_answers_with_the_best_so_far_and_a_bound_that_holds() {
    let params = PlanParams { smooth: false, start_tolerance_m: 0.0, ..PlanParams::default() };
    let (mut early, mut done) = (0, 0);
    for seed in 0..60 {
        let (grid, ends) = world(seed);
        let once = plan_dense(&grid, ends[0], ends[1], &params).unwrap();
        for asks in [0, 1, 2, 3, 5, 8, 12, usize::MAX] {
            match (stopped_after(&grid, (ends[0], ends[1]), &params, (Planner::Grid, asks)), &once) {
                (PlanOutcome::Path(path), PlanOutcome::Path(least)) => {
                    let bound = path.bound.unwrap();
                    assert_eq!(path.is_final, bound == 1.0);
                    // The cost of legs is sampled, that of cells is not: they differ by some percent on short ways.
                    assert!(path.cost <= least.cost * bound * 1.05, "world {seed}: {} {bound}", path.cost);
                    early += usize::from(!path.is_final);
                    done += usize::from(path.is_final && asks == usize::MAX);
                }
                (PlanOutcome::NoPath { reason: NoPathReason::Stopped, .. }, _) => assert!(asks < usize::MAX),
                (none, once) => assert_eq!(&none, once),
            }
        }
    }
    assert!(early >= 5 && done >= 10, "{early} {done}");
}

#[test]
fn a_search_in_time_keeps_to_zones_and_counts_slow_ones() {
    let params = PlanParams::default();
    let grid = hall(200, 120);
    let (start, goal) = (Point2::new(2.0, 3.0), Point2::new(18.0, 3.0));
    let polygon = [[8.0, -1.0], [12.0, -1.0], [12.0, 8.0], [8.0, 8.0]].map(Point2::from).to_vec();
    let go_on = || false;
    for kind in [ZoneKind::KeepOut, ZoneKind::SpeedLimit { share: 0.1 }] {
        let zones = [Zone { polygon: polygon.clone(), kind }];
        let request = PathRequest { zones: &zones, ..PathRequest::new(start, goal, &params) };
        let PlanOutcome::Path(least) = plan_path(&grid, &request).unwrap() else { panic!() };
        let request = PathRequest { stop: Some(&go_on), ..request };
        let PlanOutcome::Path(path) = plan_path(&grid, &request).unwrap() else { panic!() };
        assert!(path.is_final && (path.cost / least.cost - 1.0).abs() < 0.02, "{} {}", path.cost, least.cost);
        assert!(path.waypoints.iter().any(|w| w.position.y > 8.0));
        let stop = || true;
        let stopped = plan_path(&grid, &PathRequest { stop: Some(&stop), ..request }).unwrap();
        assert_eq!(stopped, PlanOutcome::NoPath { reason: NoPathReason::Stopped, blocking: None });
    }
}
