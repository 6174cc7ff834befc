//! Published optimal lengths of every scenario (Sturtevant, "Benchmarks for grid-based pathfinding", 2012); skipped where the data is not.

#![allow(clippy::unwrap_used, clippy::panic, reason = "all of it is tests")]

use percept_geometry::Cell;
use percept_planning::{GridPath, SearchGrid, astar::search, shortest_path};
use std::path::{Path, PathBuf};

percept_recorded::tests! {
    optimal_lengths_of_the_moving_ai_scenarios_are_met: "planning-movingai";
}

struct Map {
    blocked: Vec<bool>,
    width: usize,
    height: usize,
}

fn read_map(path: &Path) -> Map {
    let text = std::fs::read_to_string(path).unwrap();
    let rows: Vec<&str> = text.lines().skip_while(|l| l.trim() != "map").skip(1).filter(|l| !l.is_empty()).collect();
    let blocked = rows.iter().flat_map(|row| row.bytes().map(|c| !matches!(c, b'.' | b'G' | b'S'))).collect();
    Map { blocked, width: rows[0].len(), height: rows.len() }
}

fn optimal_lengths_of_the_moving_ai_scenarios_are_met(data: &Path) {
    let folder = data.join("planning-movingai");
    let mut maps: Vec<PathBuf> = std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()).collect();
    maps.retain(|p| p.extension().is_some_and(|e| e == "map"));
    maps.sort();
    assert!(!maps.is_empty());
    let mut checked = 0;
    for path in maps {
        let map = read_map(&path);
        let text = std::fs::read_to_string(path.with_extension("map.scen")).unwrap();
        let rows: Vec<&str> = text.lines().skip(1).filter(|l| !l.trim().is_empty()).collect();
        for (i, row) in rows.iter().enumerate() {
            let columns: Vec<&str> = row.split_whitespace().collect();
            let number = |i: usize| columns[i].parse::<i32>().unwrap();
            let (start, goal) = (Cell::new(number(4), number(5)), Cell::new(number(6), number(7)));
            let optimal: f64 = columns[8].parse().unwrap();
            let check = |found: GridPath| {
                let GridPath::Found { cells, cost, .. } = found else { panic!("{path:?} {row}: {found:?}") };
                assert!((cost - optimal).abs() <= 1e-5 * optimal + 0.005, "{path:?} {row}: {cost}");
                assert_eq!((cells[0], cells[cells.len() - 1]), (start, goal));
                assert!((walked(&map, &cells) - cost).abs() < 1e-6, "{path:?} {row}: {cost}");
            };
            check(shortest_path(&map.blocked, map.width, map.height, start, goal, usize::MAX));
            if i % (rows.len() / 25).max(1) == 0 {
                let grid = SearchGrid { blocked: &map.blocked, factors: &[], width: map.width, height: map.height };
                check(search(&grid, start, goal, usize::MAX));
            }
            checked += 1;
        }
    }
    assert!(checked >= 25);
}

/// Length of a way that goes from free cell to free cell beside it and cuts no corner, in cells.
fn walked(map: &Map, cells: &[Cell]) -> f64 {
    let is_free = |c: Cell| !map.blocked[c.y as usize * map.width + c.x as usize];
    let step = |pair: &[Cell]| {
        let (a, b) = (pair[0], pair[1]);
        assert!(a.x.abs_diff(b.x) <= 1 && a.y.abs_diff(b.y) <= 1 && a != b);
        assert!([a, b, Cell::new(a.x, b.y), Cell::new(b.x, a.y)].into_iter().all(is_free));
        f64::from(a.x - b.x).hypot(f64::from(a.y - b.y))
    };
    cells.windows(2).map(step).sum()
}
