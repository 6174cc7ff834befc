//! Covers what can be reached in a building: `coverage MAP.yaml X Y [TOOL_WIDTH] [RADIUS]`, from (X, Y) in the map's frame.
//!
//! Prints the area, what share of it is covered, the path's length next to the least that lanes of this spacing need, and the
//! time of the whole call, for lanes either way.

#![allow(clippy::unwrap_used, reason = "a tool: it fails loudly")]

use nalgebra::Point2;
use percept_formats::{Limits, nav2};
use percept_mapping::DenseGrid;
use percept_planning::coverage::{CoverageDirection, CoverageLegKind};
use percept_planning::{CoverageOutcome, CoverageParams, PathRequest, PlanParams, plan_coverage};
use std::path::Path;
use std::time::Instant;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [map, x, y, rest @ ..] = &arguments[..] else {
        eprintln!("usage: coverage MAP.yaml X Y [TOOL_WIDTH] [RADIUS]");
        std::process::exit(2);
    };
    let number = |i: usize, default: f64| rest.get(i).map_or(default, |n| n.parse().unwrap());
    let (tool_width_m, robot_radius_m) = (number(0, 0.4), number(1, 0.2));
    let map = nav2::read(Path::new(map), &Limits::default()).unwrap();
    let grid = DenseGrid::new(map.geometry, map.width, map.height, map.cells).unwrap();
    let params = PlanParams { robot_radius_m, ..PlanParams::default() };
    let start = Point2::new(x.parse().unwrap(), y.parse().unwrap());
    for direction in [CoverageDirection::AlongX, CoverageDirection::AlongY] {
        let coverage = CoverageParams { tool_width_m, direction, ..CoverageParams::default() };
        let begin = Instant::now();
        let outcome = plan_coverage(&grid, &PathRequest::new(start, start, &params), &coverage).unwrap();
        let ms = begin.elapsed().as_secs_f64() * 1e3;
        let CoverageOutcome::Path(found) = outcome else {
            println!("{outcome:?}");
            continue;
        };
        let spacing = (tool_width_m * (1.0 - coverage.overlap) / grid.geometry.resolution_m).floor();
        let least = found.coverable_m2 / (spacing * grid.geometry.resolution_m);
        let lanes = found.legs.iter().filter(|leg| leg.kind == CoverageLegKind::Lane).count();
        println!(
            "{direction:?}: {:.1} m2, {:.2} % covered; {:.1} m of way, {:.2} of the least; {} regions, {lanes} stretches of \
             lanes; {} expansions, {ms:.0} ms",
            found.coverable_m2,
            100.0 * found.covered_share,
            found.path.length_m,
            found.path.length_m / least,
            found.num_regions,
            found.path.expansions,
        );
    }
}
