//! Measures steered paths against the shortest that a slow search over a fine lattice finds: `exhaustive [WORLDS] [CELL]
//! [HEADINGS] [REFINE_EXPANSIONS] [FIRST_WORLD]`, or `exhaustive MAP.yaml X Y YAW X Y YAW [CELL] [HEADINGS]` for one pair of poses.
//!
//! Worlds are rooms of 4 x 3 m with walls and blocks at random, in cells of 0.05 m; the robot is a rectangle of 0.6 x 0.4 m with
//! a turning radius of 0.5 m. Length alone is what costs. On a map the robot is that of `examples/hybrid.rs`.

#![allow(clippy::unwrap_used, reason = "a tool: it fails loudly")]

#[path = "../tests/it/exhaustive.rs"]
mod exhaustive;

use exhaustive::Exhaustive;
use nalgebra::Point2;
use percept_formats::{Limits, nav2};
use percept_geometry::GridGeometry;
use percept_mapping::DenseGrid;
use percept_planning::{
    Footprint, Goal, HybridParams, PathRequest, PlanOutcome, PlanParams, Planner, Pose2, plan_path,
};
use std::path::Path;
use std::time::Instant;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    if arguments.first().is_some_and(|a| a.ends_with(".yaml")) {
        return one_pair(&arguments);
    }
    let number = |i: usize, default: f64| arguments.get(i).map_or(default, |n| n.parse().unwrap());
    let (worlds, cell_m, num_headings) = (number(0, 20.0) as u64, number(1, 0.04), number(2, 96.0) as usize);
    let first = number(4, 0.0) as u64;
    let hybrid = HybridParams {
        turning_radius_m: 0.5,
        reverse_cost: 1.0,
        turning_cost: 1.0,
        direction_change_cost_m: 0.0,
        refine_expansions: number(3, HybridParams::default().refine_expansions as f64) as usize,
        ..HybridParams::default()
    };
    let mut times = vec![];
    let (mut ratios, mut missed, mut none) = (vec![], 0, 0);
    for seed in first..first + worlds {
        let (grid, start, goal) = world(seed);
        let exhaustive = Exhaustive {
            grid: &grid,
            half: [0.3, 0.2],
            turning_radius_m: 0.5,
            allow_reverse: true,
            cell_m,
            num_headings,
            max_expansions: 3_000_000,
        };
        let begin = Instant::now();
        let shortest = exhaustive.search(start, goal);
        let seconds = begin.elapsed().as_secs_f64();
        let begin = processor_ms();
        let found = steered(&grid, [0.6, 0.4], start, goal, hybrid);
        let ms = processor_ms() - begin;
        times.push(ms);
        println!("{seed}: {shortest:?} in {seconds:.1} s; steered {found:?} m in {ms:.1} ms");
        match (shortest.length_m, found) {
            (Some(shortest), Some(found)) => ratios.push(found / shortest),
            (Some(_), None) => missed += 1,
            (None, _) => none += 1,
        }
    }
    times.sort_by(f64::total_cmp);
    println!(
        "steered in ms: median {:.1}, p90 {:.1}, most {:.1}",
        times[times.len() / 2],
        times[times.len() * 9 / 10],
        times[times.len() - 1]
    );
    ratios.sort_by(f64::total_cmp);
    let share = |s: f64| ratios[((ratios.len() - 1) as f64 * s) as usize];
    println!(
        "{} worlds: {missed} found by the exhaustive search alone, {none} not by it; length over the shortest: mean {:.4}, \
         median {:.4}, p90 {:.4}, most {:.4}; {} within 3 %",
        worlds,
        ratios.iter().sum::<f64>() / ratios.len() as f64,
        share(0.5),
        share(0.9),
        share(1.0),
        ratios.iter().filter(|r| **r <= 1.03).count(),
    );
}

fn one_pair(arguments: &[String]) {
    let map = nav2::read(Path::new(&arguments[0]), &Limits::default()).unwrap();
    let grid = DenseGrid::new(map.geometry, map.width, map.height, map.cells).unwrap();
    let number = |i: usize, default: f64| arguments.get(i).map_or(default, |n| n.parse().unwrap());
    let pose =
        |i: usize| Pose2 { position: Point2::new(number(i, 0.0), number(i + 1, 0.0)), yaw_rad: number(i + 2, 0.0) };
    let exhaustive = Exhaustive {
        grid: &grid,
        half: [0.45, 0.3],
        turning_radius_m: 0.8,
        allow_reverse: true,
        cell_m: number(7, 0.02),
        num_headings: number(8, 360.0) as usize,
        max_expansions: 10_000_000,
    };
    let (start, goal) = (pose(1), pose(4));
    println!("fits: {} {}", exhaustive.fits(&start), exhaustive.fits(&goal));
    println!("{:?}", exhaustive.search(start, goal));
    println!("steered: {:?} m", steered(&grid, [0.9, 0.6], start, goal, HybridParams::default()));
}

fn steered(grid: &DenseGrid, size: [f64; 2], start: Pose2, goal: Pose2, hybrid: HybridParams) -> Option<f64> {
    let params = PlanParams { start_tolerance_m: 0.0, clearance_weight: 0.0, ..PlanParams::default() };
    let footprint = Footprint::rectangle(size[0], size[1]);
    let request = PathRequest {
        goal: Goal { position: goal.position, yaw_rad: Some(goal.yaw_rad) },
        start,
        planner: Planner::Hybrid(hybrid),
        footprint: Some(&footprint),
        ..PathRequest::new(start.position, goal.position, &params)
    };
    match plan_path(grid, &request).unwrap() {
        PlanOutcome::Path(path) => Some(path.length_m),
        PlanOutcome::NoPath { reason, .. } => {
            println!("{reason:?}: {start:?} {goal:?}");
            None
        }
    }
}

/// A room, and two poses in it where the robot fits.
fn world(seed: u64) -> (DenseGrid, Pose2, Pose2) {
    let mut random = Random(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) + 1);
    let (width, height) = (80, 60);
    let wall = |x: usize, y: usize| x == 0 || y == 0 || x + 1 == width || y + 1 == height;
    let mut cells: Vec<i8> = (0..width * height).map(|i| if wall(i % width, i / width) { 100 } else { 0 }).collect();
    for _ in 0..6 + random.below(8) {
        let (x, y) = (random.below(width), random.below(height));
        let long = 5 + random.below(20);
        let (w, h) = if random.below(2) == 0 { (long, 1 + random.below(5)) } else { (1 + random.below(5), long) };
        (y..(y + h).min(height)).for_each(|y| (x..(x + w).min(width)).for_each(|x| cells[y * width + x] = 100));
    }
    let grid = DenseGrid::new(GridGeometry::new(0.05, Point2::origin()), width, height, cells).unwrap();
    let robot = Exhaustive {
        grid: &grid,
        half: [0.3, 0.2],
        turning_radius_m: 0.5,
        allow_reverse: true,
        cell_m: 1.0,
        num_headings: 1,
        max_expansions: 0,
    };
    let mut pose = || loop {
        let position = Point2::new(random.below(4000) as f64 / 1000.0, random.below(3000) as f64 / 1000.0);
        let found = Pose2 { position, yaw_rad: random.below(6283) as f64 / 1000.0 - std::f64::consts::PI };
        if robot.fits(&found) {
            return found;
        }
    };
    let (start, goal) = (pose(), pose());
    (grid, start, goal)
}

/// Time that this thread was on a processor, milliseconds: what others run does not count.
fn processor_ms() -> f64 {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap();
    text.split_whitespace().next().unwrap().parse::<f64>().unwrap() / 1e6
}

/// Small generator (Knuth's MMIX constants): the same worlds everywhere.
struct Random(u64);

impl Random {
    fn below(&mut self, n: usize) -> usize {
        self.0 = self.0.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (self.0 >> 33) as usize % n
    }
}
