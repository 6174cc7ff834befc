//! Hybrid A*: paths that a robot can steer, with a footprint that turns with it.
//!
//! Comes in: a costmap, a footprint, two poses and how the robot steers. Goes out: arcs one after the other. Start with
//! [`Hybrid::search`]; [`shortcut()`] makes its answer shorter.

mod cost;
mod levels;
mod params;
mod refine;
mod shortcut;

use levels::Level;
pub use params::HybridParams;
pub(crate) use {cost::DrivingCost, levels::Steering, shortcut::shortcut};

use crate::astar::SearchGrid;
use crate::fit::{Fit, Motion};
use crate::flood::Flood;
use crate::steering::{Arc, Curve, each_curve};
use crate::{Costmap, Goal, Pose2};
use percept_geometry::{Cell, se3::wrap_angle};
use rustc_hash::FxHashMap;
use std::cmp::Ordering;
use std::collections::BinaryHeap;
use std::f64::consts::TAU;

/// Arcs one after the other, each with the pose where it begins.
pub(crate) type Arcs = Vec<(Pose2, Arc)>;

/// What a search came to.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum HybridPath {
    /// A way.
    Found {
        arcs: Arcs,
        /// Its cost over the least estimate of what was left open; at least 1.
        bound: f64,
        /// Whether the search came to its end.
        is_final: bool,
        expansions: usize,
    },
    /// All that can be driven to was looked at.
    Exhausted { expansions: usize },
    /// Not even the way over cells, for the largest disc that the footprint holds.
    Apart,
    /// The limit of expansions was reached, or the caller's stop, before a way was found.
    Stopped { by_caller: bool },
}

/// Limits of a search.
#[derive(Clone, Copy)]
pub(crate) struct Limits<'a> {
    pub(crate) max_expansions: usize,
    pub(crate) stop: Option<&'a (dyn Fn() -> bool + Sync)>,
    /// Ways that cost as much or more are not looked for.
    pub(crate) cheaper_than: f64,
}

/// Curves to the goal that are tried from one pose, cheapest first: of 72 words, few differ much.
const TRIED_CURVES: usize = 6;

/// Headings tried at a goal that has none.
const GOAL_HEADINGS: usize = 8;

/// Nearer to the goal than so many turning radii the heading is estimated too. Farther off, the way over cells is most of
/// it, and curves cost more time than they save: on depot, the 99th percentile of times is 52 ms at 3, 69 at 5, 72 at 8.
const TURNS_NEAR: f64 = 3.0;

/// A straight way over the longest that eight neighbours make of it, at an angle of 22.5 degrees: its cosine.
const STRAIGHT: f64 = 0.923_879_532_511_286_7;

/// Source: Dolgov, Thrun, Montemerlo and Diebel, "Practical search techniques in path planning for autonomous driving",
/// 2008: cells of position and heading that each keep one exact pose; an estimate that is the larger of the way over cells
/// and the unobstructed curve; curves to the goal tried from now and then, more often the nearer it is. We depart from it:
/// the way over cells is weighed by clearance, as the path is, and a curve found is kept until nothing that is open can be
/// better by more than `tolerance`.
pub(crate) struct Hybrid<'a> {
    cost: DrivingCost<'a>,
    fit: &'a Fit<'a>,
    goal: Goal,
    /// From each cell to the goal's, in cells, weighted.
    over_cells: Flood<'a>,
    /// What may be driven from a pose.
    arcs: Vec<Arc>,
    cell_m: f64,
    is_exact: bool,
    nodes: Vec<Node>,
    node_of: FxHashMap<(u32, u32, u32), u32>,
    open: BinaryHeap<Open>,
}

#[derive(Clone, Copy)]
struct Node {
    pose: Pose2,
    cost: f64,
    /// Estimate from here to the goal: at first that over cells.
    remaining: f64,
    /// Whether headings have entered it: most nodes are never expanded, and need not know.
    knows_heading: bool,
    /// How it was reached; none at the start.
    came: Option<(u32, Arc)>,
    is_closed: bool,
}

/// A way found: from which node, by which curve.
struct Finish {
    cost: f64,
    node: u32,
    curve: Curve,
}

impl<'a> Hybrid<'a> {
    /// `closed` is what [`closed_cells`] gave for the same footprint.
    pub(crate) fn new(
        costmap: &'a Costmap,
        fit: &'a Fit<'a>,
        closed: &'a [bool],
        goal: Goal,
        params: HybridParams,
        level: &Level,
    ) -> Self {
        let cell_m = level.cell_m(costmap, &params);
        let params = HybridParams { num_headings: params.num_headings * level.headings, ..params };
        let heading = TAU / params.num_headings as f64;
        // An arc leaves its cell and ends in the middle of a heading's bin.
        let turn = (cell_m * std::f64::consts::SQRT_2 / (params.turning_radius_m * heading)).ceil() * heading;
        let length = params.turning_radius_m * turn;
        let directions: &[f64] = if params.allow_reverse { &[1.0, -1.0] } else { &[1.0] };
        let arc =
            |direction: f64, side: f64| Arc { curvature: side / params.turning_radius_m, length: direction * length };
        let arcs = directions.iter().flat_map(|d| [0.0, 1.0, -1.0].map(|side| arc(*d, side))).collect();
        Self {
            cost: DrivingCost { costmap, params },
            fit,
            goal,
            over_cells: {
                let (width, height) = (costmap.width(), costmap.height());
                let grid = SearchGrid { blocked: closed, factors: costmap.factors(), width, height };
                // Outside, where no goal is, nothing leads to it.
                Flood::new(grid, costmap.cell(&goal.position).unwrap_or(Cell::new(-1, -1)))
            },
            arcs,
            cell_m,
            is_exact: level.is_exact,
            nodes: vec![],
            node_of: FxHashMap::default(),
            open: BinaryHeap::new(),
        }
    }

    /// From a pose where the robot fits to the goal, where it fits too.
    pub(crate) fn search(mut self, start: &Pose2, limits: &Limits<'_>) -> HybridPath {
        if !self.estimate_over_cells(start).is_finite() {
            return HybridPath::Apart;
        }
        let (mut expansions, mut since_curve) = (0, usize::MAX);
        let mut best: Option<Finish> = None;
        let (mut least, mut is_final) = (f64::INFINITY, true);
        self.reach(*start, 0.0, None);
        while let Some(Open { estimate, node }) = self.open.pop() {
            let at = self.nodes[node as usize];
            if at.is_closed || (!at.knows_heading && self.raise_estimate(node)) {
                continue;
            }
            least = least.min(at.cost + at.remaining);
            if best.as_ref().map_or(limits.cheaper_than, |best| best.cost) <= estimate {
                break;
            }
            let stopped = expansions % 64 == 63 && limits.stop.is_some_and(|stop| stop());
            if stopped || expansions >= limits.max_expansions {
                if best.is_some() {
                    is_final = false;
                    break;
                }
                return HybridPath::Stopped { by_caller: stopped };
            }
            self.nodes[node as usize].is_closed = true;
            expansions += 1;
            // The nearer, the more often.
            if since_curve as f64 >= at.remaining / self.cost.params.turning_radius_m {
                since_curve = 0;
                self.try_curves(node, limits.cheaper_than, &mut best);
            }
            since_curve = since_curve.saturating_add(1);
            for i in 0..self.arcs.len() {
                self.follow(node, self.arcs[i]);
            }
        }
        let Some(best) = best else { return HybridPath::Exhausted { expansions } };
        let bound = (best.cost / least).max(1.0);
        HybridPath::Found { arcs: self.trace(&best), bound, is_final, expansions }
    }

    fn follow(&mut self, from: u32, arc: Arc) {
        let Node { pose, cost, came, .. } = self.nodes[from as usize];
        let to = arc.after(&pose, arc.length);
        if let Some(known) = self.node_of.get(&self.key(&to)).map(|n| self.nodes[*n as usize])
            && (known.is_closed || known.cost <= cost + arc.length.abs())
        {
            return;
        }
        if !self.estimate_over_cells(&to).is_finite() || !self.fit.is_drivable(&pose, &Motion::Arc(arc)) {
            return;
        }
        let before = came.map(|(_, arc)| arc);
        let cost = cost + self.cost.of_arc(&pose, &arc) + self.cost.of_change(before, &arc);
        self.reach(to, cost, Some((from, arc)));
    }

    fn reach(&mut self, pose: Pose2, cost: f64, came: Option<(u32, Arc)>) {
        let new = self.nodes.len() as u32;
        let node = *self.node_of.entry(self.key(&pose)).or_insert(new);
        if node != new && self.nodes[node as usize].cost <= cost {
            return;
        }
        let remaining = self.estimate_over_cells(&pose);
        let reached = Node { pose, cost, remaining, knows_heading: false, came, is_closed: false };
        match self.nodes.get_mut(node as usize) {
            Some(known) => *known = reached,
            None => self.nodes.push(reached),
        }
        self.put(node);
    }

    fn put(&mut self, node: u32) {
        let Node { cost, remaining, .. } = self.nodes[node as usize];
        self.open.push(Open { estimate: cost + (1.0 + self.cost.params.tolerance) * remaining, node });
    }

    /// Lets the heading enter a node's estimate; if that raises it, the node is put back.
    fn raise_estimate(&mut self, node: u32) -> bool {
        let Node { pose, remaining, .. } = self.nodes[node as usize];
        let raised = self.unobstructed_to_goal(&pose, remaining);
        let at = &mut self.nodes[node as usize];
        at.knows_heading = true;
        at.remaining = raised.max(remaining);
        if raised > remaining {
            self.put(node);
        }
        raised > remaining
    }

    /// Tries curves from a node to the goal.
    fn try_curves(&self, node: u32, limit: f64, best: &mut Option<Finish>) {
        let at = &self.nodes[node as usize];
        let before = at.came.map(|(_, arc)| arc);
        let mut found = Vec::new();
        for yaw in self.goal_headings(&at.pose) {
            let goal = Pose2 { position: self.goal.position, yaw_rad: yaw };
            self.each_curve_to(&at.pose, &goal, |curve| found.push((self.unobstructed(&curve), curve)));
        }
        found.sort_by(|a, b| a.0.total_cmp(&b.0));
        for (least, curve) in found.into_iter().take(TRIED_CURVES) {
            let is_better = |cost: f64| at.cost + cost < best.as_ref().map_or(limit, |best| best.cost);
            if !is_better(least) {
                break;
            }
            let arcs: Arcs = curve.arcs(&at.pose).collect();
            let cost = self.cost.of_arcs(&arcs, before);
            if is_better(cost) && arcs.iter().all(|(from, arc)| self.fit.is_drivable(from, &Motion::Arc(*arc))) {
                *best = Some(Finish { cost: at.cost + cost, node, curve });
            }
        }
    }

    fn goal_headings(&self, from: &Pose2) -> Vec<f64> {
        let to_goal = self.goal.position - from.position;
        let bearing = to_goal.y.atan2(to_goal.x);
        match self.goal.yaw_rad {
            Some(yaw) => vec![yaw],
            None => (0..GOAL_HEADINGS).map(|i| wrap_angle(bearing + TAU * i as f64 / GOAL_HEADINGS as f64)).collect(),
        }
    }

    fn each_curve_to(&self, from: &Pose2, to: &Pose2, visit: impl FnMut(Curve)) {
        let HybridParams { turning_radius_m, allow_reverse, .. } = self.cost.params;
        each_curve(from, to, turning_radius_m, allow_reverse, visit);
    }

    /// Cost of a curve if no cell cost extra.
    fn unobstructed(&self, curve: &Curve) -> f64 {
        let radius = self.cost.params.turning_radius_m;
        let piece = |p: &crate::steering::Piece| {
            let arc = Arc { curvature: f64::from(p.turn) / radius, length: p.length * radius };
            self.cost.steering(&arc) * arc.length.abs()
        };
        let changes = curve.num_cusps() as f64 * self.cost.params.direction_change_cost_m;
        curve.pieces().iter().map(piece).sum::<f64>() + changes
    }

    /// Cost of the unobstructed curve, if the goal has a heading and is near over cells (or all is to be exact); else 0.
    fn unobstructed_to_goal(&self, pose: &Pose2, over_cells: f64) -> f64 {
        let near = if self.is_exact { f64::INFINITY } else { TURNS_NEAR * self.cost.params.turning_radius_m };
        let Some(yaw_rad) = self.goal.yaw_rad.filter(|_| over_cells < near) else { return 0.0 };
        let goal = Pose2 { position: self.goal.position, yaw_rad };
        let mut least = f64::INFINITY;
        self.each_curve_to(pose, &goal, |curve| least = least.min(self.unobstructed(&curve)));
        least
    }

    /// What any way to the goal's heading costs at least; 0 if it has none.
    pub(crate) fn unobstructed_at_least(&self, pose: &Pose2) -> f64 {
        self.unobstructed_to_goal(pose, 0.0)
    }

    /// Metres; infinite where there is no way.
    fn estimate_over_cells(&mut self, pose: &Pose2) -> f64 {
        let costmap = self.cost.costmap;
        let index = costmap.cell(&pose.position).map(|c| costmap.at(c));
        let cells = index.and_then(|i| self.over_cells.cost_from(i));
        let share = if self.is_exact { STRAIGHT } else { 1.0 };
        cells.map_or(f64::INFINITY, |c| c * costmap.geometry().resolution_m * share)
    }

    fn key(&self, pose: &Pose2) -> (u32, u32, u32) {
        let d = (pose.position - self.cost.costmap.geometry().origin) / self.cell_m;
        let heading = pose.yaw_rad / TAU * self.cost.params.num_headings as f64;
        let heading = heading.round().rem_euclid(self.cost.params.num_headings as f64);
        (d.x.max(0.0) as u32, d.y.max(0.0) as u32, heading as u32)
    }

    fn trace(&self, finish: &Finish) -> Arcs {
        let mut out: Arcs = finish.curve.arcs(&self.nodes[finish.node as usize].pose).collect();
        out.reverse();
        let mut at = finish.node;
        while let Some((before, arc)) = self.nodes[at as usize].came {
            out.push((self.nodes[before as usize].pose, arc));
            at = before;
        }
        out.reverse();
        out
    }
}

/// Cells in which the base cannot stand, row-major: not even the largest disc that the footprint holds would fit.
pub(crate) fn closed_cells(costmap: &Costmap, inscribed_radius_m: f64) -> Vec<bool> {
    // The base may stand anywhere in a cell, in a corner at the farthest from the centre.
    let needed = inscribed_radius_m - costmap.geometry().resolution_m * std::f64::consts::FRAC_1_SQRT_2;
    let cells = costmap.clearances().iter().enumerate();
    cells.map(|(i, c)| costmap.is_rim(i) || *c == 0.0 || f64::from(*c) < needed).collect()
}

/// An entry of the open list; the greatest, with the smallest estimate, is expanded first.
struct Open {
    estimate: f64,
    node: u32,
}

impl Ord for Open {
    fn cmp(&self, other: &Self) -> Ordering {
        other.estimate.total_cmp(&self.estimate).then(self.node.cmp(&other.node))
    }
}

impl PartialOrd for Open {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Open {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other).is_eq()
    }
}

impl Eq for Open {}
