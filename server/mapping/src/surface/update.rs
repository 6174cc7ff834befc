//! One keyframe as means by voxel, and as what it saw through.

use super::SurfaceParams;
use super::beams::crossings;
use super::block::{Observation, VOXELS};
use crate::KeyframeView;
use crate::blocks::{BlockKey, corner, locate};
use crate::cloud::range_image::{BIN_RAD, RangeImage};
use crate::seen::{Seen, Window};
use nalgebra::{Point3, Vector3};
use percept_geometry::Voxel;
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
    /// Weight, weighted distance, weighted red, green, blue: together, as they are added to together.
    voxels: [[f32; 5]; VOXELS],
    is_colored: bool,
}

impl Sums {
    fn empty(is_colored: bool) -> Self {
        Self { voxels: [[0.0; 5]; VOXELS], is_colored }
    }

    /// Whether a beam passed a voxel.
    pub(super) fn says_anything_of(&self, slot: usize) -> bool {
        self.voxels[slot][0] > 0.0
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
            let [sum, distance, red, green, blue] = self.voxels[slot];
            let color = self.is_colored.then(|| [red, green, blue].map(|channel| channel / sum));
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

/// What a beam counts at so much of the truncation distance before its return: less behind it, from a voxel on, down to nothing. Beams
/// that graze what is round pass far behind its surface beside few that pass before it, and would push it outward. Source: the
/// linear weight of Bylow et al., "Real-time camera tracking and 3D reconstruction using signed distance functions", 2013.
fn behind(distance: f64, voxel: f64) -> f64 {
    ((1.0 + distance) / (1.0 - voxel)).min(1.0)
}

/// The voxels around returns, while they are gathered.
struct Band<'a> {
    params: &'a SurfaceParams,
    sensor: Point3<f64>,
    is_colored: bool,
    blocks: Vec<(BlockKey, Box<Sums>)>,
    index: FxHashMap<BlockKey, usize>,
    /// The latest of each eight that touch in a corner: a beam goes to and fro between them.
    latest: [Option<(BlockKey, usize)>; 8],
}

/// The place of a block in `Band::latest`.
#[inline]
fn corner_of(key: BlockKey) -> usize {
    ((key.0 & 1) | (key.1 & 1) << 1 | (key.2 & 1) << 2) as usize
}

impl<'a> Band<'a> {
    fn new(params: &'a SurfaceParams, sensor: Point3<f64>, is_colored: bool) -> Self {
        Self { params, sensor, is_colored, blocks: vec![], index: FxHashMap::default(), latest: [None; 8] }
    }

    /// Adds a beam that ended at `end`.
    fn add(&mut self, end: &Point3<f64>, color: [f32; 3]) {
        let beam = end - self.sensor;
        let range_m = beam.norm();
        if !(range_m >= self.params.range_min_m.max(1e-6) && range_m <= self.params.range_max()) {
            return;
        }
        let (voxel, direction) = (self.params.voxel_size_m, beam / range_m);
        let (range, truncation) = (range_m / voxel, self.params.truncation() / voxel);
        let sensor = self.sensor / voxel;
        crossings(&sensor, &direction, ((range - truncation - 1.0).max(0.0), range + truncation + 1.0), |crossing| {
            let [b, c] = crossing.others();
            for corner in 0..4usize {
                let step = [corner & 1, corner >> 1];
                let mut at = crossing.voxel;
                at[b] += step[0] as i32;
                at[c] += step[1] as i32;
                // From the crossing to the voxel's centre.
                let off = [step[0] as f64 - crossing.beyond[0], step[1] as f64 - crossing.beyond[1]];
                let along = crossing.along + off[0] * direction[b] + off[1] * direction[c];
                let distance = (range - along) / truncation;
                let weight = (1.0 - off[0].abs()) * (1.0 - off[1].abs()) * behind(distance, 1.0 / truncation);
                if (-1.0..=1.0).contains(&distance) && weight > 0.0 {
                    self.put(Voxel { x: at[0], y: at[1], z: at[2] }, distance as f32, weight as f32, color);
                }
            }
        });
    }

    #[inline]
    fn put(&mut self, voxel: Voxel, distance: f32, weight: f32, color: [f32; 3]) {
        let (key, slot) = locate(voxel);
        let at = match self.latest[corner_of(key)] {
            Some((known, at)) if known == key => at,
            _ => match self.open(key) {
                Some(at) => at,
                None => return,
            },
        };
        let sums = &mut self.blocks[at].1.voxels[usize::from(slot)];
        let [red, green, blue] = color;
        for (sum, value) in sums.iter_mut().zip([1.0, distance, red, green, blue]) {
            *sum += weight * value;
        }
    }

    /// The place of a block's sums; none beyond the most blocks.
    fn open(&mut self, key: BlockKey) -> Option<usize> {
        let at = match self.index.get(&key) {
            Some(at) => *at,
            None if self.blocks.len() >= MAX_BLOCKS_OF_SCAN => return None,
            None => {
                self.blocks.push((key, Box::new(Sums::empty(self.is_colored))));
                self.index.insert(key, self.blocks.len() - 1);
                self.blocks.len() - 1
            }
        };
        self.latest[corner_of(key)] = Some((key, at));
        Some(at)
    }

    fn into_blocks(mut self) -> Vec<(BlockKey, Box<Sums>)> {
        self.blocks.sort_unstable_by_key(|b| b.0);
        self.blocks
    }
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
        crossings(&sensor, direction, (near, *reach), |crossing| {
            let [x, y, z] = crossing.nearest();
            window.mark(Voxel { x, y, z });
        });
    }
    window.into_blocks()
}
