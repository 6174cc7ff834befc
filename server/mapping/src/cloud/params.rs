//! What can be tuned about the fused cloud.

use crate::error::check;
use crate::{MappingError, OccupancyParams};
use serde::{Deserialize, Serialize};

/// Parameters of [`FusedCloud`](crate::FusedCloud).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CloudParams {
    /// Edge of a voxel, metres; 0.001 to 10.
    pub voxel_size_m: f64,
    /// Returns nearer than this to the sensor are left out, metres.
    pub range_min_m: f64,
    /// Returns beyond this are left out, metres; at most 100000 voxels. None: as far as the sensor sees, to 30 m at most.
    pub range_max_m: Option<f64>,
    /// Keyframes that a voxel remembers: the weight at which its mean becomes a moving one; 1 to 10000.
    pub max_weight: f32,
    /// Weight that a voxel loses when a keyframe sees through it; 0 keeps everything for ever.
    pub carve_weight: f32,
    /// A beam sees through a voxel if it ends at least this far behind it, beside two voxels, metres.
    pub carve_margin_m: f64,
    /// The same, added for each metre of distance from the sensor: grazing beams end far behind the floor that
    /// they nearly touch.
    pub carve_margin_ratio: f64,
}

impl Default for CloudParams {
    fn default() -> Self {
        Self {
            voxel_size_m: 0.05,
            range_min_m: 0.1,
            range_max_m: None,
            max_weight: 20.0,
            carve_weight: 6.0,
            carve_margin_m: 0.15,
            carve_margin_ratio: 0.05,
        }
    }
}

impl CloudParams {
    /// Returns beyond this are left out, metres. Where it is not set, the grid's [`OccupancyParams::USUAL_RANGE_M`].
    pub fn range_max(&self) -> f64 {
        self.range_max_m.unwrap_or(OccupancyParams::USUAL_RANGE_M)
    }

    /// Checks every field.
    ///
    /// # Errors
    /// `InvalidParam` naming field, value and remedy.
    pub fn validate(&self) -> Result<(), MappingError> {
        check("voxel_size_m", self.voxel_size_m, 0.001, 10.0, "choose 0.001 to 10")?;
        check("range_min_m", self.range_min_m, 0.0, 1e3, "choose 0 to 1000")?;
        let range_max = self.range_max();
        if self.range_max_m.is_none() && self.range_min_m > range_max {
            return check("range_min_m", self.range_min_m, 0.0, range_max, "choose less, or a range_max_m");
        }
        check("range_max_m", range_max, self.range_min_m, 1e4, "choose range_min_m to 10000")?;
        check("range_max_m", range_max, 0.0, 1e5 * self.voxel_size_m, "choose at most 100000 voxels")?;
        check("max_weight", self.max_weight.into(), 1.0, 1e4, "choose 1 to 10000")?;
        check("carve_weight", self.carve_weight.into(), 0.0, 1e4, "choose 0 to 10000")?;
        check("carve_margin_m", self.carve_margin_m, 0.0, 100.0, "choose 0 to 100")?;
        check("carve_margin_ratio", self.carve_margin_ratio, 0.0, 1.0, "choose 0 to 1")
    }

    /// How far behind a voxel at range `r` (m) a beam has to end to have seen through it, metres.
    pub(super) fn margin(&self, r: f64) -> f64 {
        self.carve_margin_m + 2.0 * self.voxel_size_m + self.carve_margin_ratio * r
    }
}
