//! Lazy Theta*: paths whose legs go at any angle.

use crate::Costmap;
use crate::astar::{GridPath, SearchGrid, neighbors_of};
use crate::bits::BitLines;
use nalgebra::Point2;
use percept_geometry::Cell;
use std::cmp::Ordering;
use std::collections::BinaryHeap;

/// What a search at any angle keeps to.
pub struct AnyAngleLimits<'a> {
    /// From obstacles, metres.
    pub clearance_m: f64,
    /// Cells.
    pub max_expansions: usize,
    /// Asked every so many cells; once it is true, the search ends as if it was at its limit.
    pub stop: Option<&'a (dyn Fn() -> bool + Sync)>,
}

/// Cells between two questions whether to stop: 0.1 ms.
const ASK_EVERY: usize = 64;

/// The way over a costmap whose legs join cells' centres at any angle; what it gives back are the corners, and the cost in
/// metres.
///
/// A leg over several cells keeps the clearance from obstacles, exactly; a leg to a neighbouring cell is what A* steps.
///
/// Source: Nash, Koenig and Tovey, "Lazy Theta*: any-angle path planning and path length analysis in 3D", 2010, algorithm 2.
/// We depart from it where cells differ in cost: straight on from the parent is then not always the cheaper way, so that each
/// cell takes the cheaper of the leg from its neighbour's parent and the step from its neighbour. The way is not always the
/// shortest.
pub fn any_angle(costmap: &Costmap, blocked: &[bool], ends: (Cell, Cell), limits: &AnyAngleLimits<'_>) -> GridPath {
    let (width, height) = (costmap.width(), costmap.height());
    let grid = SearchGrid { blocked, factors: costmap.factors(), width, height };
    let (Some(start), Some(goal)) = (grid.free_index(ends.0), grid.free_index(ends.1)) else {
        return GridPath::Unreachable { expansions: 0 };
    };
    let bits = BitLines::rows(blocked, width, height);
    let cells = vec![Vertex { cost: f64::INFINITY, parent: u32::MAX, is_closed: false }; blocked.len()];
    let mut search = Theta { costmap, grid, bits, clearance: limits.clearance_m, cells };
    search.run(start, goal, limits)
}

#[derive(Clone, Copy)]
struct Vertex {
    /// Metres from the start, weighted.
    cost: f64,
    parent: u32,
    is_closed: bool,
}

struct Theta<'a> {
    costmap: &'a Costmap,
    grid: SearchGrid<'a>,
    bits: BitLines,
    clearance: f64,
    cells: Vec<Vertex>,
}

impl Theta<'_> {
    fn run(&mut self, start: usize, goal: usize, limits: &AnyAngleLimits<'_>) -> GridPath {
        let goal_center = self.center(goal);
        let mut open = BinaryHeap::new();
        let mut expansions = 0;
        (self.cells[start].cost, self.cells[start].parent) = (0.0, start as u32);
        open.push(Open { estimate: 0.0, index: start as u32 });
        while let Some(Open { index, .. }) = open.pop() {
            let at = index as usize;
            if std::mem::replace(&mut self.cells[at].is_closed, true) {
                continue;
            }
            self.see_parent(at);
            if at == goal {
                return GridPath::Found { cells: self.corners(goal), cost: self.cells[goal].cost, expansions };
            }
            let is_stopped = expansions.is_multiple_of(ASK_EVERY) && limits.stop.is_some_and(|stop| stop());
            if expansions == limits.max_expansions || is_stopped {
                return GridPath::SearchLimit;
            }
            expansions += 1;
            for next in neighbors_of(&self.grid, &self.bits, at) {
                let (cost, parent) = self.cheapest_to(at, next);
                let known = &mut self.cells[next];
                if !known.is_closed && cost < known.cost {
                    (known.cost, known.parent) = (cost, parent);
                    let estimate = cost + (self.center(next) - goal_center).norm();
                    open.push(Open { estimate, index: next as u32 });
                }
            }
        }
        GridPath::Unreachable { expansions }
    }

    /// The cheaper of the leg from `at`'s parent, not yet looked along, and the step from `at`.
    fn cheapest_to(&self, at: usize, next: usize) -> (f64, u32) {
        let Vertex { cost, parent, .. } = self.cells[at];
        let by_step = (cost + self.leg(at, next), at as u32);
        let before = self.cells[parent as usize].cost;
        let length = (self.center(parent as usize) - self.center(next)).norm();
        // A metre costs 1 at least: most legs need not be summed.
        if self.cells[next].is_closed || before + length >= by_step.0.min(self.cells[next].cost) {
            return by_step;
        }
        let by_leg = (before + self.leg(parent as usize, next), parent);
        if by_leg.0 < by_step.0 { by_leg } else { by_step }
    }

    /// Where the parent turns out not to be in sight, the cheapest step from a cell that was expanded replaces it.
    fn see_parent(&mut self, at: usize) {
        let parent = self.cells[at].parent as usize;
        if self.are_neighbors(parent, at) {
            return;
        }
        let (a, b) = (self.center(parent), self.center(at));
        // f32 storage of clearances may be off by a part in 1e7.
        let needed = self.clearance * (1.0 - 1e-6);
        if self.costmap.segment_clearance(&a, &b, self.clearance.max(1e-9)) >= needed.max(1e-10) {
            return;
        }
        let expanded = neighbors_of(&self.grid, &self.bits, at).filter(|n| self.cells[*n].is_closed);
        let steps = expanded.map(|n| (self.cells[n].cost + self.leg(n, at), n as u32));
        if let Some((cost, parent)) = steps.min_by(|a, b| a.0.total_cmp(&b.0)) {
            (self.cells[at].cost, self.cells[at].parent) = (cost, parent);
        }
    }

    fn leg(&self, a: usize, b: usize) -> f64 {
        self.costmap.segment_cost(&self.center(a), &self.center(b))
    }

    fn are_neighbors(&self, a: usize, b: usize) -> bool {
        let (a, b) = (self.grid.cell(a), self.grid.cell(b));
        a.x.abs_diff(b.x) <= 1 && a.y.abs_diff(b.y) <= 1
    }

    fn center(&self, index: usize) -> Point2<f64> {
        self.costmap.geometry().center(self.grid.cell(index))
    }

    fn corners(&self, goal: usize) -> Vec<Cell> {
        let mut at = goal;
        let mut out = vec![self.grid.cell(at)];
        while self.cells[at].parent as usize != at {
            at = self.cells[at].parent as usize;
            out.push(self.grid.cell(at));
        }
        out.reverse();
        out
    }
}

/// An entry of the open list; the greatest, with the smallest estimate, is expanded first.
struct Open {
    estimate: f64,
    index: u32,
}

impl Ord for Open {
    fn cmp(&self, other: &Self) -> Ordering {
        other.estimate.total_cmp(&self.estimate).then(other.index.cmp(&self.index))
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
