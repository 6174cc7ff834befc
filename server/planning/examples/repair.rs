//! Repairs paths as a map changes around a robot: `repair MAP SCENARIOS [REACH] [ROUNDS]`.
//!
//! For ten of a Moving AI scenario file's queries the robot goes along its path by ten cells a round (ROUNDS, 20); each time 1
//! in 100 of the cells within REACH (32) of it change between free and blocked. Prints expansions and times, summed, of the
//! search that is kept (from the second question on; the first apart) and of A* from scratch, whose costs are compared.

#![allow(clippy::unwrap_used, reason = "a tool: it fails loudly")]

use percept_geometry::Cell;
use percept_planning::{GridPath, RepairingPlanner, SearchGrid, astar};
use std::time::Instant;

const QUERIES: usize = 10;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [map, scenarios, rest @ ..] = &arguments[..] else {
        eprintln!("usage: repair MAP SCENARIOS [REACH] [ROUNDS]");
        std::process::exit(2);
    };
    let number = |i: usize, default: i32| rest.get(i).map_or(default, |n| n.parse().unwrap());
    let (reach, rounds) = (number(0, 32), number(1, 20));
    let text = std::fs::read_to_string(map).unwrap();
    let rows: Vec<&str> = text.lines().skip(4).filter(|l| !l.is_empty()).collect();
    let (width, height) = (rows[0].len(), rows.len());
    let map: Vec<bool> = rows.iter().flat_map(|row| row.bytes().map(|c| !b".GS".contains(&c))).collect();
    let text = std::fs::read_to_string(scenarios).unwrap();
    let rows: Vec<Vec<&str>> = text.lines().skip(1).map(|l| l.split_whitespace().collect()).collect();
    let mut random = 1u64;
    let mut below = |n: i32| {
        random = random.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (random >> 33) as i32 % n
    };
    let (mut first, mut repaired, mut scratch, mut wrong, mut asked) = ((0, 0.0), (0, 0.0), (0, 0.0), 0, 0);
    for i in 0..QUERIES {
        // The later ones are the longer ones.
        let n = |k: usize| rows[(QUERIES + i) * rows.len() / (2 * QUERIES)][k].parse().unwrap();
        let (mut start, goal) = (Cell::new(n(4), n(5)), Cell::new(n(6), n(7)));
        let mut blocked = map.clone();
        let mut planner =
            RepairingPlanner::new(&SearchGrid { blocked: &blocked, factors: &[], width, height }, goal).unwrap();
        for round in 0..rounds {
            let begin = Instant::now();
            if round > 0 {
                let mut changes = vec![];
                for _ in 0..(2 * reach + 1) * (2 * reach + 1) / 100 {
                    let at = Cell::new(start.x - reach + below(2 * reach + 1), start.y - reach + below(2 * reach + 1));
                    let inside = at.x >= 0 && at.y >= 0 && (at.x as usize) < width && (at.y as usize) < height;
                    if inside && at != start && at != goal {
                        let index = at.y as usize * width + at.x as usize;
                        blocked[index] = !blocked[index];
                        changes.push((at, blocked[index]));
                    }
                }
                planner.set_blocked(&changes).unwrap();
            }
            let found = planner.path(start, usize::MAX);
            let seconds = begin.elapsed().as_secs_f64();
            let begin = Instant::now();
            let grid = SearchGrid { blocked: &blocked, factors: &[], width, height };
            let anew = astar::search(&grid, start, goal, usize::MAX);
            let seconds_anew = begin.elapsed().as_secs_f64();
            let count = |path: &GridPath| match path {
                GridPath::Found { expansions, .. } | GridPath::Unreachable { expansions } => *expansions,
                GridPath::SearchLimit => 0,
            };
            let sum = if round == 0 { &mut first } else { &mut repaired };
            *sum = (sum.0 + count(&found), sum.1 + seconds);
            if round > 0 {
                asked += 1;
                scratch = (scratch.0 + count(&anew), scratch.1 + seconds_anew);
            }
            match (found, anew) {
                (GridPath::Found { cells, cost, .. }, GridPath::Found { cost: least, .. }) => {
                    wrong += usize::from((cost - least).abs() > 1e-6 * least);
                    start = cells[10.min(cells.len() - 1)];
                }
                (GridPath::Unreachable { .. }, GridPath::Unreachable { .. }) => break,
                _ => wrong += 1,
            }
            if start == goal {
                break;
            }
        }
    }
    println!("{asked} repairs; costs that differ: {wrong}");
    for (name, (expansions, seconds)) in [("first searches", first), ("repairs", repaired), ("A* each time", scratch)] {
        println!("{name:15} {expansions:9} expansions  {:9.2} ms", seconds * 1e3);
    }
}
