//! A way from voxel to voxel that is found soon, for who may not have the time for the shortest.

use super::field::Field;
use super::lattice::{Found, Limits};
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// A way that is found soon is at most so many times as long as the shortest over voxels: what paths over cells begin with when there is a
/// deadline.
pub(super) const SOON_BOUND: u64 = 2;

impl Field<'_> {
    /// A way over 26 neighbours between two open voxels, at most [`SOON_BOUND`] times as long as the shortest.
    ///
    /// Source: Pohl, "Heuristic search viewed as path finding in a graph", 1970: A* with an estimate made larger. Each voxel is expanded
    /// once; that the bound holds all the same: Likhachev, Gordon and Thrun, "ARA*", 2003.
    pub(super) fn soon_over_voxels(&self, start: usize, goal: usize, limits: &Limits<'_>) -> Found {
        let num: usize = self.size().iter().product();
        let to_goal = self.coordinates(goal);
        let estimate = |index: usize| self.unobstructed(self.coordinates(index), to_goal);
        let entry = |index: usize, length: u64| {
            let estimate = estimate(index);
            Reverse((length + SOON_BOUND * estimate, estimate, index as u32))
        };
        // Length so far plus one; 0 where none was found: fresh zeros cost nothing until they are touched.
        let mut lengths = vec![0u64; num];
        let mut closed = vec![0u64; num.div_ceil(64)];
        let mut open = BinaryHeap::from([entry(start, 0)]);
        lengths[start] = 1;
        let (mut expansions, mut got_free) = (0, false);
        while let Some(Reverse((_, _, index))) = open.pop() {
            let at = index as usize;
            if closed[at / 64] >> (at % 64) & 1 == 1 {
                continue;
            }
            if at == goal {
                return Found::Way { voxels: self.trace(&lengths, goal), expansions };
            }
            if let Some(ended) = limits.reached(expansions) {
                return ended;
            }
            closed[at / 64] |= 1 << (at % 64);
            expansions += 1;
            got_free |= self.fits(at);
            for (next, length) in self.neighbors(at) {
                let next_length = lengths[at] + length;
                let is_closed = closed[next / 64] >> (next % 64) & 1 == 1;
                if !is_closed && (lengths[next] == 0 || next_length < lengths[next]) {
                    lengths[next] = next_length;
                    open.push(entry(next, next_length - 1));
                }
            }
        }
        Found::Nothing { got_free }
    }

    /// How many times as long as the shortest way over voxels one of so many voxels' length is at most.
    pub(super) fn soon_bound(&self, (start, goal): (usize, usize), length: f64) -> f64 {
        let least = self.unobstructed(self.coordinates(start), self.coordinates(goal));
        let least = least as f64 / crate::queue::ONE as f64;
        if least > 0.0 { (length / least).clamp(1.0, SOON_BOUND as f64) } else { 1.0 }
    }
}
