//! Published optimal lengths (Sturtevant, "Benchmarks for grid-based pathfinding", 2012); skipped where the data is not.

use percept_geometry::Cell;
use percept_planning::{GridPath, shortest_path};
use std::path::{Path, PathBuf};

fn folder() -> Option<PathBuf> {
    let data = std::env::var_os("PERCEPT_DATA").map(PathBuf::from);
    let beside = Path::new(&std::env::var("CARGO_MANIFEST_DIR").unwrap()).ancestors().nth(3)?.join("shared/data");
    Some(data.unwrap_or(beside).join("planning-movingai")).filter(|p| p.is_dir())
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

#[test]
fn optimal_lengths_of_the_moving_ai_scenarios_are_met() {
    let Some(folder) = folder() else { return eprintln!("skipped: no data") };
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
