//! What the keyframes of one submap saw through: how often, by voxel.

use super::CloudParams;
use super::block::{BlockKey, locate};
use super::range_image::{BIN_RAD, RangeImage};
use nalgebra::Vector3;
use percept_geometry::Voxel;
use rustc_hash::FxHashMap;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Voxels of a block, 64 a word by slot.
const WORDS: usize = 8;

/// Voxels of a block that one keyframe saw through, a bit each.
pub(crate) type Seen = [u64; WORDS];

/// How many keyframes saw through each voxel of a block, at most 7: three binary digits, the lowest first. So many
/// take any weight of the defaults away.
pub(crate) type Count = [[u64; WORDS]; 3];

/// What a submap saw through, by block.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct FreeSpace {
    pub(crate) blocks: Arc<BTreeMap<BlockKey, Arc<Count>>>,
}

impl FreeSpace {
    /// Counts what one more keyframe saw through.
    pub(crate) fn add(&mut self, seen: &[(BlockKey, Seen)]) {
        let blocks = Arc::make_mut(&mut self.blocks);
        for (key, bits) in seen {
            let count = Arc::make_mut(blocks.entry(*key).or_default());
            for (w, bits) in bits.iter().enumerate() {
                let [a, b, c] = [count[0][w], count[1][w], count[2][w]];
                // Who is at the most stays there.
                let one = bits & !(a & b & c);
                let (carry, next) = (a & one, a & b & one);
                (count[0][w], count[1][w], count[2][w]) = (a ^ one, b ^ carry, c ^ next);
            }
        }
    }

    pub(crate) fn memory_bytes(&self) -> usize {
        self.blocks.len() * (size_of::<Count>() + size_of::<BlockKey>())
    }
}

/// How often a voxel of a block was seen through.
pub(crate) fn count_at(count: &Count, slot: u16) -> u8 {
    let (word, bit) = (usize::from(slot / 64), slot % 64);
    (0..3).map(|digit| ((count[digit][word] >> bit & 1) as u8) << digit).sum()
}

/// The voxels whose inner half a beam passed, as far as it and the beams around it end well behind: as
/// [`RangeImage::sees_through`] has it for points. All beams of a `planar` sensor may run along the
/// border of two layers of voxels, through the inner half of none: what counts is how far aside they pass in their plane, and
/// near a border they speak for both layers. Ascending by block.
pub(super) fn seen_through(ranges: &RangeImage, params: &CloudParams, planar: bool) -> Vec<(BlockKey, Seen)> {
    let voxel = params.voxel_size_m;
    let farthest = farthest_seen_through(ranges, params);
    let mut free = Marks::default();
    ranges.visit_beams(|direction: &Vector3<f64>, shortest_around| {
        // As far as beams end well behind. What is in a voxel may lie twice as far from the beam as a point of which
        // `sees_through` says that it was seen through, so grazing beams need twice the margin.
        let reach = (shortest_around - params.margin(0.0)) / (1.0 + 2.0 * params.carve_margin_ratio);
        let reach = reach.min(farthest);
        let first = params.range_min_m.max(0.5 * voxel);
        let steps = ((reach - first) / voxel).floor();
        // In voxels, so that a step is one long and nothing is divided: these are the most steps that a keyframe takes.
        let start = (ranges.sensor() + direction * first) / voxel;
        let num = if steps >= 0.0 { steps as u32 + 1 } else { return };
        let ends = [start, start + direction * f64::from(num)];
        if !ends.iter().all(|p| p.iter().all(|v| v.abs() < MOST_VOXELS)) {
            return;
        }
        // Which voxel is in the upper half of a number then, and where in it in the lower: adding is all that a step takes.
        let fixed = |v: f64| (v * FIXED) as i64;
        let [mut x, mut y, mut z] = [start.x, start.y, start.z].map(fixed);
        let (dx, dy, dz) = (fixed(direction.x), fixed(direction.y), fixed(direction.z));
        for _ in 0..num {
            let [off_x, off_y, off_z] = [x, y, z].map(from_center);
            let aside2 = off_x * off_x + off_y * off_y + if planar { 0.0 } else { off_z * off_z };
            // No branch: whether a beam passes the inner half of a voxel cannot be foretold.
            let passes = aside2 <= 0.25;
            let v = Voxel { x: (x >> 32) as i32, y: (y >> 32) as i32, z: (z >> 32) as i32 };
            free.mark(v, passes);
            if planar && passes && off_z.abs() > 0.25 {
                free.mark(Voxel { z: v.z.saturating_add(off_z.signum() as i32), ..v }, true);
            }
            (x, y, z) = (x + dx, y + dy, z + dz);
        }
    });
    free.into_blocks()
}

/// Beams of a camera are two voxels apart there, those of a lidar that looks around are one, metres: farther out they pass by most
/// voxels, so that what has gone would lose some of its points only. In between it is as far as [`MOST_STEPS`] allows.
fn farthest_seen_through(ranges: &RangeImage, params: &CloudParams) -> f64 {
    let one_apart = params.voxel_size_m / BIN_RAD;
    let by_steps = MOST_STEPS * params.voxel_size_m / ranges.num_beams().max(1) as f64;
    params.range_max().min(by_steps.clamp(one_apart, 2.0 * one_apart))
}

/// Steps of a voxel along all beams of one keyframe, about: some 40 ms on one core of 2.5 GHz.
const MOST_STEPS: f64 = 6e6;
/// Voxels are numbered by what an `i32` holds, less a margin for rounding.
const MOST_VOXELS: f64 = (1u64 << 31) as f64 - 1.0;
/// Parts of a voxel that are told apart.
const FIXED: f64 = (1u64 << 32) as f64;

/// How far a number of such parts lies from the centre of its voxel, in voxels.
fn from_center(v: i64) -> f32 {
    (v as i32).wrapping_sub(i32::MIN) as f32 * (1.0 / FIXED as f32)
}

/// Voxels that one keyframe saw through, while they are gathered.
#[derive(Default)]
pub(crate) struct Marks {
    /// The one that is marked in; there are none that nothing was marked in only after all is.
    blocks: Vec<(BlockKey, Seen)>,
    index: FxHashMap<BlockKey, usize>,
    last: Option<(BlockKey, usize)>,
}

impl Marks {
    /// Marks a voxel, if so.
    #[inline]
    pub(crate) fn mark(&mut self, v: Voxel, if_so: bool) {
        let (key, slot) = locate(v);
        let at = match self.last {
            Some((known, at)) if known == key => at,
            _ => self.open(key),
        };
        self.blocks[at].1[usize::from(slot / 64)] |= u64::from(if_so) << (slot % 64);
    }

    /// Blocks in which something was marked, ascending.
    pub(crate) fn into_blocks(mut self) -> Vec<(BlockKey, Seen)> {
        self.blocks.retain(|(_, seen)| seen.iter().any(|bits| *bits != 0));
        self.blocks.sort_unstable_by_key(|b| b.0);
        self.blocks
    }

    #[cold]
    fn open(&mut self, key: BlockKey) -> usize {
        let at = *self.index.entry(key).or_insert_with(|| {
            self.blocks.push((key, Seen::default()));
            self.blocks.len() - 1
        });
        self.last = Some((key, at));
        at
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;
    use std::collections::BTreeSet;

    /// As [`seen_through`] says it, step by step.
    fn plainly(ranges: &RangeImage, params: &CloudParams, planar: bool) -> BTreeSet<Voxel> {
        let (voxel, mut free) = (params.voxel_size_m, BTreeSet::new());
        ranges.visit_beams(|direction, shortest_around| {
            let reach = (shortest_around - params.margin(0.0)) / (1.0 + 2.0 * params.carve_margin_ratio);
            let reach = reach.min(farthest_seen_through(ranges, params));
            let mut r = params.range_min_m.max(0.5 * voxel);
            while r <= reach {
                let p = ranges.sensor() + direction * r;
                let Some(v) = Voxel::containing(&p, voxel) else { return };
                let off = (p - v.center(voxel)) / voxel;
                if (if planar { off.xy().norm() } else { off.norm() }) <= 0.5 {
                    free.insert(v);
                    if planar && off.z.abs() > 0.25 {
                        free.insert(Voxel { z: v.z + off.z.signum() as i32, ..v });
                    }
                }
                r += voxel;
            }
        });
        free
    }

    #[test]
    fn what_is_seen_through_is_what_beams_pass_step_by_step() {
        let params = CloudParams::default();
        for (sensor, rows, planar) in [
            (Point3::new(0.31, -0.2, 1.0), -8..=8, false),
            (Point3::new(-7_312.4, 4_021.7, -12.3), -8..=8, false),
            (Point3::new(3.3, -90.2, 0.2001), 0..=0, true),
        ] {
            let ends = rows.flat_map(|row| {
                (0..700).map(move |i| {
                    let (azimuth, elevation) = (f64::from(i) * 0.009, f64::from(row) * 0.03);
                    let range = 4.0 + 3.0 * (3.0 * azimuth).sin();
                    let (c, s) = (elevation.cos() * range, elevation.sin() * range);
                    sensor + Vector3::new(c * azimuth.cos(), c * azimuth.sin(), s)
                })
            });
            let ranges = RangeImage::new(sensor, ends);
            let mut ours = BTreeSet::new();
            for ((bx, by, bz), seen) in seen_through(&ranges, &params, planar) {
                for slot in (0..512).filter(|slot| seen[slot / 64] >> (slot % 64) & 1 == 1).map(|slot| slot as i32) {
                    let (x, y, z) = (slot % 8, slot / 8 % 8, slot / 64);
                    ours.insert(Voxel { x: 8 * bx + x, y: 8 * by + y, z: 8 * bz + z });
                }
            }
            let plain = plainly(&ranges, &params, planar);
            let other = ours.symmetric_difference(&plain).count();
            assert!(plain.len() > 10_000 && other * 2_000 < plain.len(), "{other} of {}", plain.len());
        }
    }

    #[test]
    fn who_stands_where_no_voxel_has_a_number_sees_through_nothing() {
        for far in [1e8, 1e300] {
            let sensor = Point3::new(far + 0.02, 0.02, 0.02);
            let ranges = RangeImage::new(sensor, [sensor + Vector3::new(0.0, 4.0, 0.0)].into_iter());
            let seen = seen_through(&ranges, &CloudParams::default(), false);
            assert_eq!(seen.is_empty(), far > 1.1e8, "{far}");
        }
    }

    #[test]
    fn keyframes_are_counted_up_to_the_most_and_each_voxel_by_itself() {
        let mut free = FreeSpace::default();
        let of = |slots: &[u16]| {
            let mut seen = Seen::default();
            slots.iter().for_each(|s| seen[usize::from(s / 64)] |= 1 << (s % 64));
            vec![((0, 0, 0), seen)]
        };
        (0..3).for_each(|_| free.add(&of(&[5, 300])));
        (0..9).for_each(|_| free.add(&of(&[300, 511])));
        let count = &free.blocks[&(0, 0, 0)];
        assert_eq!([5, 300, 511, 0].map(|slot| count_at(count, slot)), [3, 7, 7, 0]);
    }
}
