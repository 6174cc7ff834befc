//! What can be tuned about the voxels.

use super::block::{LogOdds, QUANTUM};
use crate::error::check;
use crate::{MappingError, OccupancyParams};
use serde::{Deserialize, Serialize};

/// Parameters of [`VoxelGrid`](super::VoxelGrid).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct VoxelParams {
    /// Whether the map has this layer: if not, it takes nothing.
    pub enabled: bool,
    /// Edge of a voxel, metres; 0.01 to 10.
    pub voxel_size_m: f64,
    /// Log-odds added to a voxel in which a beam ended; 0.05 to 6, in steps of 0.05 like all log-odds here.
    /// Default: probability 0.7 (Hornung et al., "OctoMap", 2013).
    pub hit_log_odds: f32,
    /// Log-odds added to a voxel that a beam passed; -6 to -0.05. Default: probability 0.4 (OctoMap).
    pub free_log_odds: f32,
    /// Smallest log-odds that a voxel keeps; -6 to -0.05. Default: probability 0.12 (OctoMap).
    pub min_log_odds: f32,
    /// Largest log-odds that a voxel keeps; 0.05 to 6. Default: probability 0.97 (OctoMap).
    pub max_log_odds: f32,
    /// Returns nearer than this to the sensor say nothing, metres.
    pub range_min_m: f64,
    /// Returns beyond this only free the voxels up to it, metres; at most 640 voxels. None: as far as the sensor sees, to 30 m
    /// or 640 voxels at most.
    pub range_max_m: Option<f64>,
}

impl Default for VoxelParams {
    fn default() -> Self {
        Self {
            enabled: false,
            voxel_size_m: 0.1,
            hit_log_odds: 0.85,
            free_log_odds: -0.4,
            min_log_odds: -2.0,
            max_log_odds: 3.5,
            range_min_m: 0.1,
            range_max_m: None,
        }
    }
}

impl VoxelParams {
    /// Voxels that a beam of the largest range may cross along one axis: what is told of one keyframe fits into 16 million blocks.
    pub const MAX_RANGE_VOXELS: f64 = 640.0;

    /// Returns beyond this only free the voxels up to it, metres.
    pub fn range_max(&self) -> f64 {
        self.range_max_m.unwrap_or(OccupancyParams::USUAL_RANGE_M.min(Self::MAX_RANGE_VOXELS * self.voxel_size_m))
    }

    /// Checks every field.
    ///
    /// # Errors
    /// `InvalidParam` naming field, value and remedy.
    pub fn validate(&self) -> Result<(), MappingError> {
        check("voxel_size_m", self.voxel_size_m, 0.01, 10.0, "choose 0.01 to 10")?;
        let (quantum, most) = (f64::from(QUANTUM), 6.0);
        for (field, value) in [("hit_log_odds", self.hit_log_odds), ("max_log_odds", self.max_log_odds)] {
            check(field, value.into(), quantum * 0.999, most, "choose 0.05 to 6")?;
        }
        for (field, value) in [("free_log_odds", self.free_log_odds), ("min_log_odds", self.min_log_odds)] {
            check(field, value.into(), -most, -quantum * 0.999, "choose -6 to -0.05")?;
        }
        check("range_min_m", self.range_min_m, 0.0, 1e3, "choose 0 to 1000")?;
        let range_max = self.range_max();
        if self.range_max_m.is_none() && self.range_min_m > range_max {
            return check("range_min_m", self.range_min_m, 0.0, range_max, "choose less, or a range_max_m");
        }
        check("range_max_m", range_max, self.range_min_m, 1e4, "choose range_min_m to 10000")?;
        let voxels = Self::MAX_RANGE_VOXELS * self.voxel_size_m * (1.0 + 1e-9);
        check("range_max_m", range_max, 0.0, voxels, "choose at most 640 times voxel_size_m")
    }

    /// The steps and limits as voxels keep them.
    pub(super) fn log_odds(&self) -> LogOdds {
        let kept = |v: f32| (v / QUANTUM).round() as i8;
        LogOdds {
            hit: kept(self.hit_log_odds),
            free: kept(self.free_log_odds),
            min: kept(self.min_log_odds),
            max: kept(self.max_log_odds),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_sides_of_each_limit_are_told_apart() {
        let ok = VoxelParams { enabled: true, ..Default::default() };
        assert_eq!(ok.validate(), Ok(()));
        let field = |p: VoxelParams| match p.validate() {
            Err(MappingError::InvalidParam { field, .. }) => field,
            other => panic!("{other:?}"),
        };
        assert_eq!(field(VoxelParams { voxel_size_m: f64::NAN, ..ok }), "voxel_size_m");
        assert_eq!(field(VoxelParams { voxel_size_m: 1e-9, ..ok }), "voxel_size_m");
        assert_eq!(field(VoxelParams { hit_log_odds: -0.4, ..ok }), "hit_log_odds");
        assert_eq!(field(VoxelParams { free_log_odds: 0.0, ..ok }), "free_log_odds");
        assert_eq!(field(VoxelParams { max_log_odds: 7.0, ..ok }), "max_log_odds");
        assert_eq!(VoxelParams { range_max_m: Some(64.0), ..ok }.validate(), Ok(()));
        assert_eq!(field(VoxelParams { range_max_m: Some(64.1), ..ok }), "range_max_m");
        assert_eq!(field(VoxelParams { range_min_m: 31.0, ..ok }), "range_min_m");
        assert_eq!(VoxelParams { voxel_size_m: 0.02, ..ok }.range_max(), 12.8);
    }
}
