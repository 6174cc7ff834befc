//! Jump point search: shortest paths on grids of equal cost, without visiting the cells in between.

use crate::astar::{GridPath, STEPS, SearchGrid, search_over};
use crate::bits::{BitLines, Stop};
use crate::queue::{DIAGONAL, ONE, octile};
use percept_geometry::Cell;
use rustc_hash::FxHashMap;
use std::cmp::Ordering;
use std::collections::BinaryHeap;

/// The shortest path over free cells: eight neighbours, a diagonal step costs sqrt 2 and needs both cells beside it free.
///
/// `blocked` is row-major `height x width`; outside is blocked, and so is all of it if its length does not fit. By jump points, or
/// by [`search`](crate::astar::search) where obstacles are so scattered that jumps are short. Expansions are counted in jump
/// points, of which there are far fewer than cells, or in cells then. As short as what `search` finds, though not always the
/// same cells.
pub fn shortest_path(
    blocked: &[bool],
    width: usize,
    height: usize,
    start: Cell,
    goal: Cell,
    max_expansions: usize,
) -> GridPath {
    let grid = SearchGrid { blocked, factors: &[], width, height };
    let (Some(first), Some(last)) = (grid.free_index(start), grid.free_index(goal)) else {
        return GridPath::Unreachable { expansions: 0 };
    };
    let rows = BitLines::rows(blocked, width, height);
    if rows.jump_density(width, height) > SCATTERED {
        return search_over(&grid, &rows, (first, last), max_expansions);
    }
    jump(&grid, rows, (first, last), max_expansions)
}

/// The same by jump points, whatever the map.
///
/// Source: Harabor and Grastien, "Online graph pruning for pathfinding on grid maps", 2011, and "Improving jump point
/// search", 2014: scans of 64 cells at once (section 3) and no nodes at the turns from diagonal to straight (section 4).
/// Where corners are not cut, a straight way has to stop one cell after an obstacle beside it, and a diagonal one nowhere.
pub fn jump_point_search(grid: &SearchGrid<'_>, start: Cell, goal: Cell, max_expansions: usize) -> GridPath {
    let grid = SearchGrid { factors: &[], ..*grid };
    let (Some(first), Some(last)) = (grid.free_index(start), grid.free_index(goal)) else {
        return GridPath::Unreachable { expansions: 0 };
    };
    jump(&grid, BitLines::rows(grid.blocked, grid.width, grid.height), (first, last), max_expansions)
}

/// More places to stop than this for each cell: jumps cost more than the cells that they leave out. Of the maps of
/// `examples/grid_search.rs`, random512-10-0 has 0.29, where A* takes 0.4 of the time; the others have 0.003 to 0.025, and there
/// it takes 5 to 50 times as long.
const SCATTERED: f64 = 0.1;

fn jump(grid: &SearchGrid<'_>, rows: BitLines, (first, last): (usize, usize), max_expansions: usize) -> GridPath {
    let SearchGrid { width, height, .. } = *grid;
    let columns = rows.transposed(width, height);
    let goal = (last % width, last / width);
    let mut search = JumpSearch {
        rows,
        columns,
        width,
        goal,
        nodes: vec![],
        node_of: FxHashMap::default(),
        open: BinaryHeap::new(),
    };
    match search.run((first % width, first / width), max_expansions) {
        Ended::Found { node, expansions } => {
            let cells = search.trace(node);
            GridPath::Found { cost: grid.cost_of(&cells), cells, expansions }
        }
        Ended::Exhausted { expansions } => GridPath::Unreachable { expansions },
        Ended::Limit => GridPath::SearchLimit,
    }
}

/// Cells of a diagonal that are followed at once, whatever their estimates: an entry of the open list costs as much as the
/// scans from a few cells. Of 0 to 32, the least time over the maps of `examples/grid_search.rs`.
const FEWEST_CELLS: u32 = 8;

enum Ended {
    Found { node: u32, expansions: usize },
    Exhausted { expansions: usize },
    Limit,
}

/// A cell where a way may turn.
#[derive(Clone, Copy)]
struct Node {
    cost: u64,
    x: u32,
    y: u32,
    /// The node before on the cheapest way; itself at the start.
    parent: u32,
    /// Steps to be followed from here, and those that were, at this cost: bits in the order of `STEPS`.
    pending: u8,
    done: u8,
}

struct JumpSearch {
    rows: BitLines,
    columns: BitLines,
    width: usize,
    goal: (usize, usize),
    nodes: Vec<Node>,
    node_of: FxHashMap<u32, u32>,
    open: BinaryHeap<Open>,
}

impl JumpSearch {
    fn run(&mut self, start: (usize, usize), max_expansions: usize) -> Ended {
        self.reach(start, 0, 0, u8::MAX);
        let mut expansions = 0;
        while let Some(Open { estimate, cost, node, rest }) = self.open.pop() {
            let at = &mut self.nodes[node as usize];
            if let Some(Rest { diagonal, cells }) = rest {
                // Void if a shorter way to its node was found since.
                if at.cost + u64::from(cells) * DIAGONAL == cost {
                    self.follow_diagonal(node, usize::from(diagonal), cells, estimate);
                }
                continue;
            }
            let steps = std::mem::take(&mut at.pending);
            at.done |= steps;
            let (x, y, cost) = (at.x as usize, at.y as usize, at.cost);
            if (x, y) == self.goal {
                return Ended::Found { node, expansions };
            }
            if steps == 0 {
                continue; // An entry of an earlier, higher cost; all was followed since.
            }
            if expansions == max_expansions {
                return Ended::Limit;
            }
            expansions += 1;
            for straight in (0..4).filter(|s| steps >> s & 1 == 1) {
                self.scan(node, (x, y), cost, straight);
            }
            for diagonal in (0..4).filter(|d| steps >> (d + 4) & 1 == 1) {
                self.follow_diagonal(node, diagonal, 0, estimate);
            }
        }
        Ended::Exhausted { expansions }
    }

    /// Goes straight from `at`, reached from `parent` at this cost. Returns whether the first cell is free.
    fn scan(&mut self, parent: u32, (x, y): (usize, usize), cost: u64, straight: usize) -> bool {
        let stop = match straight {
            0 => self.rows.scan_up(y, x),
            1 => self.columns.scan_up(x, y),
            2 => self.rows.scan_down(y, x),
            _ => self.columns.scan_down(x, y),
        };
        let along = if straight.is_multiple_of(2) { x } else { y };
        let length = match stop {
            Stop::Jump { at } => at.abs_diff(along),
            Stop::Blocked { at } => at.abs_diff(along as isize) - 1,
        };
        let (dx, dy) = STEPS[straight];
        let shifted = |n: usize| {
            (x.wrapping_add_signed(dx as isize * n as isize), y.wrapping_add_signed(dy as isize * n as isize))
        };
        // The goal on the way is a place to stop.
        let to_goal = self.goal.0.abs_diff(x) + self.goal.1.abs_diff(y);
        if to_goal <= length && shifted(to_goal) == self.goal {
            self.reach(self.goal, cost + to_goal as u64 * ONE, parent, 0);
        } else if let Stop::Jump { .. } = stop {
            let at = shifted(length);
            self.reach(at, cost + length as u64 * ONE, parent, self.turns(at, straight));
        }
        length > 0
    }

    /// Goes diagonally from a node, where the first `done` cells were followed before, until that is blocked, with both
    /// straight scans from each cell. At a cell whose estimate is above `bound`, the rest is put off.
    fn follow_diagonal(&mut self, parent: u32, diagonal: usize, mut done: u32, bound: u64) {
        let (dx, dy) = STEPS[diagonal + 4];
        let next_x = |x: usize| x.wrapping_add_signed(dx as isize);
        let next_y = |y: usize| y.wrapping_add_signed(dy as isize);
        let from = self.nodes[parent as usize];
        let mut cost = from.cost + u64::from(done) * DIAGONAL;
        let mut x = (from.x as usize).wrapping_add_signed((dx * done as i32) as isize);
        let mut y = (from.y as usize).wrapping_add_signed((dy * done as i32) as isize);
        let (first, second) = (diagonal, (diagonal + 1) % 4);
        let (horizontal, vertical) = if diagonal.is_multiple_of(2) { (first, second) } else { (second, first) };
        // The first cells beside the way have to be looked at; further on the scans tell.
        let mut is_open = self.is_free(next_x(x), y) && self.is_free(x, next_y(y));
        let at_once = done + FEWEST_CELLS;
        while is_open && self.is_free(next_x(x), next_y(y)) {
            let estimate = cost + self.to_goal(x, y);
            if done >= at_once && estimate > bound {
                let rest = Some(Rest { diagonal: diagonal as u8, cells: done });
                self.open.push(Open { estimate, cost, node: parent, rest });
                return;
            }
            done += 1;
            (x, y, cost) = (next_x(x), next_y(y), cost + DIAGONAL);
            if (x, y) == self.goal {
                self.reach(self.goal, cost, parent, 0);
                return;
            }
            is_open = self.scan(parent, (x, y), cost, horizontal);
            is_open &= self.scan(parent, (x, y), cost, vertical);
        }
    }

    fn to_goal(&self, x: usize, y: usize) -> u64 {
        octile(x.abs_diff(self.goal.0) as u32, y.abs_diff(self.goal.1) as u32)
    }

    fn is_free(&self, x: usize, y: usize) -> bool {
        // One before 0 has wrapped around, and does so back.
        !self.rows.is_blocked(y as isize, x as isize)
    }

    /// Where a way that came straight to a jump point may go on: straight, and to the sides that were blocked a cell before.
    fn turns(&self, (x, y): (usize, usize), straight: usize) -> u8 {
        let (dx, dy) = STEPS[straight];
        let (back_x, back_y) = (x.wrapping_add_signed(-dx as isize), y.wrapping_add_signed(-dy as isize));
        let mut out = 1 << straight;
        for (side, diagonal) in [((straight + 1) % 4, straight), ((straight + 3) % 4, (straight + 3) % 4)] {
            let (sx, sy) = STEPS[side];
            let beside = |x: usize, y: usize| (x.wrapping_add_signed(sx as isize), y.wrapping_add_signed(sy as isize));
            let (now, before) = (beside(x, y), beside(back_x, back_y));
            if self.is_free(now.0, now.1) && !self.is_free(before.0, before.1) {
                out |= 1 << side | 1 << (diagonal + 4);
            }
        }
        out
    }

    /// Notes a way to a node. Ways of the same cost are both followed where they lead on differently.
    fn reach(&mut self, at: (usize, usize), cost: u64, parent: u32, steps: u8) {
        let (x, y) = (at.0 as u32, at.1 as u32);
        let new = self.nodes.len() as u32;
        let node = *self.node_of.entry((at.1 * self.width + at.0) as u32).or_insert(new);
        if node == new {
            self.nodes.push(Node { cost, x, y, parent, pending: steps, done: 0 });
        } else {
            let known = &mut self.nodes[node as usize];
            match cost.cmp(&known.cost) {
                Ordering::Greater => return,
                Ordering::Equal if steps & !(known.pending | known.done) == 0 => return,
                Ordering::Equal => known.pending |= steps & !known.done,
                Ordering::Less => (known.cost, known.parent, known.pending, known.done) = (cost, parent, steps, 0),
            }
        }
        self.open.push(Open { estimate: cost + self.to_goal(at.0, at.1), cost, node, rest: None });
    }

    /// Between two nodes a way goes diagonally first, then straight.
    fn trace(&self, mut node: u32) -> Vec<Cell> {
        let cell = |n: &Node| Cell::new(n.x as i32, n.y as i32);
        let mut at = self.nodes[node as usize];
        let mut out = vec![cell(&at)];
        while at.parent != node {
            node = at.parent;
            let before = self.nodes[node as usize];
            let (from, to) = (cell(&before), cell(&at));
            let (dx, dy) = (to.x - from.x, to.y - from.y);
            let diagonals = dx.abs().min(dy.abs());
            let steps = dx.abs().max(dy.abs());
            for i in (0..steps).rev() {
                let share = |d: i32| if d.abs() == steps { i * d.signum() } else { i.min(diagonals) * d.signum() };
                out.push(Cell::new(from.x + share(dx), from.y + share(dy)));
            }
            at = before;
        }
        out.reverse();
        out
    }
}

/// An entry of the open list; the greatest is expanded first: the smallest estimate, then the farthest from the start.
#[derive(PartialEq, Eq)]
struct Open {
    estimate: u64,
    cost: u64,
    node: u32,
    /// For the rest of a diagonal from this node; then cost and estimate are those of the cell where it was left.
    rest: Option<Rest>,
}

#[derive(PartialEq, Eq, PartialOrd, Ord)]
struct Rest {
    /// Which of the four.
    diagonal: u8,
    /// Cells of it that were followed.
    cells: u32,
}

impl Ord for Open {
    fn cmp(&self, other: &Self) -> Ordering {
        let by_estimate = other.estimate.cmp(&self.estimate);
        by_estimate.then(self.cost.cmp(&other.cost)).then(other.node.cmp(&self.node)).then(other.rest.cmp(&self.rest))
    }
}

impl PartialOrd for Open {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}
