//! How soon a path is there, and how good it is by then: `anytime MAP SCENARIOS [FIRST_BOUND] [BOUND_STEP]`.
//!
//! Twenty queries spread evenly over a Moving AI scenario file. Prints, summed over them, the time and expansions until the
//! first path and until the cheapest is proven, next to one A*, and by how much the first ones are longer.

#![allow(clippy::unwrap_used, reason = "a tool: it fails loudly")]

use percept_geometry::Cell;
use percept_planning::anytime::{AnytimePath, AnytimeRequest, search};
use percept_planning::{AnytimeParams, GridPath, SearchGrid, astar};
use std::time::Instant;

const QUERIES: usize = 20;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [map, scenarios, rest @ ..] = &arguments[..] else {
        eprintln!("usage: anytime MAP SCENARIOS [FIRST_BOUND] [BOUND_STEP]");
        std::process::exit(2);
    };
    let number = |i: usize, default: f64| rest.get(i).map_or(default, |n| n.parse().unwrap());
    let default = AnytimeParams::default();
    let params =
        AnytimeParams { first_bound: number(0, default.first_bound), bound_step: number(1, default.bound_step) };
    let text = std::fs::read_to_string(map).unwrap();
    let rows: Vec<&str> = text.lines().skip(4).filter(|l| !l.is_empty()).collect();
    let (width, height) = (rows[0].len(), rows.len());
    let blocked: Vec<bool> = rows.iter().flat_map(|row| row.bytes().map(|c| !b".GS".contains(&c))).collect();
    let grid = SearchGrid { blocked: &blocked, factors: &[], width, height };
    let text = std::fs::read_to_string(scenarios).unwrap();
    let rows: Vec<Vec<&str>> = text.lines().skip(1).map(|l| l.split_whitespace().collect()).collect();
    let mut sums = [(0.0, 0); 3];
    let (mut ratios, mut paths) = (0.0, 0);
    for i in 0..QUERIES {
        let n = |k: usize| rows[i * rows.len() / QUERIES][k].parse().unwrap();
        let (start, goal) = (Cell::new(n(4), n(5)), Cell::new(n(6), n(7)));
        let begin = Instant::now();
        let GridPath::Found { cost, expansions, .. } = astar::search(&grid, start, goal, usize::MAX) else { continue };
        sums[0] = (sums[0].0 + begin.elapsed().as_secs_f64(), sums[0].1 + expansions);
        let request = AnytimeRequest { start, goal, params, max_expansions: usize::MAX, stop: None };
        let begin = Instant::now();
        let mut first: Option<(f64, AnytimePath)> = None;
        let mut last = 0;
        search(&grid, &request, &mut |path| {
            first.get_or_insert_with(|| (begin.elapsed().as_secs_f64(), path.clone()));
            (paths, last) = (paths + 1, path.expansions);
        });
        let (seconds, path) = first.unwrap();
        sums[1] = (sums[1].0 + seconds, sums[1].1 + path.expansions);
        sums[2] = (sums[2].0 + begin.elapsed().as_secs_f64(), sums[2].1 + last);
        ratios += path.cost / cost.max(1.0);
    }
    for (name, (seconds, expansions)) in ["A*", "first path", "proven the cheapest"].iter().zip(sums) {
        println!("{name:20} {:9.2} ms  {expansions:9} expansions", seconds * 1e3);
    }
    println!("first over cheapest: mean {:.4}; {paths} paths and bounds told", ratios / QUERIES as f64);
}
