//! One keyframe as means by voxel, and as what it saw through.

use super::SurfaceParams;
use super::beams::{Around, NEAR};
use super::block::{Observation, VOXELS};
use crate::KeyframeView;
use crate::blocks::{BlockKey, corner};
use crate::cloud::range_image::{BIN_RAD, RangeImage};
use crate::seen::{Seen, Window};
use nalgebra::{Point3, Vector3};
use rustc_hash::FxHashMap;

/// Returns up to this range count as a whole look, metres; beyond it a look counts by its inverse square, as a camera's noise in
/// depth grows with range (Oleynikova et al., "Voxblox", 2017, weigh by the inverse square alone).
const FULL_WEIGHT_RANGE_M: f64 = 2.0;
/// The least that a look counts.
const LEAST_WEIGHT: f64 = 1.0 / 16.0;
/// Blocks that a keyframe may touch: what its later points add beyond is left out. A third of a gigabyte while it is worked on; a
/// room's keyframe at 5 cm touches some hundreds.
const MAX_BLOCKS_OF_SCAN: usize = 1 << 15;

/// What one keyframe says about the surface. Depends on the pose and the scan alone, so that many keyframes can be worked on at
/// once.
#[derive(Debug, Clone)]
pub struct SurfaceUpdate {
    /// Submap's frame, metres.
    pub(super) sensor: Point3<f64>,
    /// Ascending by block.
    pub(super) blocks: Vec<(BlockKey, Box<Sums>)>,
    /// Voxels that were seen through, ascending by block.
    pub(super) free: Vec<(BlockKey, Seen)>,
}

/// Sums over the beams that pass the voxels of a block.
#[derive(Debug, Clone)]
pub(super) struct Sums {
    /// Weight and weighted distance: together, as they are added to together.
    looks: [[f32; 2]; VOXELS],
    /// Weighted red, green, blue; none of a scan without colours.
    colors: Option<Box<[[f32; 3]; VOXELS]>>,
}

impl Sums {
    fn empty(is_colored: bool) -> Self {
        Self { looks: [[0.0; 2]; VOXELS], colors: is_colored.then(|| Box::new([[0.0; 3]; VOXELS])) }
    }

    /// Whether a beam passed a voxel.
    pub(super) fn says_anything_of(&self, slot: usize) -> bool {
        self.looks[slot][0] > 0.0
    }

    /// What the keyframe says of each voxel, by slot.
    pub(super) fn observations(
        &self,
        sensor: &Point3<f64>,
        key: BlockKey,
        params: &SurfaceParams,
    ) -> impl Iterator<Item = (usize, Observation)> {
        let center = corner(key, 0, params.voxel_size_m) + Vector3::repeat(4.0 * params.voxel_size_m);
        let look = (FULL_WEIGHT_RANGE_M / (center - sensor).norm()).powi(2).clamp(LEAST_WEIGHT, 1.0) as f32;
        (0..VOXELS).filter(|slot| self.says_anything_of(*slot)).map(move |slot| {
            let [sum, distance] = self.looks[slot];
            let color = self.colors.as_ref().map(|colors| colors[slot].map(|channel| channel / sum));
            (slot, Observation { distance: distance / sum, weight: sum.min(1.0) * look, color })
        })
    }
}

impl SurfaceUpdate {
    pub(super) fn nothing() -> Self {
        Self { sensor: Point3::origin(), blocks: vec![], free: vec![] }
    }

    /// The beams of a keyframe. Returns that are not finite are left out, as are those out of range but for
    /// what they saw through. The beams of a planar scan show no surface: nothing is taken of it.
    ///
    /// Around its return, a beam is spread over the four voxels around where it crosses each layer of voxels across its main
    /// axis, bilinearly: beams a voxel apart leave no gaps. A voxel takes the mean of the beams, and together they count as one
    /// look, less if they hardly passed it.
    pub(super) fn new(params: &SurfaceParams, view: &KeyframeView<'_>) -> Self {
        let scan = view.scan;
        if scan.planar {
            return Self::nothing();
        }
        let sensor = view.sensor();
        let mut band = Band::new(params, sensor, scan.hits.colors.is_some());
        for (i, end) in view.hits().iter().enumerate() {
            let color = scan.hits.colors.as_ref().and_then(|c| c.get(i)).copied().unwrap_or_default();
            band.add(end, color.map(f32::from));
        }
        let mut free = vec![];
        if params.carve {
            free = seen_through(params, view.ranges());
        }
        Self { sensor, blocks: band.into_blocks(), free }
    }
}

/// Blocks of a neighbourhood.
const NEAR_BLOCKS: usize = (NEAR * NEAR * NEAR) as usize;
/// No block.
const NONE: u32 = u32::MAX;

/// The voxels around returns, while they are gathered.
struct Band<'a> {
    params: &'a SurfaceParams,
    sensor: Point3<f64>,
    is_colored: bool,
    blocks: Vec<(BlockKey, Box<Sums>)>,
    index: FxHashMap<BlockKey, u32>,
    around: Around,
    /// The neighbourhood of the latest beam, which the next one often shares: its first block, which of `blocks` those of it are, and
    /// which of these are known.
    first: BlockKey,
    near: [u32; NEAR_BLOCKS],
    known: Vec<usize>,
}

impl<'a> Band<'a> {
    fn new(params: &'a SurfaceParams, sensor: Point3<f64>, is_colored: bool) -> Self {
        let (around, near) = (Around::NOTHING, [NONE; NEAR_BLOCKS]);
        let (blocks, index, first, known) = (vec![], FxHashMap::default(), (0, 0, 0), vec![]);
        Self { params, sensor, is_colored, blocks, index, around, first, near, known }
    }

    /// Adds a beam that ended at `end`.
    fn add(&mut self, end: &Point3<f64>, color: [f32; 3]) {
        let beam = end - self.sensor;
        let range_m = beam.norm();
        if !(range_m >= self.params.range_min_m.max(1e-6) && range_m <= self.params.range_max()) {
            return;
        }
        let (voxel, direction) = (self.params.voxel_size_m, beam / range_m);
        self.around.follow(&(end / voxel), &direction, range_m / voxel, self.params.truncation() / voxel);
        let Self { blocks, index, around, near, known, is_colored, .. } = self;
        if around.first != self.first {
            self.first = around.first;
            known.drain(..).for_each(|at| near[at] = NONE);
        }
        around.visit(|place, distance, weight| {
            let (at, slot) = ((place >> 9) as usize % NEAR_BLOCKS, place as usize % VOXELS);
            if near[at] == NONE {
                let edge = NEAR as usize;
                let along = |first: i32, i: usize| first + (i % edge) as i32;
                let (x, y, z) = around.first;
                let key = (along(x, at), along(y, at / edge), along(z, at / edge / edge));
                let Some(open) = open(blocks, index, key, *is_colored) else { return };
                near[at] = open;
                known.push(at);
            }
            let sums = &mut blocks[near[at] as usize].1;
            sums.looks[slot][0] += weight;
            sums.looks[slot][1] += weight * distance;
            if let Some(colors) = &mut sums.colors {
                colors[slot].iter_mut().zip(color).for_each(|(sum, channel)| *sum += weight * channel);
            }
        });
    }

    fn into_blocks(mut self) -> Vec<(BlockKey, Box<Sums>)> {
        self.blocks.sort_unstable_by_key(|b| b.0);
        self.blocks
    }
}

/// Which of the blocks one is, begun if need be; none beyond the most blocks.
fn open(
    blocks: &mut Vec<(BlockKey, Box<Sums>)>,
    index: &mut FxHashMap<BlockKey, u32>,
    key: BlockKey,
    is_colored: bool,
) -> Option<u32> {
    if let Some(at) = index.get(&key) {
        return Some(*at);
    }
    let at = Some(blocks.len()).filter(|num| *num < MAX_BLOCKS_OF_SCAN)? as u32;
    blocks.push((key, Box::new(Sums::empty(is_colored))));
    index.insert(key, at);
    Some(at)
}

/// The voxels that beams pass nearest to the centre, as far as they and the beams around them end well behind; up to where
/// neighbouring beams are a voxel apart.
fn seen_through(params: &SurfaceParams, ranges: &RangeImage) -> Vec<(BlockKey, Seen)> {
    let voxel = params.voxel_size_m;
    let farthest = params.range_max().min(voxel / BIN_RAD);
    let (sensor, near) = (ranges.sensor() / voxel, params.range_min_m.max(0.5 * voxel) / voxel);
    let mut beams: Vec<(Vector3<f64>, f64)> = Vec::new();
    ranges.visit_beams(|direction: &Vector3<f64>, shortest_around| {
        // The margin grows with the range of the voxel, which is at most that of the shortest beam.
        let reach = (shortest_around - params.carve_margin(shortest_around)).min(farthest) / voxel;
        if reach >= near {
            beams.push((*direction, reach));
        }
    });
    let ends = beams.iter().flat_map(|(direction, reach)| [near, *reach].map(|along| sensor + direction * along));
    let Some(mut window) = Window::around(ends) else { return vec![] };
    for (direction, reach) in &beams {
        window.mark_crossed(&sensor, direction, (near, *reach));
    }
    window.into_blocks()
}
