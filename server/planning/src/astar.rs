//! A* on a grid of cells with eight neighbours.

use crate::bits::BitLines;
use crate::queue::{BucketQueue, DIAGONAL, Entry, ONE, octile};
use percept_geometry::Cell;
use std::collections::{BTreeSet, VecDeque};

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

/// The cheapest path; a step costs its length times the mean factor of its two cells.
///
/// Source: Hart, Nilsson and Raphael, "A formal basis for the heuristic determination of minimum cost paths", 1968. The
/// octile distance never exceeds a step's cost (factors are at least 1). The open list is in order up to an eighth of a
/// cell, and a cell whose cost falls after it was expanded is expanded again; the search ends when nothing that is open can
/// lead to a cheaper way. The same input gives the same path. Costs are kept in 2^-30 cells, the one given back is summed
/// anew in f64. Infinite factors are as good as blocked.
pub fn search(grid: &SearchGrid<'_>, start: Cell, goal: Cell, max_expansions: usize) -> GridPath {
    let (Some(first), Some(last)) = (grid.free_index(start), grid.free_index(goal)) else {
        return GridPath::Unreachable { expansions: 0 };
    };
    let bits = BitLines::rows(grid.blocked, grid.width, grid.height);
    search_over(grid, &bits, (first, last), max_expansions)
}

/// As [`search`], between cells by index, with the grid's rows as bits.
pub(crate) fn search_over(
    grid: &SearchGrid<'_>,
    bits: &BitLines,
    (first, last): (usize, usize),
    max_expansions: usize,
) -> GridPath {
    let width = grid.width as u32;
    let (goal_x, goal_y) = (last as u32 % width, last as u32 / width);
    let estimate = |x: u32, y: u32| octile(x.abs_diff(goal_x), y.abs_diff(goal_y));
    // Cost so far plus one; 0 where none was found: fresh zeros cost nothing until they are touched.
    let mut costs = vec![0u64; grid.blocked.len()];
    let mut open = BucketQueue::new(estimate(first as u32 % width, first as u32 / width), grid.spread());
    costs[first] = 1;
    open.push(0, Entry { cost: 0, index: first as u32, step: NO_STEP });
    let mut expansions = 0;
    let mut best = u64::MAX;
    while let Some(Entry { cost, index: at, step }) = open.pop(best) {
        let (x, y, index) = (at % width, at / width, at as usize);
        // A cheaper way here was found after this entry was made, or a way to the goal that is as cheap as this may become.
        if cost + 1 != costs[index] || (best != u64::MAX && cost + estimate(x, y) >= best) {
            continue;
        }
        if index == last {
            best = cost;
            continue;
        }
        if expansions == max_expansions {
            return GridPath::SearchLimit;
        }
        expansions += 1;
        let came_by = if grid.factors.is_empty() { step } else { NO_STEP };
        let mut steps = worthwhile_steps(bits, x as usize, y as usize, came_by);
        while steps != 0 {
            let step = steps.trailing_zeros() as usize;
            steps &= steps - 1;
            let (x, y) = (x.wrapping_add_signed(STEPS[step].0), y.wrapping_add_signed(STEPS[step].1));
            let next = (y * width + x) as usize;
            let next_cost = cost.saturating_add(grid.step_cost(index, next, step));
            if next_cost < costs[next].wrapping_sub(1) {
                costs[next] = next_cost + 1;
                let entry = Entry { cost: next_cost, index: next as u32, step: step as u8 };
                open.push(next_cost.saturating_add(estimate(x, y)), entry);
            }
        }
    }
    if best == u64::MAX {
        return GridPath::Unreachable { expansions };
    }
    let cells = grid.trace(bits, &costs, last);
    GridPath::Found { cost: grid.cost_of(&cells), cells, expansions }
}

/// Whether a cell that `wanted` accepts can be reached from `start`: nearest first, stops at the first one.
pub(crate) fn reaches(grid: &SearchGrid<'_>, start: Cell, wanted: impl Fn(Cell) -> bool) -> bool {
    let Some(first) = grid.free_index(start) else { return false };
    let bits = BitLines::rows(grid.blocked, grid.width, grid.height);
    let mut queue = VecDeque::from([first]);
    let mut seen = BTreeSet::from([first]);
    while let Some(index) = queue.pop_front() {
        if wanted(grid.cell(index)) {
            return true;
        }
        queue.extend(neighbors_of(grid, &bits, index).filter(|next| seen.insert(*next)));
    }
    false
}

/// Cells that a step leads to from a free cell.
pub(crate) fn neighbors_of(
    grid: &SearchGrid<'_>,
    bits: &BitLines,
    index: usize,
) -> impl Iterator<Item = usize> + use<> {
    let (open, width) = (worthwhile_steps(bits, index % grid.width, index / grid.width, NO_STEP), grid.width as isize);
    let offset = move |(dx, dy): (i32, i32)| dy as isize * width + dx as isize;
    (0..8).filter(move |step| open >> step & 1 == 1).map(move |step| index.wrapping_add_signed(offset(STEPS[step])))
}

/// The eight steps: four along the axes, then the diagonals; diagonal `4 + i` lies between straight steps `i` and `i + 1`.
pub(crate) const STEPS: [(i32, i32); 8] = [(1, 0), (0, 1), (-1, 0), (0, -1), (1, 1), (-1, 1), (-1, -1), (1, -1)];

/// No step: where a search begins.
const NO_STEP: u8 = 8;

/// Steps that may be taken from a free cell that was reached by a step, as bits in the order of [`STEPS`]. Left out are
/// those that, where all cells cost the same, lead to cells that the one before reaches by a shorter way.
#[inline]
fn worthwhile_steps(bits: &BitLines, x: usize, y: usize, came_by: u8) -> u32 {
    let y = y as isize;
    let around = bits.three(y - 1, x) | bits.three(y, x) << 3 | bits.three(y + 1, x) << 6;
    u32::from(WORTHWHILE[usize::from(came_by)][around as usize])
}

/// The cell at this offset as a bit of the nine around.
const fn around_bit((dx, dy): (i32, i32)) -> usize {
    1 << (3 * (dy + 1) + dx + 1)
}

/// For each step by which a cell is reached and each pattern of blocked cells around it: the steps to take.
static WORTHWHILE: [[u8; 512]; 9] = {
    let mut out = [[0; 512]; 9];
    let mut came_by = 0;
    while came_by < 9 {
        let mut around = 0;
        while around < 512 {
            let mut step = 0;
            while step < 8 {
                if is_open(around, step) && !(came_by < 8 && is_detour(around, came_by, step)) {
                    out[came_by][around] |= 1 << step;
                }
                step += 1;
            }
            around += 1;
        }
        came_by += 1;
    }
    out
};

const fn is_open(around: usize, step: usize) -> bool {
    let (dx, dy) = STEPS[step];
    around & (around_bit((dx, dy)) | (around_bit((dx, 0)) | around_bit((0, dy))) & !around_bit((0, 0))) == 0
}

/// Whether the cell before, one step back, reaches the cell of the next step without the middle one and shorter.
const fn is_detour(around: usize, came_by: usize, step: usize) -> bool {
    let ((bx, by), (dx, dy)) = (STEPS[came_by], STEPS[step]);
    let forward = bx * dx + by * dy;
    if bx != 0 && by != 0 {
        // The cells beside a diagonal step are free: only on, or to a side of it, is a way through the middle as short.
        return forward < 0 || (dx != 0 && dy != 0 && forward == 0);
    }
    // After a straight step: back is never worthwhile, to the side only if the cell beside the one before is blocked.
    forward < 0 || (forward == 0 && around & around_bit((dx - bx, dy - by)) == 0)
}

impl SearchGrid<'_> {
    pub(crate) fn free_index(&self, cell: Cell) -> Option<usize> {
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

    pub(crate) fn cell(&self, index: usize) -> Cell {
        Cell::new((index % self.width) as i32, (index / self.width) as i32)
    }

    pub(crate) fn step_cost(&self, a: usize, b: usize, step: usize) -> u64 {
        let length = if step < 4 { ONE } else { DIAGONAL };
        if self.factors.is_empty() { length } else { (length as f64 * self.mean_factor(a, b)) as u64 }
    }

    fn mean_factor(&self, a: usize, b: usize) -> f64 {
        if self.factors.is_empty() { 1.0 } else { 0.5 * (f64::from(self.factors[a]) + f64::from(self.factors[b])) }
    }

    /// How much a step may raise the estimate.
    pub(crate) fn spread(&self) -> u64 {
        let most = self.factors.iter().filter(|f| f.is_finite()).fold(1.0f32, |most, f| most.max(*f));
        // A step away from the goal costs its length twice.
        (DIAGONAL as f64 * (f64::from(most) + 1.0)) as u64 + 1
    }

    /// Back from the goal along cells whose cost and step give exactly the next one's cost.
    fn trace(&self, bits: &BitLines, costs: &[u64], goal: usize) -> Vec<Cell> {
        let mut out = vec![self.cell(goal)];
        let mut at = goal;
        while costs[at] != 1 {
            let leads_here = |from: &usize| {
                let is_straight = from % self.width == at % self.width || from / self.width == at / self.width;
                let cost = self.step_cost(*from, at, if is_straight { 0 } else { 4 });
                costs[*from] != 0 && costs[*from].saturating_add(cost) == costs[at]
            };
            let Some(from) = neighbors_of(self, bits, at).find(leads_here) else { break };
            out.push(self.cell(from));
            at = from;
        }
        out.reverse();
        out
    }

    pub(crate) fn cost_of(&self, cells: &[Cell]) -> f64 {
        let index = |c: Cell| c.y as usize * self.width + c.x as usize;
        let (mut weighted, mut straight, mut diagonal) = (0.0, 0u32, 0u32);
        for pair in cells.windows(2) {
            let is_diagonal = pair[0].x != pair[1].x && pair[0].y != pair[1].y;
            if self.factors.is_empty() {
                diagonal += u32::from(is_diagonal);
                straight += u32::from(!is_diagonal);
            } else {
                let length = if is_diagonal { std::f64::consts::SQRT_2 } else { 1.0 };
                weighted += length * self.mean_factor(index(pair[0]), index(pair[1]));
            }
        }
        weighted + f64::from(straight) + std::f64::consts::SQRT_2 * f64::from(diagonal)
    }
}
