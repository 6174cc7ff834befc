//! What the keyframes of one submap saw through: how often, by voxel.

use super::CloudParams;
use super::block::BlockKey;
use super::range_image::{BIN_RAD, RangeImage};
use crate::seen::{Seen, WORDS, Window};
use nalgebra::Vector3;
use std::collections::BTreeMap;
use std::sync::Arc;

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
    let first = params.range_min_m.max(0.5 * voxel);
    // In voxels, so that a step is one long and nothing is divided: these are the most steps that a keyframe takes.
    let (sensor, first_step) = (ranges.sensor() / voxel, first / voxel);
    let mut beams: Vec<(Vector3<f64>, usize)> = Vec::new();
    ranges.visit_beams(|direction: &Vector3<f64>, shortest_around| {
        // As far as beams end well behind. What is in a voxel may lie twice as far from the beam as a point of which
        // `sees_through` says that it was seen through, so grazing beams need twice the margin.
        let reach = (shortest_around - params.margin(0.0)) / (1.0 + 2.0 * params.carve_margin_ratio);
        let steps = ((reach.min(farthest) - first) / voxel).floor();
        if steps >= 0.0 {
            beams.push((*direction, steps as usize + 1));
        }
    });
    let ends = |(direction, num): &(Vector3<f64>, usize)| {
        [sensor + direction * first_step, sensor + direction * (first_step + *num as f64)]
    };
    let Some(mut window) = Window::around(beams.iter().flat_map(ends)) else { return vec![] };
    for (direction, num) in &beams {
        window.mark_along(&(sensor + direction * first_step), direction, *num, planar);
    }
    window.into_blocks()
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
#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;
    use percept_geometry::Voxel;
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
