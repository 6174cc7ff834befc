//! Times paths that a robot steers through building maps: `hybrid MAP.yaml [PAIRS] [SEED] [TOLERANCE]`.
//!
//! The robot is a rectangle of 0.9 x 0.6 m with a turning radius of 0.8 m. Pairs of poses are drawn at random where it fits
//! and where a disc that covers it can go from one to the other over cells. Prints how many paths are found, the
//! processor's times of whole calls (map and poses in, path out), and the mean of the paths' lengths over those of the shortest ways of the base
//! at any angle.

#![allow(clippy::unwrap_used, reason = "a tool: it fails loudly")]

use nalgebra::Point2;
use percept_formats::{Limits, nav2};
use percept_mapping::DenseGrid;
use percept_planning::{
    Costmap, Footprint, Goal, HybridParams, PathRequest, PlanOutcome, PlanParams, Planner, Pose2, plan_dense, plan_path,
};
use std::path::Path;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [map, rest @ ..] = &arguments[..] else {
        eprintln!("usage: hybrid MAP.yaml [PAIRS] [SEED] [TOLERANCE]");
        std::process::exit(2);
    };
    let pairs = rest.first().map_or(1000, |n| n.parse().unwrap());
    let mut random = Random(rest.get(1).map_or(1, |n| n.parse().unwrap()));
    let map = nav2::read(Path::new(map), &Limits::default()).unwrap();
    let grid = DenseGrid::new(map.geometry, map.width, map.height, map.cells).unwrap();
    let params = PlanParams { start_tolerance_m: 0.0, ..PlanParams::default() };
    let footprint = Footprint::rectangle(0.9, 0.6);
    let wide = footprint.circumscribed_radius_m();
    let disc = PlanParams { robot_radius_m: wide, inflation_radius_m: wide, clearance_weight: 0.0, ..params };
    let mut hybrid = HybridParams::default();
    hybrid.tolerance = rest.get(2).map_or(hybrid.tolerance, |n| n.parse().unwrap());
    let costmap = Costmap::new(&grid, &Point2::origin(), &disc);
    let fits = |p: &Pose2| costmap.cell(&p.position).is_some_and(|cell| costmap.fits(cell));
    let (mut times, mut ratios, mut failed, mut expansions) = (vec![], vec![], 0, 0);
    let mut slowest = (0.0, String::new());
    while times.len() < pairs {
        let (start, goal) = (random.pose(&grid), random.pose(&grid));
        if !fits(&start) || !fits(&goal) {
            continue;
        }
        let PlanOutcome::Path(shortest) = plan_dense(&grid, start.position, goal.position, &disc).unwrap() else {
            continue;
        };
        let request = PathRequest {
            goal: Goal { position: goal.position, yaw_rad: Some(goal.yaw_rad) },
            start,
            planner: Planner::Hybrid(hybrid),
            footprint: Some(&footprint),
            ..PathRequest::new(start.position, goal.position, &params)
        };
        let begin = processor_ms();
        let outcome = plan_path(&grid, &request).unwrap();
        times.push(processor_ms() - begin);
        if times[times.len() - 1] > slowest.0 {
            slowest = (times[times.len() - 1], format!("{start:?} {goal:?}"));
        }
        match outcome {
            PlanOutcome::Path(path) => {
                ratios.push(path.length_m / shortest.length_m.max(0.1));
                expansions += path.expansions;
            }
            PlanOutcome::NoPath { reason, .. } => {
                println!("{reason:?}: {start:?} {goal:?}");
                failed += 1;
            }
        }
    }
    times.sort_by(f64::total_cmp);
    let share = |s: f64| times[((times.len() - 1) as f64 * s) as usize];
    ratios.sort_by(f64::total_cmp);
    println!(
        "{} pairs, {failed} without a path; ms: p50 {:.2}  p90 {:.2}  p99 {:.2}  most {:.2}",
        times.len(),
        share(0.5),
        share(0.9),
        share(0.99),
        share(1.0),
    );
    println!(
        "length over the shortest of a disc: mean {:.3}, median {:.3}; {} expansions in the mean",
        ratios.iter().sum::<f64>() / ratios.len() as f64,
        ratios[ratios.len() / 2],
        expansions / times.len(),
    );
    println!("slowest: {}", slowest.1);
}

/// Time that this thread was on a processor, milliseconds: what others run does not count.
fn processor_ms() -> f64 {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap();
    text.split_whitespace().next().unwrap().parse::<f64>().unwrap() / 1e6
}

/// Small generator (Knuth's MMIX constants): the same pairs everywhere.
struct Random(u64);

impl Random {
    fn share(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }

    fn pose(&mut self, grid: &DenseGrid) -> Pose2 {
        let (origin, size) = (grid.geometry.origin, grid.geometry.resolution_m);
        let (x, y) = (self.share() * grid.width as f64, self.share() * grid.height as f64);
        let yaw_rad = (self.share() * 2.0 - 1.0) * std::f64::consts::PI;
        Pose2 { position: Point2::new(origin.x + x * size, origin.y + y * size), yaw_rad }
    }
}
