//! Published optimal lengths (Sturtevant, "Benchmarks for grid-based pathfinding", 2012); skipped where the data is not.

#![allow(clippy::unwrap_used, clippy::panic, reason = "all of it is tests")]

use percept_geometry::Cell;
use percept_planning::{GridPath, shortest_path};
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
        for row in rows.iter().step_by((rows.len() / 25).max(1)) {
            let columns: Vec<&str> = row.split_whitespace().collect();
            let number = |i: usize| columns[i].parse::<i32>().unwrap();
            let (start, goal) = (Cell::new(number(4), number(5)), Cell::new(number(6), number(7)));
            let optimal: f64 = columns[8].parse().unwrap();
            let found = shortest_path(&map.blocked, map.width, map.height, start, goal, usize::MAX);
            let GridPath::Found { cells, cost, .. } = found else { panic!("{path:?} {row}: {found:?}") };
            assert!((cost - optimal).abs() <= 1e-5 * optimal + 0.005, "{path:?} {row}: {cost}");
            assert_eq!((cells[0], cells[cells.len() - 1]), (start, goal));
            for pair in cells.windows(2) {
                let (a, b) = (pair[0], pair[1]);
                assert!(a.x.abs_diff(b.x) <= 1 && a.y.abs_diff(b.y) <= 1 && a != b);
                for cell in [b, Cell::new(a.x, b.y), Cell::new(b.x, a.y)] {
                    assert!(!map.blocked[cell.y as usize * map.width + cell.x as usize]);
                }
            }
            checked += 1;
        }
    }
    assert!(checked >= 25);
}
