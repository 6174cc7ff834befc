//! What the keyframes of one submap saw through: how often, by voxel.

use super::CloudParams;
use super::range_image::RangeImage;
use super::update::{BlockKey, locate};
use nalgebra::Vector3;
use percept_geometry::Voxel;
use rustc_hash::FxHashMap;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Voxels of a block, 64 a word by slot.
const WORDS: usize = 8;

/// Voxels of a block that one keyframe saw through, a bit each.
pub(super) type Seen = [u64; WORDS];

/// How many keyframes saw through each voxel of a block, at most 7: three binary digits, the lowest first. So many
/// take any weight of the defaults away.
pub(super) type Count = [[u64; WORDS]; 3];

/// What a submap saw through, by block.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct FreeSpace {
    pub(super) blocks: Arc<BTreeMap<BlockKey, Arc<Count>>>,
}

impl FreeSpace {
    /// Counts what one more keyframe saw through.
    pub(super) fn add(&mut self, seen: &[(BlockKey, Seen)]) {
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

    pub(super) fn memory_bytes(&self) -> usize {
        self.blocks.len() * (size_of::<Count>() + size_of::<BlockKey>())
    }
}

/// How often a voxel of a block was seen through.
pub(super) fn count_at(count: &Count, slot: u16) -> u8 {
    let (word, bit) = (usize::from(slot / 64), slot % 64);
    (0..3).map(|digit| ((count[digit][word] >> bit & 1) as u8) << digit).sum()
}

/// The voxels whose inner half a beam passed, as far as it and the beams around it end well behind: as
/// [`RangeImage::sees_through`] has it for points. All beams of a `planar` sensor may run along the
/// border of two layers of voxels, through the inner half of none: what counts is how far aside they pass in their plane, and
/// near a border they speak for both layers. Ascending by block.
pub(super) fn seen_through(ranges: &RangeImage, params: &CloudParams, planar: bool) -> Vec<(BlockKey, Seen)> {
    let voxel = params.voxel_size_m;
    let mut free = Marks::default();
    ranges.visit_beams(|direction: &Vector3<f64>, shortest_around| {
        // As far as beams end well behind. What is in a voxel may lie twice as far from the beam as a point of which
        // `sees_through` says that it was seen through, so grazing beams need twice the margin.
        let reach = (shortest_around - params.margin(0.0)) / (1.0 + 2.0 * params.carve_margin_ratio);
        let reach = reach.min(params.range_max_m);
        let first = params.range_min_m.max(0.5 * voxel);
        let steps = ((reach - first) / voxel).floor();
        // In voxels, so that a step is one long and nothing is divided: these are the most steps that a keyframe takes.
        let start = (ranges.sensor() + direction * first) / voxel;
        for step in 0..if steps >= 0.0 { steps as usize + 1 } else { 0 } {
            let p = start + direction * step as f64;
            let Some(v) = Voxel::containing(&p, 1.0) else { return };
            let off = p - v.center(1.0);
            let aside2 = if planar { off.xy().norm_squared() } else { off.norm_squared() };
            if aside2 > 0.25 {
                continue;
            }
            free.mark(v);
            if planar && off.z.abs() > 0.25 {
                free.mark(Voxel { z: v.z.saturating_add(off.z.signum() as i32), ..v });
            }
        }
    });
    free.blocks.sort_unstable_by_key(|b| b.0);
    free.blocks
}

/// Voxels that one keyframe saw through, while they are gathered.
#[derive(Default)]
struct Marks {
    blocks: Vec<(BlockKey, Seen)>,
    index: FxHashMap<BlockKey, usize>,
    last: Option<(BlockKey, usize)>,
}

impl Marks {
    fn mark(&mut self, v: Voxel) {
        let (key, slot) = locate(v);
        let at = match self.last {
            Some((known, at)) if known == key => at,
            _ => *self.index.entry(key).or_insert_with(|| {
                self.blocks.push((key, Seen::default()));
                self.blocks.len() - 1
            }),
        };
        self.last = Some((key, at));
        self.blocks[at].1[usize::from(slot / 64)] |= 1 << (slot % 64);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
