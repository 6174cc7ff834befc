//! The shortest way that can be steered, by a slow search over a fine lattice of poses: what a planner is measured against.
//!
//! Nothing of the planners' search, checks or shortcuts is used, only the curves, which have tests of their own.

use nalgebra::{Point2, Vector2};
use percept_geometry::Cell;
use percept_mapping::DenseGrid;
use percept_planning::Pose2;
use percept_planning::steering::{Arc, Curve, curves, shortest_curve};
use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashSet};
use std::f64::consts::TAU;

/// A robot that steers, and how finely its poses are told apart.
#[derive(Clone, Copy)]
pub(crate) struct Exhaustive<'a> {
    pub(crate) grid: &'a DenseGrid,
    /// Half length and half width of the rectangle around the base, metres.
    pub(crate) half: [f64; 2],
    pub(crate) turning_radius_m: f64,
    pub(crate) allow_reverse: bool,
    /// Edge of a cell of poses, metres, and headings.
    pub(crate) cell_m: f64,
    pub(crate) num_headings: usize,
    /// Poses expanded at most.
    pub(crate) max_expansions: usize,
}

/// What the search found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Shortest {
    /// Length of the shortest way, metres; none if there is none.
    pub(crate) length_m: Option<f64>,
    pub(crate) expansions: usize,
    /// Whether all was looked at that could lead to a shorter one.
    pub(crate) is_done: bool,
}

/// Poses along a way that are looked at are so far apart, metres.
const STEP_M: f64 = 0.01;

/// Curves to the goal are tried within so many turning radii.
const NEAR: f64 = 4.0;

impl Exhaustive<'_> {
    /// A* over poses, of which each cell keeps the one that is reached first, by the length of the unobstructed curve.
    pub(crate) fn search(&self, start: Pose2, goal: Pose2) -> Shortest {
        let turn = TAU / self.num_headings as f64;
        // An arc leaves its cell.
        let turns = (self.cell_m * std::f64::consts::SQRT_2 / (self.turning_radius_m * turn)).ceil();
        let length = self.turning_radius_m * turn * turns;
        let directions: &[f64] = if self.allow_reverse { &[1.0, -1.0] } else { &[1.0] };
        let sides = [0.0, 1.0, -1.0];
        let arc =
            |direction: &f64, side: f64| Arc { curvature: side / self.turning_radius_m, length: direction * length };
        let arcs: Vec<Arc> = directions.iter().flat_map(|d| sides.map(|side| arc(d, side))).collect();
        let mut closed: HashSet<[i32; 3]> = HashSet::new();
        let mut poses = vec![(start, 0.0)];
        let mut open = BinaryHeap::from([Reverse((self.estimate(&start, &goal), 0usize))]);
        let (mut best, mut expansions) = (f64::INFINITY, 0);
        while let Some(Reverse((estimate, index))) = open.pop() {
            let (pose, cost) = poses[index];
            let estimate = f64::from_bits(estimate);
            if estimate >= best || expansions >= self.max_expansions {
                let is_done = estimate >= best;
                return Shortest { length_m: best.is_finite().then_some(best), expansions, is_done };
            }
            if !closed.insert(self.key(&pose)) {
                continue;
            }
            expansions += 1;
            if (goal.position - pose.position).norm() < NEAR * self.turning_radius_m {
                let mut ways: Vec<Curve> = curves(&pose, &goal, self.turning_radius_m, self.allow_reverse);
                ways.retain(|way| cost + way.length_m() < best);
                ways.sort_by(|a, b| a.length_m().total_cmp(&b.length_m()));
                let is_free = |way: &Curve| way.arcs(&pose).all(|(from, arc)| self.is_drivable(&from, &arc));
                if let Some(way) = ways.iter().find(|way| is_free(way)) {
                    best = cost + way.length_m();
                }
            }
            for arc in &arcs {
                let next = arc.after(&pose, arc.length);
                if closed.contains(&self.key(&next)) || !self.is_drivable(&pose, arc) {
                    continue;
                }
                poses.push((next, cost + length));
                let to_goal = f64::from_bits(self.estimate(&next, &goal));
                open.push(Reverse(((cost + length + to_goal).to_bits(), poses.len() - 1)));
            }
        }
        Shortest { length_m: best.is_finite().then_some(best), expansions, is_done: true }
    }

    /// Bits of positive numbers are in their order.
    fn estimate(&self, pose: &Pose2, goal: &Pose2) -> u64 {
        let curve = shortest_curve(pose, goal, self.turning_radius_m, self.allow_reverse);
        curve.map_or(0.0, |curve| curve.length_m()).to_bits()
    }

    fn key(&self, pose: &Pose2) -> [i32; 3] {
        let d = (pose.position - self.grid.geometry.origin) / self.cell_m;
        let heading = (pose.yaw_rad / TAU * self.num_headings as f64).round() as i32;
        [d.x.floor() as i32, d.y.floor() as i32, heading.rem_euclid(self.num_headings as i32)]
    }

    fn is_drivable(&self, from: &Pose2, arc: &Arc) -> bool {
        let steps = (arc.length.abs() / STEP_M).ceil().max(1.0);
        (1..=steps as usize).rev().all(|i| self.fits(&arc.after(from, arc.length * i as f64 / steps)))
    }

    /// Whether the rectangle overlaps no cell that is not free: separating axes of two rectangles.
    pub(crate) fn fits(&self, pose: &Pose2) -> bool {
        let (sin, cos) = pose.yaw_rad.sin_cos();
        let (ahead, left) = (Vector2::new(cos, sin), Vector2::new(-sin, cos));
        let [length, width] = self.half;
        let around = Vector2::new(cos.abs() * length + sin.abs() * width, sin.abs() * length + cos.abs() * width);
        let edge = 0.5 * self.grid.geometry.resolution_m;
        let (low, high) = (pose.position - around, pose.position + around);
        let cell = |p: &Point2<f64>| self.grid.geometry.cell(p);
        let (Some(low), Some(high)) = (cell(&low), cell(&high)) else { return false };
        // A cell's half extent along the rectangle's axes.
        let grown = edge * (cos.abs() + sin.abs()) - 1e-6;
        for (y, x) in (low.y..=high.y).flat_map(|y| (low.x..=high.x).map(move |x| (y, x))) {
            let cell = Cell::new(x, y);
            if self.grid.value(cell).is_some_and(|v| v.is_some_and(|v| v < 60)) {
                continue;
            }
            let off = self.grid.geometry.center(cell) - pose.position;
            let is_apart = off.x.abs() >= around.x + edge - 1e-6
                || off.y.abs() >= around.y + edge - 1e-6
                || off.dot(&ahead).abs() >= length + grown
                || off.dot(&left).abs() >= width + grown;
            if !is_apart {
                return false;
            }
        }
        true
    }
}
