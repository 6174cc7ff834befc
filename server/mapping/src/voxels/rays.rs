//! Which voxels the beams of one sensor pass.

use super::block::{Bits, VOXELS};
use crate::blocks::{BLOCK, BlockKey};
use nalgebra::{Point3, Vector3};
use percept_geometry::{Voxel, by_processor};

/// Blocks along the longest edge of what one scan may reach: twice the largest range, and a rim.
const MAX_BLOCKS: usize = 164;
/// Layers of voxels that are worked on together, and how many times as many a beam may come through.
const LANES: usize = 16;
const MAX_CHUNKS: usize = MAX_BLOCKS * BLOCK as usize / LANES;
/// Whoever stands farther out, in voxels, has no numbers left for its voxels.
const FARTHEST: f64 = 1e9;
/// Parts of a voxel that are told apart.
const FIXED: f64 = (1u64 << 32) as f64;
/// Blocks that are kept side by side, whether a beam passes them or not: 16 MB. Of more, those that any passes are looked up.
const MAX_DENSE: usize = 1 << 15;
const NONE: u32 = u32::MAX;
/// What is kept of a voxel: a beam passed it, or one ended there.
const PASSED: u8 = 1;
const HIT: u8 = 2;

/// Voxels that were passed, a byte each while they are gathered: a byte is written, where a bit would have to be read before.
pub(super) struct Rays {
    /// Voxels from `low`, a block's corner; the sensor and all ends lie within.
    sensor: Point3<f64>,
    low: [i32; 3],
    size: [usize; 3],
    /// By axis, how far a block lies from the one before, and a voxel from that before it in its block.
    apart: [[u32; 2]; 3],
    /// Which of `seen` is each block's; empty if all are there. Ascending by block.
    blocks: Vec<u32>,
    seen: Vec<u8>,
    /// Of the latest beams, by layer from the sensor on.
    layers: Vec<Layers>,
}

/// Places of the voxels in which the latest beam came into each of some layers, passed between two borders there, and went out; often the
/// same. All of them are marked, so that a beam that comes through the same need not mark them again: beams side by side mostly do.
#[derive(Clone, Copy)]
struct Layers {
    come: [u32; LANES],
    between: [u32; LANES],
    go: [u32; LANES],
    /// Which of these are not marked yet, a bit each.
    news: u32,
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
        let sensor = sensor - Vector3::from(low.map(f64::from));
        // Blocks as they are sorted, along z first; voxels in a block along x first.
        let (voxels, edge) = (VOXELS as u32, BLOCK as u32);
        let apart = [[voxels * (size[1] * size[2]) as u32, 1], [voxels * size[2] as u32, edge], [voxels, edge * edge]];
        let num: usize = size.iter().product();
        let (blocks, seen) = if num <= MAX_DENSE { (vec![], vec![0; num * VOXELS]) } else { (vec![NONE; num], vec![]) };
        let nowhere = [u32::MAX; LANES];
        let layers = vec![Layers { come: nowhere, between: nowhere, go: nowhere, news: 0 }; MAX_CHUNKS];
        Some(Self { sensor, low, size, apart, blocks, seen, layers })
    }

    /// Passes all voxels from the sensor to an end (in voxels), that of the end included.
    ///
    /// Goes from one layer of voxels to the next along the axis that the beam follows most: in between it crosses at most one
    /// border along each of the others. So there are three places a layer, found without a branch, several layers at a time; that
    /// some are the same costs less than to ask, as the answer cannot be foretold.
    pub(super) fn pass(&mut self, end: &Point3<f64>) {
        let end = end - Vector3::from(self.low.map(f64::from));
        let along = end - self.sensor;
        let main = along.iamax();
        let [u, v] = [(main + 1) % 3, (main + 2) % 3];
        // Nothing is below zero, so that cutting off is rounding down.
        let (from, to) = (self.sensor[main] as i32, end[main] as i32);
        let step: i32 = if along[main] < 0.0 { -1 } else { 1 };
        let fixed = |x: f64| (x * FIXED) as i64;
        // Where the beam crosses the first border, and how far aside it goes from each border to the next.
        let until = (f64::from(from + step.max(0)) - self.sensor[main]).abs();
        let per_layer = if along[main] == 0.0 { 0.0 } else { 1.0 / along[main].abs() };
        let slope = |axis: usize| along[axis] * per_layer;
        let first = [u, v].map(|axis| fixed(self.sensor[axis] + slope(axis) * until));
        let by = [u, v].map(|axis| fixed(slope(axis)));
        let (begin, end) = ([u, v].map(|axis| fixed(self.sensor[axis])), [u, v].map(|axis| fixed(end[axis])));
        let apart = [self.apart[main], self.apart[u], self.apart[v]];
        let last = (from.abs_diff(to) as usize).min(LANES * MAX_CHUNKS - 1);
        let chunks = &mut self.layers[..last / LANES + 1];
        // Whole layers, from the second to the last but one; then the first, and that of the end.
        follow(from, step, first, by, apart, last, chunks);
        let border = |layer: usize| [0, 1].map(|i| first[i].wrapping_add(by[i].wrapping_mul(layer as i64 - 1)));
        let mut set = |layer: usize, now: [i64; 2], next: [i64; 2]| {
            let here = place(from + step * layer as i32, apart[0]);
            let (layers, i) = (&mut chunks[layer / LANES], layer % LANES);
            (layers.come[i], layers.between[i], layers.go[i]) = in_layer(here, now, next, by, [apart[1], apart[2]]);
            layers.news |= 1 << i;
        };
        set(0, begin, if last == 0 { end } else { first });
        if last > 0 {
            set(last, border(last), end);
        }
        self.mark(last / LANES + 1);
    }

    /// Marks the voxels of the latest beam, in so many chunks of layers, that are not marked yet.
    fn mark(&mut self, chunks: usize) {
        let Self { blocks, seen, layers, .. } = self;
        let is_dense = blocks.is_empty();
        for layers in &layers[..chunks] {
            let mut left = layers.news;
            while left != 0 {
                let i = left.trailing_zeros() as usize % LANES;
                left &= left - 1;
                for at in [layers.come[i], layers.between[i], layers.go[i]] {
                    if !is_dense {
                        set_sparse(blocks, seen, at, PASSED);
                    } else if let Some(voxel) = seen.get_mut(at as usize) {
                        // Rounding may only err by a voxel, for which there is a rim.
                        *voxel = PASSED;
                    }
                }
            }
        }
    }

    /// A beam ended in a voxel: that is not free, whatever passes there. To be told after all beams.
    pub(super) fn hit(&mut self, voxel: Voxel) {
        let at: [i64; 3] = [voxel.x, voxel.y, voxel.z].map(i64::from);
        let at: [i64; 3] = std::array::from_fn(|i| at[i] - i64::from(self.low[i]));
        if (0..3).any(|i| at[i] < 0 || at[i] >= (self.size[i] * BLOCK as usize) as i64) {
            return;
        }
        let at = (0..3).map(|i| place(at[i] as i32, self.apart[i])).sum::<u32>();
        if !self.blocks.is_empty() {
            set_sparse(&mut self.blocks, &mut self.seen, at, HIT);
        } else if let Some(voxel) = self.seen.get_mut(at as usize) {
            *voxel = HIT;
        }
    }

    /// All that were passed and hit, ascending by block; what was hit was not passed.
    pub(super) fn blocks(&self) -> Vec<(BlockKey, Bits, Bits)> {
        let low = self.low.map(|v| v / BLOCK);
        let [_, rows, layers] = self.size;
        let key = |i: usize| {
            (low[0] + (i / layers / rows) as i32, low[1] + (i / layers % rows) as i32, low[2] + (i % layers) as i32)
        };
        let of = |i: usize, voxels: &[u8]| {
            let (mut passed, mut hit) = (Bits::default(), Bits::default());
            for (word, voxels) in voxels.chunks_exact(64).enumerate() {
                (passed[word], hit[word]) = (bits(voxels, PASSED), bits(voxels, HIT));
            }
            (key(i), passed, hit)
        };
        if self.blocks.is_empty() {
            let any = |voxels: &[u8]| voxels.iter().fold(0, |any, v| any | v) != 0;
            let all = self.seen.chunks_exact(VOXELS).enumerate();
            return all.filter(|(_, voxels)| any(voxels)).map(|(i, voxels)| of(i, voxels)).collect();
        }
        let there = self.blocks.iter().enumerate().filter(|(_, block)| **block != NONE);
        there.map(|(i, block)| of(i, &self.seen[*block as usize * VOXELS..][..VOXELS])).collect()
    }
}

/// Marks a voxel where blocks are looked up.
#[inline]
fn set_sparse(blocks: &mut [u32], seen: &mut Vec<u8>, at: u32, what: u8) {
    let at = at as usize;
    let Some(block) = blocks.get_mut(at / VOXELS) else { return };
    if *block == NONE {
        *block = (seen.len() / VOXELS) as u32;
        seen.resize(seen.len() + VOXELS, 0);
    }
    seen[*block as usize * VOXELS + at % VOXELS] = what;
}

/// Which of 64 voxels are kept as `what`, a bit each.
fn bits(voxels: &[u8], what: u8) -> u64 {
    let shift = what.trailing_zeros();
    let eight = |bytes: &[u8]| {
        let bytes = bytes.try_into().map_or(0, u64::from_le_bytes) >> shift & 0x0101_0101_0101_0101;
        // The product has the lowest bits of all bytes in its highest, in their order.
        bytes.wrapping_mul(0x0102_0408_1020_4080) >> 56
    };
    voxels.chunks_exact(8).enumerate().fold(0, |word, (i, bytes)| word | eight(bytes) << (8 * i))
}

/// What a voxel's number along an axis adds to its place.
#[inline(always)]
fn place(at: i32, [blocks, voxels]: [u32; 2]) -> u32 {
    ((at >> 3) as u32).wrapping_mul(blocks).wrapping_add((at & 7) as u32 * voxels)
}

/// The places of the voxels in which a beam comes into a layer, passes between the borders that it crosses there, and goes out. `now` and
/// `next` are where it does along the two axes aside (fixed point), `by` how far aside it goes in a whole layer.
#[inline(always)]
fn in_layer(here: u32, now: [i64; 2], next: [i64; 2], by: [i64; 2], apart: [[u32; 2]; 2]) -> (u32, u32, u32) {
    let voxel = |at: i64| (at >> 32) as i32;
    let [from_u, from_v] = [place(voxel(now[0]), apart[0]), place(voxel(now[1]), apart[1])];
    let [to_u, to_v] = [place(voxel(next[0]), apart[0]), place(voxel(next[1]), apart[1])];
    // How far to the border, in parts of 31 bits, which conversions take for whole numbers with a sign.
    let left = |now: i64, by: i64| {
        let beyond = (now as u32 >> 1) as i32;
        (if by > 0 { i32::MAX - beyond } else { beyond }) as f32
    };
    // Which border comes first: the shares of the way to both, multiplied by both ways.
    let is_u_first = left(now[0], by[0]) * (by[1] as f32).abs() < left(now[1], by[1]) * (by[0] as f32).abs();
    let between = if is_u_first { to_u.wrapping_add(from_v) } else { from_u.wrapping_add(to_v) };
    let at = |aside: u32| here.wrapping_add(aside);
    (at(from_u.wrapping_add(from_v)), at(between), at(to_u.wrapping_add(to_v)))
}

by_processor! {
    [avx512]
    /// The places in the layers between the first and the `last`, where `first` is where the beam crosses the first border; and which of them
    /// are other than the latest beam's.
    fn follow(
        from: i32,
        step: i32,
        first: [i64; 2],
        by: [i64; 2],
        apart: [[u32; 2]; 3],
        last: usize,
        chunks: &mut [Layers],
    ) {
        for (chunk, layers) in chunks.iter_mut().enumerate() {
            let mut news = 0;
            for i in 0..LANES {
                let layer = LANES * chunk + i;
                let border = |i: usize| first[i].wrapping_add(by[i].wrapping_mul(layer as i64 - 1));
                let (now, here) = ([border(0), border(1)], from.wrapping_add(step.wrapping_mul(layer as i32)));
                let next = [now[0].wrapping_add(by[0]), now[1].wrapping_add(by[1])];
                let (come, between, go) = in_layer(place(here, apart[0]), now, next, by, [apart[1], apart[2]]);
                let is_whole = (layer as i32 > 0) & ((layer as i32) < last as i32);
                let known = (layers.come[i], layers.between[i], layers.go[i]);
                let is_new = is_whole & ((come != known.0) | (between != known.1) | (go != known.2));
                news |= u32::from(is_new) << i;
                layers.come[i] = if is_new { come } else { known.0 };
                layers.between[i] = if is_new { between } else { known.1 };
                layers.go[i] = if is_new { go } else { known.2 };
            }
            layers.news = news;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
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
            for ((x, y, z), bits, _) in rays.blocks() {
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
