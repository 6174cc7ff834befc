//! A* from voxel to voxel.

use super::field::Field;
use crate::queue::{BucketQueue, DIAGONAL, Entry, ONE};

/// What a search came to; voxels by index.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Found {
    /// From start to goal: each voxel of the way, or its corners alone.
    Way { voxels: Vec<usize>, expansions: usize },
    /// There is none. `got_free`: a voxel was reached on which the ball fits.
    Nothing { got_free: bool },
    /// The limit of expansions was reached.
    Limit,
    /// The caller ended it.
    Stopped,
}

/// Limits of a search.
#[derive(Clone, Copy)]
pub(super) struct Limits<'a> {
    pub(super) max_expansions: usize,
    pub(super) stop: Option<&'a (dyn Fn() -> bool + Sync)>,
}

impl Limits<'_> {
    /// Whether the search has to end before this expansion, and with what.
    pub(super) fn reached(&self, expansions: usize) -> Option<Found> {
        if expansions.is_multiple_of(256) && self.stop.is_some_and(|stop| stop()) {
            return Some(Found::Stopped);
        }
        (expansions >= self.max_expansions).then_some(Found::Limit)
    }
}

/// sqrt 3 in [`ONE`]s, rounded.
const SPACE_DIAGONAL: u64 = 1_859_775_393;

/// Lengths of steps that change one, two and three coordinates.
const LENGTHS: [u64; 4] = [0, ONE, DIAGONAL, SPACE_DIAGONAL];

/// A step to a neighbour: along each axis, the voxels that have to be open as bits of the 27 around, and its length.
#[derive(Clone, Copy)]
pub(super) struct Step {
    pub(super) by: [i64; 3],
    needs: u32,
    pub(super) length: u64,
}

/// The 26 steps.
pub(super) static STEPS: [Step; 26] = steps();

const fn steps() -> [Step; 26] {
    let mut out = [Step { by: [0; 3], needs: 0, length: 0 }; 26];
    let (mut i, mut step) = (0, 0);
    while i < 27 {
        let by = [i % 3 - 1, i / 3 % 3 - 1, i / 9 - 1];
        if i != 13 {
            // All of the box that the step spans.
            let mut needs = 0;
            let mut k = 0;
            while k < 8 {
                let near = [by[0] * (k & 1), by[1] * (k >> 1 & 1), by[2] * (k >> 2)];
                needs |= 1u32 << (9 * (near[2] + 1) + 3 * (near[1] + 1) + near[0] + 1);
                k += 1;
            }
            let changed = by[0] * by[0] + by[1] * by[1] + by[2] * by[2];
            out[step] = Step { by, needs, length: LENGTHS[changed as usize] };
            step += 1;
        }
        i += 1;
    }
    out
}

impl Field<'_> {
    /// The 27 voxels around one as bits, x fastest, 1 where open.
    fn around(&self, index: usize) -> u32 {
        let [width, height, depth] = self.size();
        let [x, y, z] = self.coordinates(index);
        let mut out = 0;
        for (k, z) in (0..3).map(|k| (k, (z + k).wrapping_sub(1))) {
            for (j, y) in (0..3).map(|j| (j, (y + j).wrapping_sub(1))) {
                if z >= depth || y >= height {
                    continue;
                }
                let row = (z * height + y) * width;
                for (i, x) in (0..3).map(|i| (i, (x + i).wrapping_sub(1))) {
                    if x < width && self.is_open(row + x) {
                        out |= 1 << (9 * k + 3 * j + i);
                    }
                }
            }
        }
        out
    }

    /// Neighbours that a step leads to from an open voxel, and the steps' lengths: all of the box that the step spans is open,
    /// so that the ball fits along it (see [`Field::sees`]).
    pub(super) fn neighbors(&self, index: usize) -> impl Iterator<Item = (usize, u64)> + use<> {
        let around = self.around(index);
        let [width, height, _] = self.size();
        let strides = [1, width as i64, (width * height) as i64];
        let open = STEPS.iter().filter(move |step| step.needs & !around == 0);
        open.map(move |step| {
            let off: i64 = (0..3).map(|i| step.by[i] * strides[i]).sum();
            ((index as i64 + off) as usize, step.length)
        })
    }

    /// The shortest way from voxel to voxel where there is no obstacle.
    pub(super) fn unobstructed(&self, a: [usize; 3], b: [usize; 3]) -> u64 {
        let mut d: [u64; 3] = std::array::from_fn(|i| a[i].abs_diff(b[i]) as u64);
        d.sort_unstable();
        d[0] * SPACE_DIAGONAL + (d[1] - d[0]) * DIAGONAL + (d[2] - d[1]) * ONE
    }

    /// The shortest way over 26 neighbours between two open voxels.
    ///
    /// Source: Hart, Nilsson and Raphael, "A formal basis for the heuristic determination of minimum cost paths", 1968. Lengths
    /// are whole numbers of 2^-30 voxels; the open list is in order up to an eighth of a voxel, and what is reached by a
    /// shorter way after it was expanded is expanded again.
    pub(super) fn shortest_over_voxels(&self, start: usize, goal: usize, limits: &Limits<'_>) -> Found {
        let [x, y, z] = self.size();
        let to_goal = self.coordinates(goal);
        let estimate = |index: usize| self.unobstructed(self.coordinates(index), to_goal);
        // Length so far plus one; 0 where none was found: fresh zeros cost nothing until they are touched.
        let mut lengths = vec![0u64; x * y * z];
        let mut open = BucketQueue::new(estimate(start), 2 * SPACE_DIAGONAL + 1);
        lengths[start] = 1;
        open.push(0, Entry { cost: 0, index: start as u32, step: 0 });
        let (mut expansions, mut best, mut got_free) = (0, u64::MAX, false);
        while let Some(Entry { cost, index, .. }) = open.pop(best) {
            let at = index as usize;
            if cost + 1 != lengths[at] || (best != u64::MAX && cost + estimate(at) >= best) {
                continue;
            }
            if at == goal {
                best = cost;
                continue;
            }
            if let Some(ended) = limits.reached(expansions) {
                return ended;
            }
            expansions += 1;
            got_free |= self.fits(at);
            for (next, length) in self.neighbors(at) {
                let next_cost = cost + length;
                if next_cost < lengths[next].wrapping_sub(1) {
                    lengths[next] = next_cost + 1;
                    let entry = Entry { cost: next_cost, index: next as u32, step: 0 };
                    open.push(next_cost + estimate(next), entry);
                }
            }
        }
        if best == u64::MAX {
            return Found::Nothing { got_free };
        }
        Found::Way { voxels: self.trace(&lengths, goal), expansions }
    }

    /// Back from the goal along steps whose lengths add up.
    pub(super) fn trace(&self, lengths: &[u64], goal: usize) -> Vec<usize> {
        let mut out = vec![goal];
        let mut at = goal;
        while lengths[at] != 1 {
            let leads_here =
                |(from, length): &(usize, u64)| lengths[*from] != 0 && lengths[*from] + length == lengths[at];
            let Some((from, _)) = self.neighbors(at).find(leads_here) else { break };
            out.push(from);
            at = from;
        }
        out.reverse();
        out
    }
}
