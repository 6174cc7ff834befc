//! What a path is worth that has to be there in time: `deadline MAP SCENARIOS [TIMES]`.
//!
//! Fifty queries spread evenly over a Moving AI scenario file, on its map with cells of 0.1 m, each cell made TIMES by TIMES (1).
//! Prints the time without a deadline, and for each deadline how many have a path, how many the cheapest, the bounds that are
//! told, by how much paths really cost more, and by how much the answers were late.

#![allow(clippy::unwrap_used, reason = "a tool: it fails loudly")]

use nalgebra::Point2;
use percept_geometry::GridGeometry;
use percept_mapping::DenseGrid;
use percept_planning::{PathRequest, PlanOutcome, PlanParams, plan_path};
use std::time::{Duration, Instant};

const QUERIES: usize = 50;
const DEADLINES_MS: [u64; 9] = [1, 2, 5, 10, 20, 50, 100, 200, 500];

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [map, scenarios, rest @ ..] = &arguments[..] else {
        eprintln!("usage: deadline MAP SCENARIOS [TIMES]");
        std::process::exit(2);
    };
    let times: usize = rest.first().map_or(1, |n| n.parse().unwrap());
    let text = std::fs::read_to_string(map).unwrap();
    let rows: Vec<&[u8]> = text.lines().skip(4).filter(|l| !l.is_empty()).map(str::as_bytes).collect();
    let (width, height) = (rows[0].len() * times, rows.len() * times);
    let value = |i: usize| if b".GS".contains(&rows[i / width / times][i % width / times]) { 0 } else { 100 };
    let cells = (0..width * height).map(value).collect();
    let geometry = GridGeometry::new(0.1, Point2::origin());
    let grid = DenseGrid { geometry, width, height, cells };
    let params = PlanParams { robot_radius_m: 0.05, max_cells: 4_000_000_000, ..PlanParams::default() };
    let text = std::fs::read_to_string(scenarios).unwrap();
    let rows: Vec<Vec<&str>> = text.lines().skip(1).map(|l| l.split_whitespace().collect()).collect();
    let at = |i: usize, k: usize| -> f64 { (rows[i][k].parse::<f64>().unwrap() + 0.5) * 0.1 * times as f64 };
    let ends = (0..QUERIES).map(|q| q * rows.len() / QUERIES);
    let ends: Vec<[Point2<f64>; 2]> =
        ends.map(|i| [Point2::new(at(i, 4), at(i, 5)), Point2::new(at(i, 6), at(i, 7))]).collect();
    let mut least = vec![];
    let mut took = vec![];
    for [start, goal] in &ends {
        let begun = Instant::now();
        let found = plan_path(&grid, &PathRequest::new(*start, *goal, &params)).unwrap();
        took.push(begun.elapsed().as_secs_f64() * 1e3);
        least.push(if let PlanOutcome::Path(path) = found { Some(path.cost) } else { None });
    }
    let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len().max(1) as f64;
    let most = |v: &[f64]| v.iter().copied().fold(0.0, f64::max);
    let with_path = least.iter().flatten().count();
    println!("{width} x {height}: {with_path} of {QUERIES} have a path");
    println!("no deadline: {:.1} ms mean, {:.1} ms most", mean(&took), most(&took));
    for deadline in DEADLINES_MS.map(Duration::from_millis) {
        let (mut bounds, mut over, mut late, mut finals) = (vec![], vec![], vec![], 0);
        for ([start, goal], least) in ends.iter().zip(&least) {
            let Some(least) = least else { continue };
            let begun = Instant::now();
            let stop = || begun.elapsed() >= deadline;
            let request = PathRequest { stop: Some(&stop), ..PathRequest::new(*start, *goal, &params) };
            let found = plan_path(&grid, &request).unwrap();
            late.push((begun.elapsed().as_secs_f64() - deadline.as_secs_f64()).max(0.0) * 1e3);
            if let PlanOutcome::Path(path) = found {
                bounds.push(path.bound.unwrap());
                over.push(path.cost / least.max(1e-9));
                finals += usize::from(path.is_final);
            }
        }
        let (num, mean_bound, most_bound) = (bounds.len(), mean(&bounds), most(&bounds));
        let (mean_over, most_over, mean_late, most_late) = (mean(&over), most(&over), mean(&late), most(&late));
        println!(
            "{:4} ms: {num:3} paths, {finals:3} the cheapest; bound {mean_bound:.3} mean, {most_bound:.3} most; cost over the \
             cheapest {mean_over:.4} mean, {most_over:.4} most; late by {mean_late:.1} ms mean, {most_late:.1} ms most",
            deadline.as_millis()
        );
    }
}
