//! A* on a grid of cells with eight neighbours.

use percept_geometry::Cell;
use std::cmp::Ordering;
use std::collections::{BTreeSet, BinaryHeap, VecDeque};

/// Outcome of a search on a grid.
#[derive(Debug, Clone, PartialEq)]
pub enum GridPath {
    /// The cheapest path.
    Found {
        /// Cells from start to goal, both included, neighbours sharing an edge or a corner.
        cells: Vec<Cell>,
        /// Its cost: length in cells (a diagonal counts sqrt 2) times the cells' factors.
        cost: f64,
        /// Cells expanded.
        expansions: usize,
    },
    /// No path exists.
    Unreachable {
        /// Cells expanded.
        expansions: usize,
    },
    /// The limit of expansions was reached before a path was found.
    SearchLimit,
}

/// A grid to search, row-major `height x width`.
#[derive(Debug, Clone, Copy)]
pub struct SearchGrid<'a> {
    /// Cells that may not be entered.
    pub blocked: &'a [bool],
    /// Cost of a cell's length in each cell, at least 1; empty if it is 1 everywhere.
    pub factors: &'a [f32],
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

/// The shortest path over free cells: eight neighbours, a diagonal step costs sqrt 2 and needs both cells beside it free.
///
/// `blocked` is row-major `height x width`; outside is blocked, and so is all of it if its length does not fit.
pub fn shortest_path(
    blocked: &[bool],
    width: usize,
    height: usize,
    start: Cell,
    goal: Cell,
    max_expansions: usize,
) -> GridPath {
    search(&SearchGrid { blocked, factors: &[], width, height }, start, goal, max_expansions)
}

/// The cheapest path; a step costs its length times the mean factor of its two cells.
///
/// Source: Hart, Nilsson and Raphael, "A formal basis for the heuristic determination of minimum cost paths", 1968. The
/// octile distance never exceeds a step's cost (factors are at least 1), so the first time a cell is expanded its cost is
/// final. Ties go to the cell farther from the start, then to the smaller index: the same input gives the same path.
pub fn search(grid: &SearchGrid<'_>, start: Cell, goal: Cell, max_expansions: usize) -> GridPath {
    let (Some(start), Some(goal)) = (grid.free_index(start), grid.free_index(goal)) else {
        return GridPath::Unreachable { expansions: 0 };
    };
    let mut costs = vec![f64::INFINITY; grid.blocked.len()];
    let mut steps = vec![NO_STEP; grid.blocked.len()];
    let mut open = BinaryHeap::new();
    let mut expansions = 0;
    costs[start] = 0.0;
    open.push(Open { estimate: grid.octile(start, goal), cost: 0.0, index: start as u32 });
    while let Some(Open { cost, index, .. }) = open.pop() {
        let index = index as usize;
        if cost > costs[index] {
            continue; // A cheaper way here was found after this entry was made.
        }
        if index == goal {
            return GridPath::Found { cells: grid.trace(&steps, goal), cost, expansions };
        }
        if expansions == max_expansions {
            return GridPath::SearchLimit;
        }
        expansions += 1;
        for (step, next, length) in grid.neighbors(index) {
            let next_cost = cost + length * grid.mean_factor(index, next);
            if next_cost < costs[next] {
                costs[next] = next_cost;
                steps[next] = step;
                let estimate = next_cost + grid.octile(next, goal);
                open.push(Open { estimate, cost: next_cost, index: next as u32 });
            }
        }
    }
    GridPath::Unreachable { expansions }
}

/// Whether a cell that `wanted` accepts can be reached from `start`: nearest first, stops at the first one.
pub(crate) fn reaches(grid: &SearchGrid<'_>, start: Cell, wanted: impl Fn(Cell) -> bool) -> bool {
    let mut queue: VecDeque<usize> = grid.free_index(start).into_iter().collect();
    let mut seen: BTreeSet<usize> = queue.iter().copied().collect();
    while let Some(index) = queue.pop_front() {
        if wanted(grid.cell(index)) {
            return true;
        }
        queue.extend(grid.neighbors(index).map(|(_, next, _)| next).filter(|next| seen.insert(*next)));
    }
    false
}

/// The eight steps: four along the axes, then the diagonals.
const STEPS: [(i32, i32); 8] = [(1, 0), (0, 1), (-1, 0), (0, -1), (1, 1), (-1, 1), (-1, -1), (1, -1)];

const NO_STEP: u8 = u8::MAX;

impl SearchGrid<'_> {
    fn free_index(&self, cell: Cell) -> Option<usize> {
        let (x, y) = (usize::try_from(cell.x).ok()?, usize::try_from(cell.y).ok()?);
        let sound = self.width.checked_mul(self.height) == Some(self.blocked.len())
            && (self.factors.is_empty() || self.factors.len() == self.blocked.len())
            && self.blocked.len() <= u32::MAX as usize;
        if !sound || x >= self.width || y >= self.height {
            return None;
        }
        let index = y * self.width + x;
        (!self.blocked[index]).then_some(index)
    }

    fn cell(&self, index: usize) -> Cell {
        Cell::new((index % self.width) as i32, (index / self.width) as i32)
    }

    fn neighbors(&self, index: usize) -> impl Iterator<Item = (u8, usize, f64)> {
        let (x, y) = (index % self.width, index / self.width);
        let mut straight = [None; 4];
        for (slot, (dx, dy)) in straight.iter_mut().zip(STEPS) {
            *slot = self.free_offset(x, y, dx, dy);
        }
        (0..8u8).filter_map(move |step| {
            let i = usize::from(step);
            if i < 4 {
                return straight[i].map(|next| (step, next, 1.0));
            }
            // Diagonal i lies between straight steps i - 4 and i - 3.
            straight[i - 4].and(straight[(i - 3) % 4])?;
            let (dx, dy) = STEPS[i];
            self.free_offset(x, y, dx, dy).map(|next| (step, next, std::f64::consts::SQRT_2))
        })
    }

    fn free_offset(&self, x: usize, y: usize, dx: i32, dy: i32) -> Option<usize> {
        let (x, y) = (x.checked_add_signed(dx as isize)?, y.checked_add_signed(dy as isize)?);
        let index = (x < self.width && y < self.height).then(|| y * self.width + x)?;
        (!self.blocked[index]).then_some(index)
    }

    fn mean_factor(&self, a: usize, b: usize) -> f64 {
        if self.factors.is_empty() { 1.0 } else { 0.5 * (f64::from(self.factors[a]) + f64::from(self.factors[b])) }
    }

    fn octile(&self, a: usize, b: usize) -> f64 {
        let dx = (a % self.width).abs_diff(b % self.width);
        let dy = (a / self.width).abs_diff(b / self.width);
        // Less a rounding of sums, so that the estimate stays below the cost.
        (dx.max(dy) as f64 + (std::f64::consts::SQRT_2 - 1.0) * dx.min(dy) as f64) * (1.0 - 1e-12)
    }

    fn trace(&self, steps: &[u8], goal: usize) -> Vec<Cell> {
        let mut cell = self.cell(goal);
        let mut out = vec![cell];
        let step_into = |cell: Cell| usize::from(steps[cell.y as usize * self.width + cell.x as usize]);
        while let Some((dx, dy)) = STEPS.get(step_into(cell)) {
            cell = Cell::new(cell.x - dx, cell.y - dy);
            out.push(cell);
        }
        out.reverse();
        out
    }
}

/// An entry of the open list; the greatest is expanded first.
struct Open {
    estimate: f64,
    cost: f64,
    index: u32,
}

impl Ord for Open {
    fn cmp(&self, other: &Self) -> Ordering {
        let by_estimate = other.estimate.total_cmp(&self.estimate);
        by_estimate.then(self.cost.total_cmp(&other.cost)).then(other.index.cmp(&self.index))
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
