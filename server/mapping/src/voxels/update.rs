//! One keyframe as the voxels that its beams passed, and those in which they ended.

use super::VoxelParams;
use super::block::Bits;
use super::rays::Rays;
use crate::KeyframeView;
use crate::blocks::BlockKey;
use nalgebra::Point3;
use percept_geometry::Voxel;

/// What one keyframe says about voxels: each is passed or hit once, however many beams did. Depends on the pose and the scan alone.
#[derive(Debug, Clone, Default)]
pub struct VoxelUpdate {
    /// Passed and hit, ascending by block; what was hit was not passed.
    pub(super) blocks: Vec<(BlockKey, Bits, Bits)>,
}

impl VoxelUpdate {
    /// The beams of a keyframe. Returns beyond the range free the voxels up to it. Those that are nearer than the
    /// range begins, or not finite, are left out; so is everything if the sensor stands where no voxel has a number.
    ///
    /// Source: each voxel that a beam passes, as in Amanatides and Woo, "A fast voxel traversal algorithm", 1987; hits before
    /// passes, and each voxel once a scan, as in Hornung et al., "OctoMap", 2013.
    pub fn new(params: &VoxelParams, view: &KeyframeView<'_>) -> Self {
        if !params.enabled {
            return Self::default();
        }
        let size = params.voxel_size_m;
        let sensor = view.sensor();
        let (range_min, range_max) = (params.range_min_m, params.range_max());
        let mut hits: Vec<Voxel> = Vec::with_capacity(view.hits().len());
        let mut ends: Vec<Point3<f64>> = Vec::with_capacity(view.hits().len() + view.misses().len());
        for p in view.hits() {
            let range = (p - sensor).norm();
            if range >= range_min && range <= range_max {
                if let Some(voxel) = Voxel::containing(p, size) {
                    hits.push(voxel);
                    ends.push(*p);
                }
            } else if range.is_finite() && range > range_max {
                ends.push(sensor + (p - sensor) * (range_max / range));
            }
        }
        for p in view.misses() {
            let range = (p - sensor).norm();
            if range.is_finite() && range > 0.0 {
                ends.push(sensor + (p - sensor) * (range_max / range).min(1.0));
            }
        }
        let Some(mut rays) = Rays::new(sensor / size, ends.iter().map(|p| p / size)) else { return Self::default() };
        for end in &ends {
            rays.pass(&(end / size));
        }
        hits.into_iter().for_each(|voxel| rays.hit(voxel));
        Self { blocks: rays.blocks() }
    }
}
