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
