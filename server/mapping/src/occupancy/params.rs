//! What can be tuned about the occupancy grid.

use crate::MappingError;
use crate::error::check;
use serde::{Deserialize, Serialize};

/// Parameters of [`OccupancyGrid`](crate::OccupancyGrid).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OccupancyParams {
    /// Edge of a cell, metres; 0.001 to 10.
    pub resolution_m: f64,
    /// Log-odds added to a cell in which a beam ended; above 0, at most 20.
    pub hit_log_odds: f32,
    /// Log-odds added to a cell that a beam passed; below 0, at least -20.
    pub free_log_odds: f32,
    /// Smallest log-odds a cell keeps, so that it can become occupied again; -20 to below 0.
    /// Default: probability 0.12 (Hornung et al., "OctoMap", 2013).
    pub min_log_odds: f32,
    /// Largest log-odds a cell keeps, so that it can become free again; above 0, at most 20.
    /// Default: probability 0.97 (OctoMap).
    pub max_log_odds: f32,
    /// Returns nearer than this to the sensor, horizontally, say nothing, metres.
    pub range_min_m: f64,
    /// Returns beyond this only free the cells up to it, metres; at most 1000 cells.
    pub range_max_m: f64,
    /// Returns lower than this above the floor are floor: they free, and mark nothing, metres. Not for planar scans.
    pub band_min_m: f64,
    /// Returns higher than this above the floor pass over the robot: they say nothing, metres. Not for planar scans.
    pub band_max_m: f64,
}

impl Default for OccupancyParams {
    fn default() -> Self {
        Self {
            resolution_m: 0.1,
            hit_log_odds: 0.6,
            free_log_odds: -0.4,
            min_log_odds: -2.0,
            max_log_odds: 3.5,
            range_min_m: 0.1,
            range_max_m: 10.0,
            band_min_m: 0.1,
            band_max_m: 1.8,
        }
    }
}

impl OccupancyParams {
    /// Cells that a beam of the largest range may cross along one axis.
    pub const MAX_RANGE_CELLS: f64 = 1000.0;

    /// Checks every field.
    ///
    /// # Errors
    /// `InvalidParam` naming field, value and remedy.
    pub fn validate(&self) -> Result<(), MappingError> {
        let tiny = f64::from(f32::MIN_POSITIVE);
        check("resolution_m", self.resolution_m, 0.001, 10.0, "choose 0.001 to 10")?;
        check("hit_log_odds", self.hit_log_odds.into(), tiny, 20.0, "choose above 0 and at most 20")?;
        check("free_log_odds", self.free_log_odds.into(), -20.0, -tiny, "choose below 0 and at least -20")?;
        check("min_log_odds", self.min_log_odds.into(), -20.0, -tiny, "choose below 0 and at least -20")?;
        check("max_log_odds", self.max_log_odds.into(), tiny, 20.0, "choose above 0 and at most 20")?;
        check("range_min_m", self.range_min_m, 0.0, 1e3, "choose 0 to 1000")?;
        check("range_max_m", self.range_max_m, self.range_min_m, 1e4, "choose range_min_m to 10000")?;
        let cells = Self::MAX_RANGE_CELLS * self.resolution_m * (1.0 + 1e-9);
        check("range_max_m", self.range_max_m, 0.0, cells, "choose at most 1000 times resolution_m")?;
        check("band_min_m", self.band_min_m, -1e3, 1e3, "choose -1000 to 1000")?;
        check("band_max_m", self.band_max_m, self.band_min_m, 1e3, "choose band_min_m to 1000")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn defaults_are_valid_and_both_sides_of_a_limit_are_told_apart() {
        assert_eq!(OccupancyParams::default().validate(), Ok(()));
        let at_limit = OccupancyParams { range_max_m: 100.0, ..Default::default() };
        assert_eq!(at_limit.validate(), Ok(()));
        let beyond = OccupancyParams { range_max_m: 100.1, ..Default::default() };
        assert!(matches!(beyond.validate(), Err(MappingError::InvalidParam { field: "range_max_m", .. })));
        let nan = OccupancyParams { resolution_m: f64::NAN, ..Default::default() };
        assert!(matches!(nan.validate(), Err(MappingError::InvalidParam { field: "resolution_m", .. })));
        let wrong_sign = OccupancyParams { free_log_odds: 0.4, ..Default::default() };
        assert!(matches!(wrong_sign.validate(), Err(MappingError::InvalidParam { field: "free_log_odds", .. })));
    }
}
