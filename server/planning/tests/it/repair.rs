//! A search that is kept, against searches from scratch.

use crate::hall;
use crate::worlds::{Random, world};
use percept_geometry::Cell;
use percept_planning::{
    GridPath, NoPathReason, PathRequest, PlanError, PlanOutcome, PlanParams, RepairedRoute, RepairingPlanner,
    SearchGrid, astar, plan_dense,
};

/// Random changes and moves on a grid; after each the cost is that of A*.
fn repairs_as_well_as_from_scratch(
    seed: u64,
    (width, height): (usize, usize),
    share: usize,
    factored: bool,
) -> (usize, usize) {
    let mut random = Random(seed);
    let num = width * height;
    let mut blocked: Vec<bool> = (0..num).map(|_| random.below(100) < share).collect();
    let mut factors: Vec<f32> =
        if factored { (0..num).map(|_| 1.0 + random.below(6) as f32).collect() } else { vec![] };
    let cell = |i: usize| Cell::new((i % width) as i32, (i / width) as i32);
    let (mut start, goal) = (cell(random.below(num)), cell(random.below(num)));
    let grid = SearchGrid { blocked: &blocked, factors: &factors, width, height };
    let mut planner = RepairingPlanner::new(&grid, goal).unwrap();
    let (mut repaired, mut searched) = (0, 0);
    for round in 0..300 {
        // Some cells change; the robot's own and the goal's may, too.
        let changed: Vec<usize> = (0..random.below(8)).map(|_| random.below(num)).collect();
        let changes: Vec<(Cell, bool)> = changed.iter().map(|i| (cell(*i), random.below(100) < share)).collect();
        changed.iter().zip(&changes).for_each(|(i, (_, is_blocked))| blocked[*i] = *is_blocked);
        if factored && round % 3 == 0 {
            (0..5).for_each(|_| factors[random.below(num)] = 1.0 + random.below(9) as f32 / 2.0);
            let grid = SearchGrid { blocked: &blocked, factors: &factors, width, height };
            assert!(planner.update(&grid).unwrap() <= changes.len() + 5);
        } else {
            planner.set_blocked(&changes).unwrap();
        }
        let grid = SearchGrid { blocked: &blocked, factors: &factors, width, height };
        let scratch = astar::search(&grid, start, goal, usize::MAX);
        match (planner.path(start, usize::MAX), scratch) {
            (GridPath::Found { cells, cost, expansions }, GridPath::Found { cost: least, expansions: all, .. }) => {
                assert!((cost - least).abs() <= 1e-6 * least, "seed {seed}, round {round}: {cost} {least}");
                assert_eq!((cells[0], cells[cells.len() - 1]), (start, goal));
                for pair in cells.windows(2) {
                    let (a, b) = (pair[0], pair[1]);
                    let free = |c: Cell| !blocked[c.y as usize * width + c.x as usize];
                    assert!(a.x.abs_diff(b.x) <= 1 && a.y.abs_diff(b.y) <= 1 && a != b);
                    assert!([a, b, Cell::new(a.x, b.y), Cell::new(b.x, a.y)].into_iter().all(free));
                }
                (repaired, searched) = (repaired + expansions, searched + all);
                // On by a few cells, or somewhere else now and then.
                start = cells[random.below(4).min(cells.len() - 1)];
            }
            (GridPath::Unreachable { .. }, GridPath::Unreachable { .. }) => {}
            (found, scratch) => panic!("seed {seed}, round {round}: {found:?} {scratch:?}"),
        }
        if random.below(25) == 0 || start == goal {
            start = cell(random.below(num));
        }
    }
    (repaired, searched)
}

#[test]
fn after_hundreds_of_changes_and_moves_paths_cost_what_they_cost_from_scratch() {
    for seed in 0..12 {
        let size = [(30, 20), (1, 40), (64, 64), (7, 7)][seed as usize % 4];
        repairs_as_well_as_from_scratch(seed, size, [25, 0, 40][seed as usize % 3], seed % 2 == 0);
    }
}

#[test]
fn repairing_expands_less_than_searching_again() {
    let (repaired, searched) = repairs_as_well_as_from_scratch(3, (200, 200), 20, true);
    assert!(3 * repaired < 2 * searched, "{repaired} {searched}");
}

#[test]
fn a_search_that_was_cut_off_goes_on() {
    let blocked = vec![false; 10_000];
    let factors: Vec<f32> = (0..10_000).map(|i| 1.0 + (i % 13) as f32).collect();
    let grid = SearchGrid { blocked: &blocked, factors: &factors, width: 100, height: 100 };
    let (start, goal) = (Cell::new(2, 3), Cell::new(95, 60));
    let mut planner = RepairingPlanner::new(&grid, goal).unwrap();
    let mut calls = 1;
    let cost = loop {
        match planner.path(start, 100) {
            GridPath::SearchLimit => calls += 1,
            GridPath::Found { cost, expansions, .. } => break (cost, expansions),
            other => panic!("{other:?}"),
        }
    };
    assert!(calls > 10 && cost.1 <= 100);
    let GridPath::Found { cost: least, .. } = astar::search(&grid, start, goal, usize::MAX) else { panic!() };
    assert!((cost.0 - least).abs() < 1e-6 * least);
    // Asked again with nothing changed, it knows.
    assert!(matches!(planner.path(start, 0), GridPath::Found { expansions: 0, .. }));
}

#[test]
fn over_maps_a_route_is_repaired_as_walls_come_and_go() {
    // Ways that cost the same over cells may be smoothed to ways that do not.
    let params = PlanParams { smooth: false, ..PlanParams::default() };
    for seed in 0..20 {
        let (mut grid, [start, goal]) = world(seed);
        let (mut random, mut route, mut at) = (Random(seed), RepairedRoute::new(), start);
        for round in 0..12 {
            let found = route.plan(&grid, &PathRequest::new(at, goal, &params)).unwrap();
            match (found, plan_dense(&grid, at, goal, &params).unwrap()) {
                (PlanOutcome::Path(found), PlanOutcome::Path(scratch)) => {
                    // Legs are weighed by samples, steps by their ends.
                    let most = scratch.cost * 1.05 + 0.05;
                    assert!(found.cost <= most, "world {seed}, {round}: {} {}", found.cost, scratch.cost);
                    at = found.waypoints[found.waypoints.len() / 4].position;
                }
                (found, scratch) => assert_eq!(found, scratch, "world {seed}, {round}"),
            }
            for _ in 0..6 {
                let (x, y) = (1 + random.below(48), 1 + random.below(38));
                let is_free = grid.cells[y * 50 + x] == 0;
                grid.cells[y * 50 + x] = if is_free { 100 } else { 0 };
            }
        }
    }
}

#[test]
fn questions_that_make_no_sense_are_refused_and_what_was_kept_stays() {
    let blocked = [false; 6];
    let grid = |width| SearchGrid { blocked: &blocked, factors: &[], width, height: 2 };
    let refused = |error: Option<PlanError>| match error {
        Some(PlanError::InvalidParam { field, value, .. }) => (field, value),
        other => panic!("{other:?}"),
    };
    assert_eq!(refused(RepairingPlanner::new(&grid(4), Cell::new(0, 0)).err()), ("grid", 6.0));
    assert_eq!(refused(RepairingPlanner::new(&grid(3), Cell::new(3, 0)).err()), ("goal", 3.0));
    let mut planner = RepairingPlanner::new(&grid(3), Cell::new(2, 1)).unwrap();
    let changes = [(Cell::new(1, 0), true), (Cell::new(0, -1), true)];
    assert_eq!(refused(planner.set_blocked(&changes).err()), ("changes", -1.0));
    assert!(!planner.grid().blocked[1], "none of the changes is made");
    assert_eq!(
        refused(planner.update(&SearchGrid { blocked: &blocked, factors: &[], width: 2, height: 3 }).err()).0,
        "grid"
    );
    assert!(matches!(planner.path(Cell::new(5, 5), 9), GridPath::Unreachable { expansions: 0 }));
    let GridPath::Found { cost, .. } = planner.path(Cell::new(0, 0), 99) else { panic!() };
    assert_eq!(cost, 1.0 + 2f64.sqrt());
    // A route keeps on after a question that was refused.
    let (map, params, mut route) = (hall(60, 60), PlanParams::default(), RepairedRoute::new());
    let ends = |goal: f64| (nalgebra::Point2::new(1.0, 1.0), nalgebra::Point2::new(goal, 4.0));
    let mut ask = |goal: f64| route.plan(&map, &PathRequest::new(ends(goal).0, ends(goal).1, &params));
    assert!(matches!(ask(4.0), Ok(PlanOutcome::Path(_))));
    assert!(matches!(ask(f64::NAN), Err(PlanError::NotFinite { field: "goal", .. })));
    assert!(matches!(ask(9.0), Ok(PlanOutcome::NoPath { reason: NoPathReason::GoalOutsideMap, .. })));
    let Ok(PlanOutcome::Path(path)) = ask(4.0) else { panic!() };
    assert_eq!(path.expansions, 0);
}
