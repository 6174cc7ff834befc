//! ARA* on a grid of cells.

use super::AnytimeParams;
use crate::SearchGrid;
use crate::astar::neighbors_of;
use crate::bits::BitLines;
use crate::queue::octile;
use percept_geometry::Cell;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// What is searched, and for how long.
#[derive(Clone, Copy)]
pub struct AnytimeRequest<'a> {
    /// From where.
    pub start: Cell,
    /// Where to.
    pub goal: Cell,
    /// How the bound comes down.
    pub params: AnytimeParams,
    /// Cells that all searches together may expand: the same number gives the same paths, however fast the machine is.
    pub max_expansions: usize,
    /// Asked before the first expansion and from time to time, say for a deadline: once it is true, the search ends.
    pub stop: Option<&'a (dyn Fn() -> bool + Sync)>,
}

/// The best path so far.
#[derive(Debug, Clone, PartialEq)]
pub struct AnytimePath {
    /// Cells from start to goal, both included, neighbours sharing an edge or a corner.
    pub cells: Vec<Cell>,
    /// Its cost: length in cells (a diagonal counts sqrt 2) times the cells' factors.
    pub cost: f64,
    /// Its cost is at most so many times the least; 1: it is the cheapest.
    pub bound: f64,
    /// Cells expanded until it was known.
    pub expansions: usize,
}

/// How a search ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AnytimeEnd {
    /// The last path is the cheapest.
    Optimal,
    /// No path exists.
    Unreachable,
    /// At `max_expansions`, with the last path as the best so far, if any was found.
    Limit,
    /// By the caller, likewise.
    Stopped,
}

/// Hands over ever better paths, or the same path with a lower bound, and says how it ended. Steps and costs are those of
/// [`astar::search`](crate::astar::search).
///
/// Source: Likhachev, Gordon and Thrun, "ARA*: Anytime A* with provable bounds on sub-optimality", 2003: A* with an estimate
/// made larger, a cell at most once in each search, and what has changed since carried over to the next. A path's bound is
/// the smaller of that factor and its cost over the least unweighted estimate of what is open or inconsistent (section 3.2).
/// That estimate is a lower limit of the least cost at any moment, so that a path of a search that was cut off has a bound,
/// too.
pub fn search(
    grid: &SearchGrid<'_>,
    request: &AnytimeRequest<'_>,
    on_better: &mut dyn FnMut(&AnytimePath),
) -> AnytimeEnd {
    let (Some(start), Some(goal)) = (grid.free_index(request.start), grid.free_index(request.goal)) else {
        return AnytimeEnd::Unreachable;
    };
    let bits = BitLines::rows(grid.blocked, grid.width, grid.height);
    let num = grid.blocked.len();
    let mut ara = Ara {
        grid: *grid,
        bits,
        goal,
        weight: request.params.first_bound,
        costs: vec![0; num],
        parents: vec![0; num],
        closed: vec![0; num],
        round: 1,
        open: BinaryHeap::new(),
        inconsistent: vec![],
        expansions: 0,
    };
    (ara.costs[start], ara.parents[start]) = (1, start as u32);
    ara.put(start, 0);
    let mut told: Option<(u64, f64)> = None;
    let mut best: Option<(u64, Vec<Cell>)> = None;
    loop {
        let ended = ara.improve(request);
        if ara.costs[goal] == 0 {
            return ended.unwrap_or(AnytimeEnd::Unreachable);
        }
        ara.gather();
        // Parents that were improved since may lead along a way that costs more than what was told of: then that stays.
        let traced = ara.trace();
        let cost = ara.sum(&traced);
        let (cost, cells) = match best.take().filter(|(known, _)| *known <= cost) {
            Some(known) => known,
            None => (cost, traced),
        };
        let by_estimate = cost as f64 / ara.least_estimate().min(cost).max(1) as f64;
        // A search that was cut off proves nothing by its factor; a path's bound never rises.
        let by_weight = if ended.is_none() { ara.weight } else { f64::INFINITY };
        let before = told.map_or(f64::INFINITY, |(_, bound)| bound);
        let bound = by_estimate.min(by_weight).min(before).max(1.0);
        if told.is_none_or(|(known, before)| cost < known || bound < before) {
            told = Some((cost, bound));
            let (cost, cells) = (grid.cost_of(&cells), cells.clone());
            on_better(&AnytimePath { cost, cells, bound, expansions: ara.expansions });
        }
        best = Some((cost, cells));
        if bound == 1.0 {
            return AnytimeEnd::Optimal;
        }
        if let Some(ended) = ended {
            return ended;
        }
        ara.weight = (ara.weight - request.params.bound_step).min(bound).max(1.0);
        ara.begin_round();
    }
}

struct Ara<'a> {
    grid: SearchGrid<'a>,
    bits: BitLines,
    goal: usize,
    /// What estimates are multiplied by.
    weight: f64,
    /// Cost so far plus one; 0 where none was found.
    costs: Vec<u64>,
    parents: Vec<u32>,
    /// The round in which a cell was last expanded.
    closed: Vec<u32>,
    round: u32,
    /// Cost plus weighted estimate, estimate, cell; the smallest first: of equals the one nearest to the goal. Void if the
    /// cell was expanded in this round, by an entry of a lower cost.
    open: BinaryHeap<Reverse<(u64, u64, u32)>>,
    /// Cells that were reached by a cheaper way after they were expanded in this round.
    inconsistent: Vec<u32>,
    expansions: usize,
}

impl Ara<'_> {
    /// Until the goal's cost is at most the weight times the least.
    fn improve(&mut self, request: &AnytimeRequest<'_>) -> Option<AnytimeEnd> {
        while let Some(&Reverse((key, _, index))) = self.open.peek() {
            let at = index as usize;
            if self.closed[at] == self.round {
                self.open.pop();
                continue;
            }
            if self.costs[self.goal] != 0 && self.costs[self.goal] - 1 <= key {
                return None;
            }
            if self.expansions.is_multiple_of(64) && request.stop.is_some_and(|stop| stop()) {
                return Some(AnytimeEnd::Stopped);
            }
            if self.expansions >= request.max_expansions {
                return Some(AnytimeEnd::Limit);
            }
            self.open.pop();
            self.closed[at] = self.round;
            self.expansions += 1;
            self.expand(at, self.costs[at] - 1);
        }
        None
    }

    fn expand(&mut self, at: usize, cost: u64) {
        for next in neighbors_of(&self.grid, &self.bits, at) {
            let next_cost = cost.saturating_add(self.step_cost(at, next));
            if next_cost >= self.costs[next].wrapping_sub(1) {
                continue;
            }
            (self.costs[next], self.parents[next]) = (next_cost + 1, at as u32);
            if self.closed[next] == self.round {
                self.inconsistent.push(next as u32);
            } else {
                self.put(next, next_cost);
            }
        }
    }

    fn put(&mut self, index: usize, cost: u64) {
        let estimate = self.estimate(index);
        // At a weight of 1 in whole numbers: as A* does.
        let weighted = if self.weight == 1.0 { estimate } else { (estimate as f64 * self.weight) as u64 };
        self.open.push(Reverse((cost.saturating_add(weighted), estimate, index as u32)));
    }

    /// Lets `inconsistent` hold each cell once that is open or inconsistent.
    fn gather(&mut self) {
        let mut all = std::mem::take(&mut self.inconsistent);
        let live = self.open.drain().map(|Reverse((_, _, index))| index);
        all.extend(live.filter(|index| self.closed[*index as usize] != self.round));
        all.sort_unstable();
        all.dedup();
        self.inconsistent = all;
    }

    /// After [`Ara::gather`]: a lower limit of the least cost, unless it is that of the path that is known.
    fn least_estimate(&self) -> u64 {
        let estimate = |i: &u32| (self.costs[*i as usize] - 1).saturating_add(self.estimate(*i as usize));
        self.inconsistent.iter().map(estimate).min().unwrap_or(u64::MAX)
    }

    /// After [`Ara::gather`]: all of it is open, by the new weight.
    fn begin_round(&mut self) {
        self.round += 1;
        for index in std::mem::take(&mut self.inconsistent) {
            self.put(index as usize, self.costs[index as usize] - 1);
        }
    }

    fn estimate(&self, index: usize) -> u64 {
        let apart = |a: usize, b: usize| a.abs_diff(b) as u32;
        let width = self.grid.width;
        octile(apart(index % width, self.goal % width), apart(index / width, self.goal / width))
    }

    fn step_cost(&self, a: usize, b: usize) -> u64 {
        let is_straight = b.abs_diff(a) == self.grid.width || b / self.grid.width == a / self.grid.width;
        self.grid.step_cost(a, b, if is_straight { 0 } else { 4 })
    }

    /// Back from the goal; what was reached by a cheaper way since makes the way cheaper than the goal's cost says.
    fn trace(&self) -> Vec<Cell> {
        let mut at = self.goal;
        let mut out = vec![self.grid.cell(at)];
        while self.parents[at] as usize != at {
            at = self.parents[at] as usize;
            out.push(self.grid.cell(at));
        }
        out.reverse();
        out
    }

    fn sum(&self, cells: &[Cell]) -> u64 {
        let index = |c: Cell| c.y as usize * self.grid.width + c.x as usize;
        let steps = cells.windows(2).map(|pair| self.step_cost(index(pair[0]), index(pair[1])));
        steps.fold(0, u64::saturating_add)
    }
}
