//! Times shortest paths on a Moving AI map: `grid_search MAP SCENARIOS [RUNS]`.
//!
//! Twenty queries spread evenly over the scenario file, by A*, by jump point search, and by the one of the two that
//! `shortest_path` takes for the map; a run is all twenty, with the map
//! handed in by the call as one `bool` a cell, and all that is set up for a query counted. Prints the median and the least
//! of RUNS (15), expansions, and how many lengths differ from the published ones by more than 0.01.

#![allow(clippy::unwrap_used, reason = "a tool: it fails loudly")]

use percept_geometry::Cell;
use percept_planning::{GridPath, SearchGrid, astar::search, jump_point_search, shortest_path};
use std::time::Instant;

const QUERIES: usize = 20;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [map, scenarios, rest @ ..] = &arguments[..] else {
        eprintln!("usage: grid_search MAP SCENARIOS [RUNS]");
        std::process::exit(2);
    };
    let runs = rest.first().map_or(15, |n| n.parse().unwrap());
    let text = std::fs::read_to_string(map).unwrap();
    let rows: Vec<&str> = text.lines().skip(4).filter(|l| !l.is_empty()).collect();
    let (width, height) = (rows[0].len(), rows.len());
    let blocked: Vec<bool> = rows.iter().flat_map(|row| row.bytes().map(|c| !b".GS".contains(&c))).collect();
    let text = std::fs::read_to_string(scenarios).unwrap();
    let rows: Vec<Vec<&str>> = text.lines().skip(1).map(|l| l.split_whitespace().collect()).collect();
    let queries: Vec<(Cell, Cell, f64)> = (0..QUERIES).map(|i| query(&rows[i * rows.len() / QUERIES])).collect();
    let grid = SearchGrid { blocked: &blocked, factors: &[], width, height };
    report("A*", runs, &queries, |a, b| search(&grid, a, b, usize::MAX));
    report("JPS", runs, &queries, |a, b| jump_point_search(&grid, a, b, usize::MAX));
    report("path", runs, &queries, |a, b| shortest_path(&blocked, width, height, a, b, usize::MAX));
}

fn query(columns: &[&str]) -> (Cell, Cell, f64) {
    let n = |i: usize| columns[i].parse().unwrap();
    (Cell::new(n(4), n(5)), Cell::new(n(6), n(7)), columns[8].parse().unwrap())
}

fn report(name: &str, runs: usize, queries: &[(Cell, Cell, f64)], find: impl Fn(Cell, Cell) -> GridPath) {
    let mut times = Vec::new();
    let mut found = Vec::new();
    for _ in 0..runs {
        let begin = Instant::now();
        found = queries.iter().map(|(a, b, _)| find(*a, *b)).collect();
        times.push(begin.elapsed().as_secs_f64() * 1e3);
    }
    times.sort_by(f64::total_cmp);
    let (mut wrong, mut all) = (0, 0);
    for (path, (_, _, optimal)) in found.iter().zip(queries) {
        match path {
            GridPath::Found { cost, expansions, .. } => {
                wrong += usize::from((cost - optimal).abs() > 0.01);
                all += expansions;
            }
            _ => wrong += 1,
        }
    }
    println!(
        "{name:4} median {:8.3} ms  least {:8.3} ms  {all} expansions  {wrong} wrong",
        times[times.len() / 2],
        times[0]
    );
}
