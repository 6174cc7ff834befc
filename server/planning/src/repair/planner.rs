//! D* Lite on a grid of cells.

use super::queue::{Key, OpenList};
use crate::astar::neighbors_of;
use crate::bits::BitLines;
use crate::queue::octile;
use crate::{GridPath, PlanError, SearchGrid};
use percept_geometry::Cell;

/// Keeps a search from one goal backwards, and repairs it where cells have changed. Takes 21 bytes a cell, and 24 for each
/// entry of its open list.
///
/// Source: Koenig and Likhachev, "D* Lite", 2002, figure 4 (the second version, with its corrections of the keys for a robot
/// that moves). Where no corner is cut, a cell that changes changes steps between its neighbours as well: those eight and itself
/// are looked at anew. Steps and costs are those of [`astar::search`](crate::astar::search).
#[derive(Debug)]
pub struct RepairingPlanner {
    blocked: Vec<bool>,
    factors: Vec<f32>,
    width: usize,
    height: usize,
    bits: BitLines,
    goal: usize,
    /// Where the robot was when it was last asked.
    start: Option<usize>,
    /// What all keys of the open list are short of by the robot's moves: km of the paper.
    moved: u64,
    /// Cost to the goal as it was last expanded (g of the paper), and as its neighbours tell it (rhs); inverted, so that
    /// fresh zeros are infinite.
    expanded: Vec<u64>,
    told: Vec<u64>,
    open: OpenList,
}

impl RepairingPlanner {
    /// Over a copy of a grid; nothing is searched yet. The goal may be blocked, for now.
    ///
    /// # Errors
    /// `InvalidParam` for a grid whose arrays do not fit its size (`grid`), or a goal outside of it (`goal`).
    pub fn new(grid: &SearchGrid<'_>, goal: Cell) -> Result<Self, PlanError> {
        let num = grid.blocked.len();
        let is_sound = grid.width.checked_mul(grid.height) == Some(num)
            && (grid.factors.is_empty() || grid.factors.len() == num)
            && num <= u32::MAX as usize;
        if !is_sound {
            let remedy = "give height x width cells, as many factors or none, and at most 2^32 - 1 cells";
            return Err(PlanError::InvalidParam { field: "grid", value: num as f64, remedy });
        }
        let bits = BitLines::rows(grid.blocked, grid.width, grid.height);
        let (blocked, factors) = (grid.blocked.to_vec(), grid.factors.to_vec());
        let mut out = Self {
            blocked,
            factors,
            width: grid.width,
            height: grid.height,
            bits,
            goal: 0,
            start: None,
            moved: 0,
            expanded: vec![0; num],
            told: vec![0; num],
            open: OpenList::default(),
        };
        out.goal = out.index(goal).ok_or_else(|| out.outside("goal", goal))?;
        out.look_at(out.goal);
        Ok(out)
    }

    /// The grid as it is known by now.
    pub fn grid(&self) -> SearchGrid<'_> {
        SearchGrid { blocked: &self.blocked, factors: &self.factors, width: self.width, height: self.height }
    }

    /// Where its paths lead.
    pub fn goal(&self) -> Cell {
        self.grid().cell(self.goal)
    }

    /// Takes in cells that changed: whether each is blocked now. Their factors stay.
    ///
    /// # Errors
    /// `InvalidParam` for a cell outside of the grid (`changes`); none of the changes is made then.
    pub fn set_blocked(&mut self, changes: &[(Cell, bool)]) -> Result<(), PlanError> {
        let found: Option<Vec<usize>> = changes.iter().map(|(cell, _)| self.index(*cell)).collect();
        let Some(mut changed) = found else {
            let outside = changes.iter().find(|(cell, _)| self.index(*cell).is_none());
            return Err(self.outside("changes", outside.map_or(Cell::new(-1, -1), |(cell, _)| *cell)));
        };
        for (index, (_, is_blocked)) in changed.iter().zip(changes) {
            self.put(*index, *is_blocked);
        }
        changed.sort_unstable();
        self.repair_around(&changed);
        Ok(())
    }

    /// Takes in a whole grid, and finds what is different in it. Returns how many cells are.
    ///
    /// # Errors
    /// `InvalidParam` for a grid of another size, or one that has factors where this has none or the other way round (`grid`).
    pub fn update(&mut self, grid: &SearchGrid<'_>) -> Result<usize, PlanError> {
        let is_alike = (grid.width, grid.height) == (self.width, self.height)
            && grid.blocked.len() == self.blocked.len()
            && grid.factors.len() == self.factors.len();
        if !is_alike {
            let remedy = "give a grid of the same size, with factors if the first had some, or begin anew";
            return Err(PlanError::InvalidParam { field: "grid", value: grid.blocked.len() as f64, remedy });
        }
        let mut changed = vec![];
        for index in 0..grid.blocked.len() {
            let is_other = grid.factors.get(index).is_some_and(|f| f.to_bits() != self.factors[index].to_bits());
            if grid.blocked[index] == self.blocked[index] && !is_other {
                continue;
            }
            if is_other {
                self.factors[index] = grid.factors[index];
            }
            self.put(index, grid.blocked[index]);
            changed.push(index);
        }
        self.repair_around(&changed);
        Ok(changed.len())
    }

    /// The cheapest path from where the robot is now. `SearchLimit` after `max_expansions` more: asked again from the same
    /// place, the search goes on from there.
    ///
    /// `expansions` of what is given back are those of this call.
    pub fn path(&mut self, start: Cell, max_expansions: usize) -> GridPath {
        let Some(start) = self.index(start).filter(|i| !self.blocked[*i]) else {
            return GridPath::Unreachable { expansions: 0 };
        };
        if let Some(before) = self.start.filter(|before| *before != start) {
            self.moved = self.moved.saturating_add(self.apart(before, start));
        }
        self.start = Some(start);
        let Some(expansions) = self.search(start, max_expansions) else { return GridPath::SearchLimit };
        if self.told(start) == u64::MAX {
            return GridPath::Unreachable { expansions };
        }
        let cells = self.trace(start);
        GridPath::Found { cost: self.grid().cost_of(&cells), cells, expansions }
    }

    /// Figure 4, ComputeShortestPath. None: the limit was reached.
    fn search(&mut self, start: usize, max_expansions: usize) -> Option<usize> {
        let mut expansions = 0;
        while let Some((key, at)) = self.open.peek() {
            if self.expanded(at) == self.told(at) {
                self.open.pop();
                continue;
            }
            if key >= self.key(start, start) && self.told(start) <= self.expanded(start) {
                break;
            }
            let now = self.key(at, start);
            if key < now {
                // It was put there before the robot moved, or at a lower cost.
                self.open.pop();
                self.open.push(now, at);
                continue;
            }
            if expansions == max_expansions {
                return None;
            }
            expansions += 1;
            self.open.pop();
            if self.expanded(at) > self.told(at) {
                self.lower(at);
            } else {
                self.raise(at);
            }
        }
        Some(expansions)
    }

    /// What a cell was told is cheaper: its neighbours hear of it.
    fn lower(&mut self, at: usize) {
        let cost = self.told(at);
        self.expanded[at] = !cost;
        for next in self.neighbors(at) {
            let by_here = cost.saturating_add(self.step_cost(at, next));
            if next != self.goal && by_here < self.told(next) {
                self.told[next] = !by_here;
                self.put_open(next);
            }
        }
    }

    /// A cell's cost no longer holds: those that go by it look for another way.
    fn raise(&mut self, at: usize) {
        let before = self.expanded(at);
        self.expanded[at] = !u64::MAX;
        for next in self.neighbors(at) {
            if self.told(next) == before.saturating_add(self.step_cost(at, next)) {
                self.look_at(next);
            }
        }
        self.put_open(at);
    }

    /// What a cell's neighbours tell it now.
    fn look_at(&mut self, at: usize) {
        let told = if self.blocked[at] {
            u64::MAX
        } else if at == self.goal {
            0
        } else {
            let by = |next| self.expanded(next).saturating_add(self.step_cost(at, next));
            self.neighbors(at).map(by).min().unwrap_or(u64::MAX)
        };
        self.told[at] = !told;
        self.put_open(at);
    }

    /// Lets what is inconsistent be expanded.
    fn put_open(&mut self, at: usize) {
        if self.expanded(at) != self.told(at) {
            let key = self.key(at, self.start.unwrap_or(at));
            self.open.push(key, at);
        }
    }

    fn put(&mut self, index: usize, is_blocked: bool) {
        self.blocked[index] = is_blocked;
        self.bits.set(index / self.width, index % self.width, is_blocked);
    }

    fn repair_around(&mut self, changed: &[usize]) {
        let mut touched: Vec<usize> = changed.iter().flat_map(|index| self.square_around(*index)).collect();
        touched.sort_unstable();
        touched.dedup();
        touched.into_iter().for_each(|at| self.look_at(at));
        // Void entries are sorted out before they are more than there are cells.
        if self.open.len() > 2 * self.blocked.len() {
            self.open.take_cells().into_iter().for_each(|at| self.put_open(at));
        }
    }

    fn square_around(&self, index: usize) -> impl Iterator<Item = usize> + use<> {
        let (width, height) = (self.width, self.height);
        let (x, y) = (index % width, index / width);
        let rows = y.saturating_sub(1)..(y + 2).min(height);
        rows.flat_map(move |y| (x.saturating_sub(1)..(x + 2).min(width)).map(move |x| y * width + x))
    }

    fn neighbors(&self, at: usize) -> impl Iterator<Item = usize> + use<> {
        let none = if self.blocked[at] { 0 } else { 8 };
        neighbors_of(&self.grid(), &self.bits, at).take(none)
    }

    /// Figure 4, CalculateKey.
    fn key(&self, at: usize, start: usize) -> Key {
        let cost = self.expanded(at).min(self.told(at));
        (cost.saturating_add(self.apart(at, start)).saturating_add(self.moved), cost)
    }

    fn expanded(&self, at: usize) -> u64 {
        !self.expanded[at]
    }

    fn told(&self, at: usize) -> u64 {
        !self.told[at]
    }

    fn apart(&self, a: usize, b: usize) -> u64 {
        octile((a % self.width).abs_diff(b % self.width) as u32, (a / self.width).abs_diff(b / self.width) as u32)
    }

    fn step_cost(&self, a: usize, b: usize) -> u64 {
        let is_straight = b.abs_diff(a) == self.width || b / self.width == a / self.width;
        self.grid().step_cost(a, b, if is_straight { 0 } else { 4 })
    }

    /// Down the costs to the goal.
    fn trace(&self, start: usize) -> Vec<Cell> {
        let mut out = vec![self.grid().cell(start)];
        let mut at = start;
        while at != self.goal && out.len() <= self.blocked.len() {
            let by = |next: &usize| self.expanded(*next).saturating_add(self.step_cost(at, *next));
            let Some(next) = self.neighbors(at).min_by_key(by) else { break };
            out.push(self.grid().cell(next));
            at = next;
        }
        out
    }

    fn index(&self, cell: Cell) -> Option<usize> {
        let (x, y) = (usize::try_from(cell.x).ok()?, usize::try_from(cell.y).ok()?);
        (x < self.width && y < self.height).then(|| y * self.width + x)
    }

    fn outside(&self, field: &'static str, cell: Cell) -> PlanError {
        let x_is_out = usize::try_from(cell.x).map_or(true, |x| x >= self.width);
        let value = f64::from(if x_is_out { cell.x } else { cell.y });
        PlanError::InvalidParam { field, value, remedy: "give a cell inside of the grid" }
    }
}
