//! Which voxels the beams of one sensor pass.

use super::block::{Bits, VOXELS};
use crate::blocks::{BLOCK, BlockKey};
use nalgebra::Point3;

/// Blocks along the longest edge of what one scan may reach: twice the largest range, and a rim.
const MAX_BLOCKS: usize = 164;
/// Whoever stands farther out, in voxels, has no numbers left for its voxels.
const FARTHEST: f64 = 1e9;
/// Parts of a voxel that are told apart.
const FIXED: f64 = (1u64 << 32) as f64;
/// Blocks that are kept side by side, whether a beam passes them or not: 16 MB. Of more, those that any passes are looked up.
const MAX_DENSE: usize = 1 << 15;
const NONE: u32 = u32::MAX;

/// Voxels that were passed, a byte each while they are gathered: a byte is written, where a bit would have to be read before.
pub(super) struct Rays {
    /// Voxels from `low`, a block's corner; the sensor and all ends lie within.
    sensor: Point3<f64>,
    low: [i32; 3],
    size: [usize; 3],
    /// What each number of a voxel along each axis adds to its place: blocks row by row, then voxels of a block.
    offsets: [Vec<usize>; 3],
    /// Which of `passed` is each block's; empty if all are there.
    blocks: Vec<u32>,
    passed: Vec<u8>,
}

impl Rays {
    /// From where the beams start and where they will end, in voxels. None if there is no beam, if numbers are too large, or ends
    /// lie too far apart.
    pub(super) fn new(sensor: Point3<f64>, ends: impl Iterator<Item = Point3<f64>>) -> Option<Self> {
        let (mut min, mut max, mut any) = (sensor, sensor, false);
        for end in ends {
            (min, max, any) = (min.inf(&end), max.sup(&end), true);
        }
        let is_sound = any && min.iter().chain(max.iter()).all(|v| v.abs() < FARTHEST);
        if !is_sound {
            return None;
        }
        // A rim of a voxel, for what rounding does at a border.
        let block = |v: f64| (v.floor() as i32).div_euclid(BLOCK);
        let (low, high) = (min.map(|v| block(v - 1.0)), max.map(|v| block(v + 1.0)));
        let size: [usize; 3] = std::array::from_fn(|i| (high[i] - low[i] + 1) as usize);
        if size.iter().any(|n| *n > MAX_BLOCKS) {
            return None;
        }
        let low = [low.x * BLOCK, low.y * BLOCK, low.z * BLOCK];
        let sensor = sensor - nalgebra::Vector3::from(low.map(f64::from));
        let edge = BLOCK as usize;
        let (mut blocks_apart, mut apart) = (VOXELS, 1);
        let offsets = std::array::from_fn(|axis| {
            let offsets = (0..size[axis] * edge).map(|i| i / edge * blocks_apart + i % edge * apart).collect();
            (blocks_apart, apart) = (blocks_apart * size[axis], apart * edge);
            offsets
        });
        let num: usize = size.iter().product();
        let (blocks, passed) =
            if num <= MAX_DENSE { (vec![], vec![0; num * VOXELS]) } else { (vec![NONE; num], vec![]) };
        Some(Self { sensor, low, size, offsets, blocks, passed })
    }

    /// Passes all voxels from the sensor to an end (in voxels), that of the end included.
    ///
    /// Goes from one layer of voxels to the next along the axis that the beam follows most: in between it crosses at most one
    /// border along each of the others, and where those are is added up, not compared.
    pub(super) fn pass(&mut self, end: &Point3<f64>) {
        let end = end - nalgebra::Vector3::from(self.low.map(f64::from));
        // Which axis that is has to be known beforehand, for places to be kept in registers.
        match ((end - self.sensor).iamax(), self.blocks.is_empty()) {
            (0, true) => self.pass_along::<0, true>(&end),
            (1, true) => self.pass_along::<1, true>(&end),
            (_, true) => self.pass_along::<2, true>(&end),
            (0, false) => self.pass_along::<0, false>(&end),
            (1, false) => self.pass_along::<1, false>(&end),
            (_, false) => self.pass_along::<2, false>(&end),
        }
    }

    fn pass_along<const MAIN: usize, const DENSE: bool>(&mut self, end: &Point3<f64>) {
        let along = end - self.sensor;
        let [main, u, v] = [MAIN, (MAIN + 1) % 3, (MAIN + 2) % 3];
        let (from, to) = (self.sensor[main].floor() as i64, end[main].floor() as i64);
        let step: i64 = if along[main] < 0.0 { -1 } else { 1 };
        let fixed = |x: f64| (x * FIXED) as i64;
        // Where the beam crosses the first border, and how far aside it goes from each border to the next.
        let first_border = if step > 0 { from as f64 + 1.0 } else { from as f64 };
        let slope = |axis: usize| if along[main] == 0.0 { 0.0 } else { along[axis] / along[main].abs() };
        let until = (first_border - self.sensor[main]).abs();
        let (du, dv) = (fixed(slope(u)), fixed(slope(v)));
        let at = |axis: usize| fixed(self.sensor[axis] + slope(axis) * until);
        let (mut next_u, mut next_v) = (at(u), at(v));
        let (mut now_u, mut now_v) = (fixed(self.sensor[u]), fixed(self.sensor[v]));
        let (end_u, end_v) = (fixed(end[u]), fixed(end[v]));
        let Self { offsets, blocks, passed, .. } = self;
        let (in_main, in_u, in_v) = (&offsets[main], &offsets[u], &offsets[v]);
        // Rounding may only err by a voxel, for which there is a rim.
        let place = |offsets: &[usize], at: i64| offsets.get((at >> 32) as usize).copied().unwrap_or_default();
        let mut mark = |at: usize| {
            if DENSE {
                if let Some(voxel) = passed.get_mut(at) {
                    *voxel = 1;
                }
                return;
            }
            let Some(block) = blocks.get_mut(at / VOXELS) else { return };
            if *block == NONE {
                *block = (passed.len() / VOXELS) as u32;
                passed.resize(passed.len() + VOXELS, 0);
            }
            passed[*block as usize * VOXELS + at % VOXELS] = 1;
        };
        let (mut from_u, mut from_v) = (place(in_u, now_u), place(in_v, now_v));
        let layers = (to - from).abs();
        for layer in 0..=layers {
            if layer == layers {
                (next_u, next_v) = (end_u, end_v);
            }
            let here = in_main.get((from + step * layer) as usize).copied().unwrap_or_default();
            let (to_u, to_v) = (place(in_u, next_u), place(in_v, next_v));
            mark(here + from_u + from_v);
            if (from_u, from_v) != (to_u, to_v) {
                if from_u != to_u && from_v != to_v {
                    let first = crosses_first((now_u, next_u), (now_v, next_v));
                    mark(here + if first { to_u + from_v } else { from_u + to_v });
                }
                mark(here + to_u + to_v);
            }
            (now_u, now_v, from_u, from_v) = (next_u, next_v, to_u, to_v);
            (next_u, next_v) = (next_u + du, next_v + dv);
        }
    }

    /// All that were passed, by block, in no order.
    pub(super) fn passed(&self) -> Vec<(BlockKey, Bits)> {
        let low = self.low.map(|v| v / BLOCK);
        let [width, height, _] = self.size;
        let key = |i: usize| {
            (low[0] + (i % width) as i32, low[1] + (i / width % height) as i32, low[2] + (i / width / height) as i32)
        };
        let of = |i: usize, voxels: &[u8]| {
            let mut bits = Bits::default();
            for (word, voxels) in bits.iter_mut().zip(voxels.chunks_exact(64)) {
                *word = voxels.iter().enumerate().fold(0, |w, (i, b)| w | u64::from(*b) << i);
            }
            (key(i), bits)
        };
        if self.blocks.is_empty() {
            let any = |voxels: &[u8]| voxels.iter().fold(0, |any, v| any | v) != 0;
            let all = self.passed.chunks_exact(VOXELS).enumerate();
            return all.filter(|(_, voxels)| any(voxels)).map(|(i, voxels)| of(i, voxels)).collect();
        }
        let there = self.blocks.iter().enumerate().filter(|(_, block)| **block != NONE);
        there.map(|(i, block)| of(i, &self.passed[*block as usize * VOXELS..][..VOXELS])).collect()
    }
}

/// Whether a beam crosses its border along the first axis before that along the second, on its way from now to next.
fn crosses_first(a: (i64, i64), b: (i64, i64)) -> bool {
    let share = |(now, next): (i64, i64)| {
        let border = if next > now { (next >> 32) << 32 } else { (now >> 32) << 32 };
        (border - now) as f64 / (next - now) as f64
    };
    share(a) < share(b)
}

#[cfg(test)]
mod tests {
    use super::*;
    use percept_geometry::Voxel;
    use std::collections::BTreeSet;

    /// Step by step to whatever border is next: Amanatides and Woo.
    fn plainly(from: Point3<f64>, to: Point3<f64>) -> BTreeSet<Voxel> {
        let along = to - from;
        let mut cell: [i64; 3] = std::array::from_fn(|i| from[i].floor() as i64);
        let end: [i64; 3] = std::array::from_fn(|i| to[i].floor() as i64);
        let step: [i64; 3] = std::array::from_fn(|i| if along[i] < 0.0 { -1 } else { 1 });
        let mut next: [f64; 3] = std::array::from_fn(|i| {
            let border = cell[i] as f64 + if step[i] > 0 { 1.0 } else { 0.0 };
            if along[i] == 0.0 { f64::INFINITY } else { (border - from[i]) / along[i] }
        });
        let mut out = BTreeSet::new();
        loop {
            out.insert(Voxel::new(cell[0] as i32, cell[1] as i32, cell[2] as i32));
            let axis = (0..3).min_by(|a, b| next[*a].total_cmp(&next[*b])).unwrap_or(0);
            if cell == end || next[axis] > 1.0 {
                return out;
            }
            cell[axis] += step[axis];
            next[axis] += 1.0 / along[axis].abs();
        }
    }

    #[test]
    fn the_voxels_of_a_beam_are_those_that_it_passes_step_by_step() {
        let spread = |i: u32, m: u32| f64::from(i.wrapping_mul(m) >> 8) / f64::from(1u32 << 24) - 0.5;
        let mut differing = 0;
        for i in 1..3_000u32 {
            let shift = Point3::new(1e3, -2e4, 7.0) * f64::from(i % 3);
            let from =
                shift + nalgebra::Vector3::new(spread(i, 2_654_435_761), spread(i, 40_503), spread(i, 97_531)) * 9.0;
            let mut along =
                nalgebra::Vector3::new(spread(i, 2_246_822_519), spread(i, 3_266_489_917), spread(i, 668_265_263));
            along *= 200.0 * spread(i, 374_761_393).abs();
            // Some go so far that blocks are looked up.
            along *= if i % 5 == 0 { 4.0 } else { 1.0 };
            // Some go along an axis, or nowhere.
            (0..3).filter(|a| i % 16 == *a as u32 || i % 17 == *a as u32 || i % 64 == 0).for_each(|a| along[a] = 0.0);
            let to = from + along;
            let Some(mut rays) = Rays::new(from, [to].into_iter()) else { panic!("beam {i}") };
            rays.pass(&to);
            let mut ours = BTreeSet::new();
            for ((x, y, z), bits) in rays.passed() {
                let set = (0..VOXELS).filter(|s| bits[s / 64] >> (s % 64) & 1 == 1).map(|s| s as i32);
                ours.extend(set.map(|s| Voxel::new(8 * x + s % 8, 8 * y + s / 8 % 8, 8 * z + s / 64)));
            }
            differing += usize::from(ours != plainly(from, to));
        }
        // Beams through an edge, to within rounding.
        assert!(differing <= 3, "{differing}");
    }

    #[test]
    fn beams_that_no_numbers_are_left_for_are_refused() {
        let far = Point3::new(1e9, 0.0, 0.0);
        assert!(Rays::new(far, [far].into_iter()).is_none());
        assert!(Rays::new(Point3::origin(), [Point3::new(0.0, 0.0, 2_000.0)].into_iter()).is_none());
        assert!(Rays::new(Point3::origin(), std::iter::empty()).is_none());
    }
}
