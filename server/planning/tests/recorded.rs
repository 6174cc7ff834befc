//! Published optimal lengths of every scenario (Sturtevant, "Benchmarks for grid-based pathfinding", 2012), and tight places of a
//! building; skipped where the data is not.

#![allow(clippy::unwrap_used, clippy::panic, reason = "all of it is tests")]

use nalgebra::Point2;
use percept_formats::{Limits, nav2};
use percept_geometry::Cell;
use percept_mapping::DenseGrid;
use percept_planning::{
    Footprint, Goal, GridPath, HybridParams, PathRequest, PlanOutcome, PlanParams, Planner, Pose2, SearchGrid,
    astar::search, jump_point_search, plan_path, shortest_path, validate_path,
};
use std::path::{Path, PathBuf};

percept_recorded::tests! {
    optimal_lengths_of_the_moving_ai_scenarios_are_met: "planning-movingai";
    poses_that_only_short_arcs_leave_are_left: "planning-ros-maps";
}

/// Two pairs of poses in tb3_sandbox between which an exhaustive search finds ways of 1.6 and 1.9 m, and for which there was said
/// to be none: every arc that leaves a cell as large as the map's ran into something.
fn poses_that_only_short_arcs_leave_are_left(data: &Path) {
    let map = nav2::read(&data.join("planning-ros-maps/tb3_sandbox.yaml"), &Limits::default()).unwrap();
    let grid = DenseGrid::new(map.geometry, map.width, map.height, map.cells).unwrap();
    let params = PlanParams { start_tolerance_m: 0.0, ..PlanParams::default() };
    let footprint = Footprint::rectangle(0.9, 0.6);
    for [a, b] in [
        [[0.080_941_858, -1.870_744_053, 2.019_197_318], [0.407_772_904, -1.761_404_109, 2.011_276_243]],
        [[0.185_431_720, 1.852_565_844, 1.097_316_881], [-0.243_809_612, 1.938_368_597, -1.308_089_597]],
    ] {
        let pose = |[x, y, yaw_rad]: [f64; 3]| Pose2 { position: Point2::new(x, y), yaw_rad };
        let request = PathRequest {
            start: pose(a),
            goal: Goal { position: pose(b).position, yaw_rad: Some(pose(b).yaw_rad) },
            planner: Planner::Hybrid(HybridParams::default()),
            footprint: Some(&footprint),
            ..PathRequest::new(pose(a).position, pose(b).position, &params)
        };
        let PlanOutcome::Path(path) = plan_path(&grid, &request).unwrap() else { panic!("no path from {a:?}") };
        let poses: Vec<Pose2> =
            path.waypoints.iter().map(|w| Pose2 { position: w.position, yaw_rad: w.yaw_rad }).collect();
        assert_eq!(validate_path(&grid, &poses, &request).unwrap(), None);
    }
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
            let grid = SearchGrid { blocked: &map.blocked, factors: &[], width: map.width, height: map.height };
            check(jump_point_search(&grid, start, goal, usize::MAX));
            if i % (rows.len() / 25).max(1) == 0 {
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
