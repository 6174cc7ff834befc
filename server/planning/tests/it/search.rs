//! The search on cells, where there is nothing to find.

use percept_geometry::Cell;
use percept_planning::{GridPath, SearchGrid, astar::search, jump_point_search, shortest_path};
use proptest::prelude::*;

/// Dijkstra by the book: the nearest unsettled cell, found by looking at all of them.
fn dijkstra(grid: &SearchGrid<'_>, start: usize, goal: usize) -> Option<f64> {
    let factor = |i: usize| if grid.factors.is_empty() { 1.0 } else { f64::from(grid.factors[i]) };
    let is_free = |x: i32, y: i32| {
        let inside = x >= 0 && y >= 0 && (x as usize) < grid.width && (y as usize) < grid.height;
        inside && !grid.blocked[y as usize * grid.width + x as usize]
    };
    let mut costs = vec![f64::INFINITY; grid.blocked.len()];
    let mut settled = vec![false; costs.len()];
    costs[start] = 0.0;
    loop {
        let open = (0..costs.len()).filter(|i| !settled[*i] && costs[*i].is_finite());
        let at = open.min_by(|a, b| costs[*a].total_cmp(&costs[*b]))?;
        if at == goal {
            return Some(costs[goal]);
        }
        settled[at] = true;
        let (x, y) = ((at % grid.width) as i32, (at / grid.width) as i32);
        for (dx, dy) in (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (dx, dy))) {
            if is_free(x + dx, y + dy) && is_free(x + dx, y) && is_free(x, y + dy) {
                let next = (y + dy) as usize * grid.width + (x + dx) as usize;
                let cost = costs[at] + f64::from(dx).hypot(f64::from(dy)) * 0.5 * (factor(at) + factor(next));
                costs[next] = costs[next].min(cost);
            }
        }
    }
}

fn cost(found: &GridPath) -> Option<f64> {
    match found {
        GridPath::Found { cost, .. } => Some(*cost),
        GridPath::Unreachable { .. } => None,
        GridPath::SearchLimit => panic!("no limit was set"),
    }
}

fn is_same(a: Option<f64>, b: Option<f64>) -> bool {
    match (a, b) {
        (Some(a), Some(b)) => (a - b).abs() <= 1e-6 * b,
        (a, b) => a == b,
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn jump_points_and_a_star_are_as_short_as_dijkstra(
        width in 1..90usize, height in 1..12usize, turned in any::<bool>(), share in 0..4usize,
        seed in prop::collection::vec(0..100u32, 90 * 12), ends in (0..1080usize, 0..1080usize), top in 1.0..30f32,
    ) {
        let (width, height) = if turned { (height, width) } else { (width, height) };
        let mut blocked: Vec<bool> = (0..width * height).map(|i| seed[i] < [3, 15, 30, 45][share]).collect();
        let (start, goal) = (ends.0 % blocked.len(), ends.1 % blocked.len());
        (blocked[start], blocked[goal]) = (false, false);
        let cell = |i: usize| Cell::new((i % width) as i32, (i / width) as i32);
        let even = SearchGrid { blocked: &blocked, factors: &[], width, height };
        let shortest = dijkstra(&even, start, goal);
        let by_jumps = jump_point_search(&even, cell(start), cell(goal), usize::MAX);
        let either = shortest_path(&blocked, width, height, cell(start), cell(goal), usize::MAX);
        let by_cells = search(&even, cell(start), cell(goal), usize::MAX);
        prop_assert!(is_same(cost(&by_jumps), shortest), "{by_jumps:?}, not {shortest:?}");
        prop_assert!(is_same(cost(&by_cells), shortest), "{by_cells:?}, not {shortest:?}");
        prop_assert!(is_same(cost(&either), shortest), "{either:?}, not {shortest:?}");
        let factors: Vec<f32> = (0..blocked.len()).map(|i| 1.0 + top * (seed[i] % 7) as f32 / 7.0).collect();
        let weighted = SearchGrid { factors: &factors, ..even };
        let cheapest = dijkstra(&weighted, start, goal);
        let found = search(&weighted, cell(start), cell(goal), usize::MAX);
        prop_assert!(is_same(cost(&found), cheapest), "{found:?}, not {cheapest:?}");
    }
}

#[test]
fn infinite_and_huge_factors_are_walls_and_detours() {
    let blocked = [false; 9];
    let mut factors = [1.0f32; 9];
    factors[4] = f32::INFINITY;
    let grid = SearchGrid { blocked: &blocked, factors: &factors, width: 3, height: 3 };
    let found = search(&grid, Cell::new(0, 1), Cell::new(2, 1), usize::MAX);
    assert_eq!(cost(&found), Some(8f64.sqrt()), "past its corners");
    (0..3).for_each(|y| factors[3 * y + 1] = 1e9);
    let grid = SearchGrid { blocked: &blocked, factors: &factors, width: 3, height: 3 };
    let found = search(&grid, Cell::new(0, 1), Cell::new(2, 1), usize::MAX);
    assert_eq!(cost(&found), Some(1e9 + 1.0));
}

#[test]
fn a_path_is_refused_where_ends_are_blocked_or_outside() {
    let blocked = [false, true, false, false];
    let free = Cell::new(0, 0);
    for goal in [Cell::new(1, 0), Cell::new(2, 0), Cell::new(0, -1)] {
        let found = shortest_path(&blocked, 2, 2, free, goal, 10);
        assert_eq!(found, GridPath::Unreachable { expansions: 0 });
    }
    // No cutting of corners: around, not across.
    let GridPath::Found { cost, .. } = shortest_path(&blocked, 2, 2, free, Cell::new(1, 1), 10) else { panic!() };
    assert_eq!(cost, 2.0);
    assert_eq!(shortest_path(&blocked, 3, 2, free, free, 10), GridPath::Unreachable { expansions: 0 });
}
