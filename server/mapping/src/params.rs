//! What of the map can be tuned.

use crate::cloud::CloudParams;
use crate::height::HeightParams;
use crate::occupancy::OccupancyParams;
use crate::surface::SurfaceParams;
use crate::voxels::VoxelParams;
use serde::{Deserialize, Serialize};

/// Parameters of every layer.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MapParams {
    /// The 2D grid.
    pub occupancy: OccupancyParams,
    /// The fused cloud.
    pub cloud: CloudParams,
    /// Occupancy in three dimensions.
    pub voxels: VoxelParams,
    /// Heights of the ground, and where a robot can drive.
    pub height: HeightParams,
    /// The surface, as signed distances.
    pub surface: SurfaceParams,
    /// What was not seen again for so long leaves all layers, submap by submap, seconds; at most 1e9. 0: nothing does. Places stay known:
    /// the robot is found there as before.
    pub time_to_live_s: f64,
}

impl MapParams {
    /// How far keyframes may lie off from where their submap's layers have them before those are built anew, metres,
    /// measured where the keyframe's beams end: a quarter of a cell, which is what rounding to cells errs by on average; of a
    /// voxel of the surface where these are smaller.
    pub fn tolerance_m(&self) -> f64 {
        let cell = self.occupancy.resolution_m;
        0.25 * if self.surface.enabled { cell.min(self.surface.voxel_size_m) } else { cell }
    }
}
