//! Costs of the ways from all cells to one, found as they are asked for.

use crate::astar::{SearchGrid, neighbors_of};
use crate::bits::BitLines;
use crate::queue::{BucketQueue, Entry, ONE};
use percept_geometry::Cell;

/// A search from the goal outwards, as far as was needed so far.
///
/// Source: Dijkstra, "A note on two problems in connexion with graphs", 1959; steps and costs as those of
/// [`search`](crate::astar::search).
pub(crate) struct Flood<'a> {
    grid: SearchGrid<'a>,
    bits: BitLines,
    /// Cost so far plus one; 0 where none was found.
    costs: Vec<u64>,
    open: BucketQueue,
}

impl<'a> Flood<'a> {
    /// Around a goal; where that is blocked, nothing is reached.
    pub(crate) fn new(grid: SearchGrid<'a>, goal: Cell) -> Self {
        let bits = BitLines::rows(grid.blocked, grid.width, grid.height);
        let mut costs = vec![0; grid.blocked.len()];
        let mut open = BucketQueue::new(0, grid.spread());
        if let Some(first) = grid.free_index(goal) {
            costs[first] = 1;
            open.push(0, Entry { cost: 0, index: first as u32, step: 0 });
        }
        Self { grid, bits, costs, open }
    }

    /// Cost of the cheapest way from a cell to the goal, in cells; none if there is no way.
    pub(crate) fn cost_from(&mut self, index: usize) -> Option<f64> {
        // Final once all that is cheaper was expanded.
        while self.costs[index] == 0 || self.costs[index] > self.open.emptied_below() {
            let Some(Entry { cost, index: at, .. }) = self.open.pop(u64::MAX) else { break };
            self.expand(at as usize, cost);
        }
        let cost = self.costs[index];
        (cost != 0).then(|| (cost - 1) as f64 / ONE as f64)
    }

    fn expand(&mut self, index: usize, cost: u64) {
        if cost + 1 != self.costs[index] {
            return;
        }
        for next in neighbors_of(&self.grid, &self.bits, index) {
            let is_straight =
                next.abs_diff(index) == self.grid.width || next / self.grid.width == index / self.grid.width;
            let next_cost = cost.saturating_add(self.grid.step_cost(index, next, if is_straight { 0 } else { 4 }));
            if next_cost < self.costs[next].wrapping_sub(1) {
                self.costs[next] = next_cost + 1;
                self.open.push(next_cost, Entry { cost: next_cost, index: next as u32, step: 0 });
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::GridPath;
    use crate::astar::search;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn costs_are_those_of_searches_in_whatever_order_they_are_asked_for(
            width in 1..30usize, height in 1..30usize, seed in prop::collection::vec(0..100u32, 900),
            goal in 0..900usize, asked in prop::collection::vec(0..900usize, 20),
        ) {
            let blocked: Vec<bool> = (0..width * height).map(|i| seed[i] < 30).collect();
            let factors: Vec<f32> = (0..blocked.len()).map(|i| 1.0 + (seed[i] % 5) as f32).collect();
            let grid = SearchGrid { blocked: &blocked, factors: &factors, width, height };
            let goal = grid.cell(goal % blocked.len());
            let mut flood = Flood::new(grid, goal);
            for index in asked.into_iter().map(|i| i % blocked.len()) {
                let found = flood.cost_from(index);
                match search(&grid, grid.cell(index), goal, usize::MAX) {
                    GridPath::Found { cost, .. } => {
                        prop_assert!(found.is_some_and(|f| (f - cost).abs() < 1e-5 * cost + 1e-9), "{found:?} {cost}");
                    }
                    _ => prop_assert_eq!(found, None),
                }
            }
        }
    }
}
