//! What can be tuned about heights, and what a robot can drive over.

use crate::error::check;
use crate::ground::GroundParams;
use crate::{MappingError, OccupancyParams};
use serde::{Deserialize, Serialize};

/// Behind an edge the ground is hidden as far as this at most, metres: from 1 m up, at 3 m, a drop of 0.3 m hides 0.9 m.
const HIDDEN_M: f64 = 1.0;

/// Parameters of [`HeightGrid`](crate::HeightGrid) and of what is computed of it.
///
/// What a robot drives over is by default what an electric wheelchair for outdoors has to, one of class C of EN 12184:2014: slopes of 10
/// degrees, obstacles of 0.1 m. For a robot, its data sheet says more.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct HeightParams {
    /// Whether heights are kept. If not, the layer stays empty and costs nothing.
    pub enabled: bool,
    /// Edge of a cell, metres; 0.01 to 10.
    pub resolution_m: f64,
    /// Returns nearer than this to the sensor, horizontally, say nothing, metres.
    pub range_min_m: f64,
    /// Returns beyond this only show that nothing stands before it, metres; at most 1000 cells. None: as far as the sensor sees, to 30 m or
    /// 1000 cells at most.
    pub range_max_m: Option<f64>,
    /// The robot's height: what is lower above the ground stands in its way, what is higher hangs over it, and grounds that are so
    /// far apart belong to two storeys, metres; 0.3 to 10.
    pub clearance_m: f64,
    /// Standard deviation of a range, metres; 0.001 to 1. Default: a lidar's of 2010 to 2020 (data sheets of HDL-64E and VLP-16).
    pub range_sigma_m: f64,
    /// Standard deviation of a beam's direction, radians; 0 to 0.1. Default: half the divergence of a VLP-16's beam, 3 mrad.
    pub angle_sigma_rad: f64,
    /// Diameter of what the robot stands on, over which slope, step and roughness are told, metres; at least 3 and at most 21 cells.
    pub footprint_m: f64,
    /// Steepest slope that can be driven, radians; above 0, at most 1.5. Default: 10 degrees. Wheelchair ramps rise by 1 in 12, 0.083
    /// rad (2010 ADA Standards, 405.2).
    pub max_slope_rad: f64,
    /// Highest step that can be driven, metres; above 0, at most 10. Default: 0.1, which a kerb of 0.12 exceeds. Indoors, thresholds are
    /// 13 mm at most (2010 ADA Standards, 404.2.5).
    pub max_step_m: f64,
    /// Largest standard deviation of the ground from a plane, metres; above 0, at most 10. Default: the critical value in the
    /// configuration of Wermelinger's traversability_estimation.
    pub max_roughness_m: f64,
}

impl Default for HeightParams {
    fn default() -> Self {
        Self {
            enabled: false,
            resolution_m: 0.1,
            range_min_m: 0.1,
            range_max_m: None,
            clearance_m: 1.8,
            range_sigma_m: 0.02,
            angle_sigma_rad: 0.0015,
            footprint_m: 0.5,
            max_slope_rad: 0.175,
            max_step_m: 0.1,
            max_roughness_m: 0.05,
        }
    }
}

impl HeightParams {
    /// Returns beyond this say nothing about the ground, metres.
    pub fn range_max(&self) -> f64 {
        let cells = OccupancyParams::MAX_RANGE_CELLS * self.resolution_m;
        self.range_max_m.unwrap_or(OccupancyParams::USUAL_RANGE_M.min(cells))
    }

    /// Checks every field.
    ///
    /// # Errors
    /// `InvalidParam` naming field, value and remedy.
    pub fn validate(&self) -> Result<(), MappingError> {
        let tiny = f64::from(f32::MIN_POSITIVE);
        check("resolution_m", self.resolution_m, 0.01, 10.0, "choose 0.01 to 10")?;
        check("range_min_m", self.range_min_m, 0.0, 1e3, "choose 0 to 1000")?;
        let range_max = self.range_max();
        if self.range_max_m.is_none() && self.range_min_m > range_max {
            return check("range_min_m", self.range_min_m, 0.0, range_max, "choose less, or a range_max_m");
        }
        check("range_max_m", range_max, self.range_min_m, 1e4, "choose range_min_m to 10000")?;
        let cells = OccupancyParams::MAX_RANGE_CELLS * self.resolution_m * (1.0 + 1e-9);
        check("range_max_m", range_max, 0.0, cells, "choose at most 1000 times resolution_m")?;
        check("clearance_m", self.clearance_m, 0.3, 10.0, "choose 0.3 to 10")?;
        check("range_sigma_m", self.range_sigma_m, 0.001, 1.0, "choose 0.001 to 1")?;
        check("angle_sigma_rad", self.angle_sigma_rad, 0.0, 0.1, "choose 0 to 0.1")?;
        let footprint = (3.0 * self.resolution_m * (1.0 - 1e-9), 21.0 * self.resolution_m * (1.0 + 1e-9));
        check("footprint_m", self.footprint_m, footprint.0, footprint.1, "choose 3 to 21 times resolution_m")?;
        check("max_slope_rad", self.max_slope_rad, tiny, 1.5, "choose above 0 and at most 1.5")?;
        check("max_step_m", self.max_step_m, tiny, 10.0, "choose above 0 and at most 10")?;
        check("max_roughness_m", self.max_roughness_m, tiny, 10.0, "choose above 0 and at most 10")
    }

    /// Over how many cells ground may be hidden behind an edge.
    pub(super) fn hidden_cells(&self) -> i32 {
        (HIDDEN_M / self.resolution_m).ceil() as i32
    }

    /// How far from a cell the robot's footprint reaches, cells.
    pub(super) fn footprint_cells(&self) -> i32 {
        (0.5 * self.footprint_m / self.resolution_m + 1e-6).floor() as i32
    }

    pub(super) fn of_ground(&self) -> GroundParams {
        let (range_min_m, range_max_m) = (self.range_min_m, self.range_max());
        GroundParams { range_min_m, range_max_m, clearance_m: self.clearance_m }
    }

    /// Variance of the height of a return, so far away horizontally and so much below the sensor, square metres.
    pub(super) fn height_variance(&self, range: f64, below: f64) -> f64 {
        let sin_squared = below * below / (range * range + below * below).max(1e-12);
        let (along, across) = (self.range_sigma_m * self.range_sigma_m, self.angle_sigma_rad * range);
        along * sin_squared + across * across
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn defaults_are_valid_and_both_sides_of_limits_are_told_apart() {
        let of = |change: fn(&mut HeightParams)| {
            let mut params = HeightParams::default();
            change(&mut params);
            match params.validate() {
                Ok(()) => None,
                Err(MappingError::InvalidParam { field, .. }) => Some(field),
                Err(_) => Some("another error"),
            }
        };
        assert_eq!(of(|_| ()), None);
        assert_eq!(of(|p| p.footprint_m = 0.3), None);
        assert_eq!(of(|p| p.footprint_m = 0.29), Some("footprint_m"));
        assert_eq!(of(|p| p.range_max_m = Some(100.1)), Some("range_max_m"));
        assert_eq!(of(|p| p.range_min_m = 31.0), Some("range_min_m"));
        assert_eq!(of(|p| p.max_slope_rad = 0.0), Some("max_slope_rad"));
        assert_eq!(of(|p| p.max_step_m = f64::NAN), Some("max_step_m"));
        assert_eq!(of(|p| p.max_roughness_m = 10.1), Some("max_roughness_m"));
        assert_eq!(of(|p| p.clearance_m = 0.2), Some("clearance_m"));
        assert_eq!(of(|p| p.resolution_m = 0.001), Some("resolution_m"));
    }
}
