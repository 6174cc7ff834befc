//! Voxels that one keyframe saw through, while they are gathered.

use crate::blocks::{BLOCK, BlockKey};
use nalgebra::{Point3, Vector3};
use percept_geometry::{Voxel, by_processor};

/// Voxels of a block, 64 a word by slot.
pub(crate) const WORDS: usize = 8;

/// Voxels of a block that one keyframe saw through, a bit each.
pub(crate) type Seen = [u64; WORDS];

/// Blocks around a sensor, to mark voxels in. A keyframe sees through so few voxels along an axis ([`Window::MOST_STEPS`]) that a bit
/// for each of them takes less time than looking up blocks.
pub(crate) struct Window {
    /// The block in its smallest corner.
    first: BlockKey,
    /// Blocks along y and z.
    size: [i32; 2],
    /// Ascending by block.
    blocks: Vec<Seen>,
}

/// Voxels are numbered by what an `i32` holds, less a margin for a step beyond.
const MOST_VOXELS: f64 = (1u64 << 31) as f64 - 64.0;
/// Parts of a voxel that are told apart along a beam, as a power of two: numbers of a window fit into the rest of an `i32`.
const PART_BITS: u32 = 20;
const PARTS: i32 = 1 << PART_BITS;

impl Window {
    /// Steps of a voxel that a beam may take.
    pub(crate) const MOST_STEPS: usize = 240;

    /// Around a sensor's beams, by points in voxels within the most steps of each other's middle; none where voxels have no number.
    pub(crate) fn around(points: impl Iterator<Item = Point3<f64>>) -> Option<Self> {
        let (mut low, mut high) =
            (Point3::new(f64::MAX, f64::MAX, f64::MAX), Point3::new(f64::MIN, f64::MIN, f64::MIN));
        points.for_each(|p| (low, high) = (low.inf(&p), high.sup(&p)));
        if !low.iter().chain(high.iter()).all(|v| v.abs() < MOST_VOXELS) {
            return None;
        }
        // A voxel more, for rounding and for the layer beside.
        let first = low.map(|v| ((v - 1.5) / f64::from(BLOCK)).floor() as i32);
        let size = (high.map(|v| ((v + 1.5) / f64::from(BLOCK)).floor() as i32) - first).map(|v| v + 1);
        let num = size.iter().map(|v| *v as usize).product();
        let blocks = vec![Seen::default(); num];
        Some(Self { first: (first.x, first.y, first.z), size: [size.y, size.z], blocks })
    }

    /// Marks a voxel; one outside of the window is left out.
    #[inline]
    pub(crate) fn mark(&mut self, v: Voxel) {
        let (x, y, z) = (v.x - self.first.0 * BLOCK, v.y - self.first.1 * BLOCK, v.z - self.first.2 * BLOCK);
        let [rows, layers] = self.size;
        if x < 0 || y < 0 || z < 0 || y >= rows * BLOCK || z >= layers * BLOCK {
            return;
        }
        let block = ((x / BLOCK) * rows + y / BLOCK) * layers + z / BLOCK;
        let bit = (z % BLOCK) << 6 | (y % BLOCK) << 3 | (x % BLOCK);
        if let Some(seen) = self.blocks.get_mut(block as usize) {
            seen[bit as usize / 64] |= 1 << (bit % 64);
        }
    }

    /// Marks the voxels whose inner half `num` steps of a voxel from `start` (in voxels) along a beam come through; the
    /// direction is of length 1. Of a `planar` beam it counts how far aside it passes in its plane, and near a border between two layers
    /// it speaks for both.
    pub(crate) fn mark_along(&mut self, start: &Point3<f64>, direction: &Vector3<f64>, num: usize, planar: bool) {
        let corner = [self.first.0, self.first.1, self.first.2].map(|v| f64::from(v) * f64::from(BLOCK));
        let fixed = |v: f64| (v * f64::from(PARTS)) as i32;
        let from = std::array::from_fn(|i| fixed(start[i] - corner[i]));
        let by = std::array::from_fn(|i| (direction[i] * f64::from(PARTS)).round() as i32);
        let (mut at, num) = ([0u32; Self::MOST_STEPS], num.min(Self::MOST_STEPS));
        // Whole vectors.
        let lanes = num.next_multiple_of(16).min(at.len());
        steps(from, by, self.size, if planar { 0.0 } else { 1.0 }, &mut at[..lanes]);
        let words = self.blocks.as_flattened_mut();
        // No branch: whether a beam passes the inner half of a voxel cannot be foretold.
        for at in &at[..num] {
            if let Some(word) = words.get_mut((at & !PASSES) as usize / 64) {
                *word |= u64::from(at >> 31) << (at % 64);
            }
        }
        if planar {
            self.mark_beside(from, by, &at[..num]);
        }
    }

    /// Marks the voxels nearest to where a beam from a sensor (in voxels) crosses each layer of voxels' centres across its main axis,
    /// from one length to another along it.
    pub(crate) fn mark_crossed(&mut self, sensor: &Point3<f64>, direction: &Vector3<f64>, (near, far): (f64, f64)) {
        let main = direction.iamax();
        let axes = [main, (main + 1) % 3, (main + 2) % 3];
        let first = [self.first.0, self.first.1, self.first.2];
        let from = axes.map(|a| sensor[a] - f64::from(first[a]) * f64::from(BLOCK));
        let by = axes.map(|a| direction[a] / direction[main].abs());
        // Centres at whole numbers.
        let (a, b) = (from[0] - 0.5 + direction[main] * near, from[0] - 0.5 + direction[main] * far);
        let (low, high) = (a.min(b).ceil(), a.max(b).floor());
        let layer = if by[0] < 0.0 { high } else { low };
        let until = (layer + 0.5 - from[0]) / by[0];
        let fixed = |v: f64| (v * f64::from(PARTS)) as i32;
        let start = [layer as i32, fixed(from[1] + by[1] * until), fixed(from[2] + by[2] * until)];
        let by = [by[0] as i32, (by[1] * f64::from(PARTS)).round() as i32, (by[2] * f64::from(PARTS)).round() as i32];
        let num = (high - low + 1.0).clamp(0.0, Self::MOST_STEPS as f64) as usize;
        let [rows, layers] = self.size;
        let blocks = [rows.wrapping_mul(layers) << 9, layers << 9, 1 << 9];
        let mut at = [0u32; Self::MOST_STEPS];
        // Whole vectors.
        let lanes = num.next_multiple_of(16).min(at.len());
        crossed(start, by, axes.map(|a| blocks[a]), axes.map(|a| 3 * a as u32), &mut at[..lanes]);
        let words = self.blocks.as_flattened_mut();
        for at in &at[..num] {
            if let Some(word) = words.get_mut(*at as usize / 64) {
                *word |= 1 << (at % 64);
            }
        }
    }

    /// Marks the voxels in the nearer of the layers above and below, where a beam passes close to it.
    fn mark_beside(&mut self, from: [i32; 3], by: [i32; 3], at: &[u32]) {
        for k in (0..at.len()).filter(|k| at[*k] & PASSES != 0) {
            let [x, y, z] = std::array::from_fn(|i| from[i] + by[i] * k as i32);
            let off = off_center(z);
            if off.abs() > 0.25 {
                let voxel = |v: i32, block: i32| (v >> PART_BITS) + block * BLOCK;
                let z = voxel(z, self.first.2) + off.signum() as i32;
                self.mark(Voxel { x: voxel(x, self.first.0), y: voxel(y, self.first.1), z });
            }
        }
    }

    /// Blocks in which something was marked, ascending.
    pub(crate) fn into_blocks(self) -> Vec<(BlockKey, Seen)> {
        let [rows, layers] = self.size;
        let key = |i: usize| {
            let (i, column) = (i as i32, rows * layers);
            (self.first.0 + i / column, self.first.1 + i / layers % rows, self.first.2 + i % layers)
        };
        let marked = self.blocks.iter().enumerate().filter(|(_, seen)| seen.iter().any(|bits| *bits != 0));
        marked.map(|(i, seen)| (key(i), *seen)).collect()
    }
}

/// Set where a beam passes the inner half.
const PASSES: u32 = 1 << 31;

/// How far a number of parts lies from the centre of its voxel, in voxels.
#[inline(always)]
fn off_center(v: i32) -> f32 {
    ((v & (PARTS - 1)) - PARTS / 2) as f32 * (1.0 / PARTS as f32)
}

by_processor! {
    [avx512]
    /// Which bit of a window each step along a beam is in, and whether it passes the inner half of that voxel ([`PASSES`]). Places and
    /// steps are parts of voxels from the window's corner; `aside_z` is 0 where it does not count how far aside it passes along z.
    fn steps(from: [i32; 3], by: [i32; 3], size: [i32; 2], aside_z: f32, out: &mut [u32]) {
        let [x0, y0, z0] = from;
        let [dx, dy, dz] = by;
        let [rows, layers] = size;
        for (k, out) in out.iter_mut().enumerate() {
            let k = k as i32;
            let x = x0.wrapping_add(dx.wrapping_mul(k));
            let y = y0.wrapping_add(dy.wrapping_mul(k));
            let z = z0.wrapping_add(dz.wrapping_mul(k));
            let (off_x, off_y, off_z) = (off_center(x), off_center(y), off_center(z) * aside_z);
            let passes = off_x * off_x + off_y * off_y + off_z * off_z <= 0.25;
            let (x, y, z) = (x >> PART_BITS, y >> PART_BITS, z >> PART_BITS);
            let block = (x >> 3).wrapping_mul(rows).wrapping_add(y >> 3).wrapping_mul(layers).wrapping_add(z >> 3);
            let bit = block << 9 | (z & 7) << 6 | (y & 7) << 3 | (x & 7);
            *out = bit as u32 & !PASSES | if passes { PASSES } else { 0 };
        }
    }
}

by_processor! {
    [avx512]
    /// Which bit of a window each layer is crossed in, `start` in the first; by the main axis, in whole voxels, and the two after it, in
    /// parts. `blocks` are how many bits blocks lie apart along these, `shifts` the same for voxels, as powers of two.
    fn crossed(start: [i32; 3], by: [i32; 3], blocks: [i32; 3], shifts: [u32; 3], out: &mut [u32]) {
        for (k, out) in out.iter_mut().enumerate() {
            let k = k as i32;
            let at = |axis: usize| start[axis].wrapping_add(by[axis].wrapping_mul(k));
            let voxels = [at(0), at(1) >> PART_BITS, at(2) >> PART_BITS];
            let bits = |axis: usize| {
                (voxels[axis] >> 3).wrapping_mul(blocks[axis]).wrapping_add((voxels[axis] & 7) << shifts[axis])
            };
            *out = bits(0).wrapping_add(bits(1)).wrapping_add(bits(2)) as u32;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn a_beam_marks_the_voxels_that_are_nearest_in_each_layer_it_crosses() {
        let spread = |i: u32, m: u32| f64::from(i.wrapping_mul(m) >> 8) / f64::from(1u32 << 24) - 0.5;
        let (mut num, mut off) = (0, 0);
        for i in 1..600u32 {
            let sensor = Point3::new(spread(i, 2_654_435_761), spread(i, 40_503), spread(i, 97_531))
                * [9.0, 1e5][i as usize % 2];
            let direction =
                Vector3::new(spread(i, 2_246_822_519), spread(i, 3_266_489_917), spread(i, 668_265_263)).normalize();
            let range = (0.5, 2.0 + 112.0 * (spread(i, 374_761_393) + 0.5));
            let ends = [range.0, range.1].map(|along| sensor + direction * along);
            let Some(mut window) = Window::around(ends.into_iter()) else { panic!("beam {i}") };
            window.mark_crossed(&sensor, &direction, range);
            let mut ours = BTreeSet::new();
            for ((bx, by, bz), seen) in window.into_blocks() {
                for slot in (0..512).filter(|slot| seen[slot / 64] >> (slot % 64) & 1 == 1).map(|slot| slot as i32) {
                    ours.insert([8 * bx + slot % 8, 8 * by + slot / 8 % 8, 8 * bz + slot / 64]);
                }
            }
            let main = direction.iamax();
            let (a, b) = (ends[0][main].min(ends[1][main]), ends[0][main].max(ends[1][main]));
            let layers = (a - 0.5).ceil() as i32..=(b - 0.5).floor() as i32;
            let crossing =
                |layer: i32| sensor + direction * ((f64::from(layer) + 0.5 - sensor[main]) / direction[main]);
            let plain: BTreeSet<[i32; 3]> = layers
                .map(|layer| {
                    let mut voxel: [i32; 3] = crossing(layer).map(|v| v.floor() as i32).into();
                    voxel[main] = layer;
                    voxel
                })
                .collect();
            num += plain.len();
            off += ours.symmetric_difference(&plain).count();
        }
        // Beams along a border, to within rounding.
        assert!(num > 10_000 && off * 2_000 < num, "{off} of {num}");
    }
}
