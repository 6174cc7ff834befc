//! Planning against brute force and closed forms.

// Helpers of tests may fail as tests do.
#![allow(clippy::unwrap_used, clippy::panic)]

mod answers;
mod any_angle;
mod anytime;
mod checker;
mod clearance;
mod coverage;
mod ends;
mod exhaustive;
mod flight;
mod frontier;
mod repair;
mod search;
mod steer;
mod steering;
mod validate;
mod worlds;

use nalgebra::Point2;
use percept_geometry::GridGeometry;
use percept_mapping::DenseGrid;
use percept_planning::{NoPathReason, Path, PlanOutcome, PlanParams, plan_dense};

/// A map drawn in text, the first line at the top: `#` occupied, `?` unknown, else free; cells of 0.1 m from the origin.
pub(crate) fn drawn(rows: &[&str]) -> DenseGrid {
    let width = rows[0].len();
    let value = |c: u8| match c {
        b'#' => 100,
        b'?' => -1,
        _ => 0,
    };
    let cells = rows.iter().rev().flat_map(|row| row.bytes().map(value)).collect();
    DenseGrid::new(GridGeometry::new(0.1, Point2::origin()), width, rows.len(), cells).unwrap()
}

/// A free map of this size within a wall one cell thick.
pub(crate) fn hall(width: usize, height: usize) -> DenseGrid {
    let wall = |x: usize, y: usize| x == 0 || y == 0 || x + 1 == width || y + 1 == height;
    let cells = (0..width * height).map(|i| if wall(i % width, i / width) { 100 } else { 0 }).collect();
    DenseGrid::new(GridGeometry::new(0.1, Point2::origin()), width, height, cells).unwrap()
}

pub(crate) fn path(grid: &DenseGrid, start: [f64; 2], goal: [f64; 2], params: &PlanParams) -> Path {
    match plan_dense(grid, Point2::from(start), Point2::from(goal), params).unwrap() {
        PlanOutcome::Path(path) => path,
        PlanOutcome::NoPath { reason, .. } => panic!("no path: {reason:?}"),
    }
}

pub(crate) fn reason(grid: &DenseGrid, start: [f64; 2], goal: [f64; 2], params: &PlanParams) -> NoPathReason {
    match plan_dense(grid, Point2::from(start), Point2::from(goal), params).unwrap() {
        PlanOutcome::Path(path) => panic!("a path: {path:?}"),
        PlanOutcome::NoPath { reason, .. } => reason,
    }
}
