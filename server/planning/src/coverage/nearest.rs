//! The cheapest way to the nearest of several places.

use crate::SearchGrid;
use crate::astar::neighbors_of;
use crate::bits::BitLines;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Searches outwards from one cell after the other; its memory is reused.
///
/// Source: Dijkstra, "A note on two problems in connexion with graphs", 1959; steps and costs as those of
/// [`astar::search`](crate::astar::search).
#[derive(Debug, Default)]
pub(super) struct Nearest {
    bits: BitLines,
    /// Cost so far and the cell before, as of a search.
    cells: Vec<(u32, u32, u64)>,
    search: u32,
    pub(super) expansions: usize,
}

impl Nearest {
    pub(super) fn new(grid: &SearchGrid<'_>) -> Self {
        let bits = BitLines::rows(grid.blocked, grid.width, grid.height);
        Self { bits, cells: vec![(0, 0, 0); grid.blocked.len()], search: 0, expansions: 0 }
    }

    /// Cells from `start` to the cheapest one that is wanted, both included; none if no such can be reached, or after `limit`
    /// expansions in all.
    pub(super) fn way(
        &mut self,
        grid: &SearchGrid<'_>,
        start: usize,
        limit: usize,
        wanted: impl Fn(usize) -> bool,
    ) -> Option<Vec<usize>> {
        self.search += 1;
        let mut open = BinaryHeap::from([Reverse((0u64, start as u32))]);
        self.cells[start] = (self.search, start as u32, 0);
        while let Some(Reverse((cost, index))) = open.pop() {
            let at = index as usize;
            if self.cells[at].2 != cost {
                continue;
            }
            if wanted(at) {
                return Some(self.trace(start, at));
            }
            if self.expansions >= limit {
                return None;
            }
            self.expansions += 1;
            for next in neighbors_of(grid, &self.bits, at) {
                let is_straight = next.abs_diff(at) == grid.width || next / grid.width == at / grid.width;
                let next_cost = cost.saturating_add(grid.step_cost(at, next, if is_straight { 0 } else { 4 }));
                if self.cells[next].0 != self.search || next_cost < self.cells[next].2 {
                    self.cells[next] = (self.search, index, next_cost);
                    open.push(Reverse((next_cost, next as u32)));
                }
            }
        }
        None
    }

    fn trace(&self, start: usize, mut at: usize) -> Vec<usize> {
        let mut out = vec![at];
        while at != start {
            at = self.cells[at].1 as usize;
            out.push(at);
        }
        out.reverse();
        out
    }
}
