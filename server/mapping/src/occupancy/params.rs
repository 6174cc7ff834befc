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
    /// Returns beyond this only free the cells up to it, metres; at most 1000 cells. None: as far as the sensor sees, to 30 m or
    /// 1000 cells at most.
    pub range_max_m: Option<f64>,
    /// Returns lower than this above the ground, which may rise and fall, are ground: they free, and mark nothing, metres. Not for
    /// planar scans.
    pub band_min_m: f64,
    /// Returns higher than this above the ground pass over the robot: they say nothing, metres. Not for planar scans.
    pub band_max_m: f64,
    /// The robot's body reaches at least so far around base's origin: where it drove is free, up to its sensor, whatever was seen there
    /// before, metres; 0 to 5. 0: its way says nothing. Only while base is upright: what is held in a hand is no body that drives.
    pub footprint_radius_m: f64,
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
            range_max_m: None,
            band_min_m: 0.1,
            band_max_m: 1.8,
            footprint_radius_m: 0.22,
        }
    }
}

impl OccupancyParams {
    /// Cells that a beam of the largest range may cross along one axis.
    pub const MAX_RANGE_CELLS: f64 = 1000.0;

    /// Where there is no `range_max_m`, metres. A lidar of 64 rings 1.7 m above a street has a ring of ground every 4 m there, and a
    /// planar one with a beam each half degree a return every 0.26 m.
    pub const USUAL_RANGE_M: f64 = 30.0;

    /// Returns beyond this only free the cells up to it, metres.
    pub fn range_max(&self) -> f64 {
        self.range_max_m.unwrap_or(Self::USUAL_RANGE_M.min(Self::MAX_RANGE_CELLS * self.resolution_m))
    }

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
        let range_max = self.range_max();
        if self.range_max_m.is_none() && self.range_min_m > range_max {
            return check("range_min_m", self.range_min_m, 0.0, range_max, "choose less, or a range_max_m");
        }
        check("range_max_m", range_max, self.range_min_m, 1e4, "choose range_min_m to 10000")?;
        let cells = Self::MAX_RANGE_CELLS * self.resolution_m * (1.0 + 1e-9);
        check("range_max_m", range_max, 0.0, cells, "choose at most 1000 times resolution_m")?;
        check("band_min_m", self.band_min_m, -1e3, 1e3, "choose -1000 to 1000")?;
        check("footprint_radius_m", self.footprint_radius_m, 0.0, 5.0, "choose 0 to 5")?;
        check("band_max_m", self.band_max_m, self.band_min_m, 1e3, "choose band_min_m to 1000")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn defaults_are_valid_and_both_sides_of_a_limit_are_told_apart() {
        assert_eq!(OccupancyParams::default().validate(), Ok(()));
        let at_limit = OccupancyParams { range_max_m: Some(100.0), ..Default::default() };
        assert_eq!(at_limit.validate(), Ok(()));
        let beyond = OccupancyParams { range_max_m: Some(100.1), ..Default::default() };
        assert!(matches!(beyond.validate(), Err(MappingError::InvalidParam { field: "range_max_m", .. })));
        let fine = OccupancyParams { resolution_m: 0.01, ..Default::default() };
        assert_eq!((fine.validate(), fine.range_max()), (Ok(()), 10.0));
        let far = OccupancyParams { range_min_m: 40.0, ..Default::default() };
        assert!(matches!(far.validate(), Err(MappingError::InvalidParam { field: "range_min_m", .. })));
        let nan = OccupancyParams { resolution_m: f64::NAN, ..Default::default() };
        assert!(matches!(nan.validate(), Err(MappingError::InvalidParam { field: "resolution_m", .. })));
        let huge = OccupancyParams { footprint_radius_m: 5.1, ..Default::default() };
        assert!(matches!(huge.validate(), Err(MappingError::InvalidParam { field: "footprint_radius_m", .. })));
        let wrong_sign = OccupancyParams { free_log_odds: 0.4, ..Default::default() };
        assert!(matches!(wrong_sign.validate(), Err(MappingError::InvalidParam { field: "free_log_odds", .. })));
    }
}
