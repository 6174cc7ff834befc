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
const NONE: u32 = u32::MAX;

/// Voxels that were passed, a byte each while they are gathered: a byte is written, where a bit would have to be read before.
pub(super) struct Rays {
    /// Voxels from `low`, a block's corner; the sensor and all ends lie within.
    sensor: Point3<f64>,
    low: [i32; 3],
    size: [usize; 3],
    /// Place of each block among `passed`, row by row.
    places: Vec<u32>,
    keys: Vec<usize>,
    passed: Vec<[u8; VOXELS]>,
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
        let places = vec![NONE; size.iter().product()];
        Some(Self { sensor, low, size, places, keys: vec![], passed: vec![] })
    }

    /// Passes all voxels from the sensor to an end (in voxels), that of the end included.
    ///
    /// Goes from one layer of voxels to the next along the axis that the beam follows most: in between it crosses at most one
    /// border along each of the others, and where those are is added up, not compared.
    pub(super) fn pass(&mut self, end: &Point3<f64>) {
        let end = end - nalgebra::Vector3::from(self.low.map(f64::from));
        // Which axis that is has to be known beforehand, for cells to be kept in registers.
        match (end - self.sensor).iamax() {
            0 => self.pass_along::<0>(&end),
            1 => self.pass_along::<1>(&end),
            _ => self.pass_along::<2>(&end),
        }
    }

    fn pass_along<const MAIN: usize>(&mut self, end: &Point3<f64>) {
        let along = end - self.sensor;
        let main = MAIN;
        let [u, v] = [(main + 1) % 3, (main + 2) % 3];
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
        let mut cell = [0i64; 3];
        let layers = (to - from).abs();
        for layer in 0..=layers {
            if layer == layers {
                (next_u, next_v) = (end_u, end_v);
            }
            cell[main] = from + step * layer;
            let (u0, v0, u1, v1) = (now_u >> 32, now_v >> 32, next_u >> 32, next_v >> 32);
            (cell[u], cell[v]) = (u0, v0);
            self.mark(cell);
            if (u0, v0) != (u1, v1) {
                if u0 != u1 && v0 != v1 {
                    (cell[u], cell[v]) =
                        if crosses_first((now_u, next_u), (now_v, next_v)) { (u1, v0) } else { (u0, v1) };
                    self.mark(cell);
                }
                (cell[u], cell[v]) = (u1, v1);
                self.mark(cell);
            }
            (now_u, now_v) = (next_u, next_v);
            (next_u, next_v) = (next_u + du, next_v + dv);
        }
    }

    #[inline]
    fn mark(&mut self, cell: [i64; 3]) {
        // Rounding may only err by a voxel, for which there is a rim; a number that is negative all the same is too large then.
        let [x, y, z] = cell.map(|v| v as usize);
        let place = ((z / 8) * self.size[1] + y / 8) * self.size[0] + x / 8;
        let Some(&block) = self.places.get(place) else { return };
        let block = if block == NONE { self.open(place) } else { block };
        self.passed[block as usize][(z % 8) * 64 + (y % 8) * 8 + x % 8] = 1;
    }

    #[cold]
    fn open(&mut self, place: usize) -> u32 {
        let block = self.passed.len() as u32;
        self.passed.push([0; VOXELS]);
        self.keys.push(place);
        self.places[place] = block;
        block
    }

    /// All that were passed, by block, in no order.
    pub(super) fn passed(&self) -> Vec<(BlockKey, Bits)> {
        let low = self.low.map(|v| v / BLOCK);
        let of = |(place, bytes): (&usize, &[u8; VOXELS])| {
            let (x, y, z) =
                (place % self.size[0], place / self.size[0] % self.size[1], place / self.size[0] / self.size[1]);
            let mut bits = Bits::default();
            for (word, bytes) in bits.iter_mut().zip(bytes.chunks_exact(64)) {
                *word = bytes.iter().enumerate().fold(0, |w, (i, b)| w | u64::from(*b) << i);
            }
            ((low[0] + x as i32, low[1] + y as i32, low[2] + z as i32), bits)
        };
        self.keys.iter().zip(&self.passed).map(of).collect()
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
