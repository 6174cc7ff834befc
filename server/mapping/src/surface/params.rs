//! What can be tuned about the surface.

use crate::error::check;
use crate::{MappingError, OccupancyParams};
use serde::{Deserialize, Serialize};

/// Where there is no `range_max_m`: the rings of a lidar of 64 are two voxels apart there, so that farther out its keyframes leave a
/// surface in stripes, and take as long again. What depth cameras keep ends there, too.
const USUAL_RANGE_VOXELS: f64 = 200.0;
/// Where there is no `truncation_m`. Behind an edge the mesh goes on as far, where nothing is: with 4, 3 and 2 voxels simulated rooms
/// (`layers rooms`) lie 1.05, 0.76 and 0.60 cm from the truth by a depth camera, 1.03, 0.87 and 0.84 by a lidar, of which 92, 91.5 and 90 %
/// of what was seen are covered.
const USUAL_TRUNCATION_VOXELS: f64 = 3.0;

/// Parameters of [`SurfaceGrid`](crate::SurfaceGrid).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SurfaceParams {
    /// Whether keyframes enter this layer; it takes no time and no memory if not.
    pub enabled: bool,
    /// Edge of a voxel, metres; 0.002 to 1. Details of less than two voxels are lost, and memory grows with its inverse square.
    pub voxel_size_m: f64,
    /// Distance from the surface up to which voxels hold it, metres; 2 to 16 voxels. What is thinner than this cannot be seen
    /// from both sides. None: 3 voxels.
    pub truncation_m: Option<f64>,
    /// Returns nearer than this to the sensor are left out, metres.
    pub range_min_m: f64,
    /// Returns beyond this only show that what lies before it is free, metres; above `range_min_m`, at most 10000 voxels. None: as far as
    /// the sensor sees, to 200 voxels at most (10 m), and to 30 m.
    pub range_max_m: Option<f64>,
    /// Looks that a voxel remembers: the weight at which its mean becomes a moving one; 1 to 255.
    pub max_weight: f32,
    /// Whether a surface goes that was seen through: three looks take the largest weight away.
    pub carve: bool,
}

impl Default for SurfaceParams {
    fn default() -> Self {
        Self {
            enabled: false,
            voxel_size_m: 0.05,
            truncation_m: None,
            range_min_m: 0.1,
            range_max_m: None,
            max_weight: 60.0,
            carve: true,
        }
    }
}

impl SurfaceParams {
    /// Distance from the surface up to which voxels hold it, metres.
    pub fn truncation(&self) -> f64 {
        self.truncation_m.unwrap_or(USUAL_TRUNCATION_VOXELS * self.voxel_size_m)
    }

    /// Returns beyond this only show that what lies before it is free, metres.
    pub fn range_max(&self) -> f64 {
        self.range_max_m.unwrap_or(OccupancyParams::USUAL_RANGE_M.min(USUAL_RANGE_VOXELS * self.voxel_size_m))
    }

    /// Checks every field.
    ///
    /// # Errors
    /// `InvalidParam` naming field, value and remedy.
    pub fn validate(&self) -> Result<(), MappingError> {
        let voxel = self.voxel_size_m;
        check("voxel_size_m", voxel, 0.002, 1.0, "choose 0.002 to 1")?;
        check("truncation_m", self.truncation(), 2.0 * voxel, 16.0 * voxel, "choose 2 to 16 voxels")?;
        check("range_min_m", self.range_min_m, 0.0, 1e3, "choose 0 to 1000")?;
        let range_max = self.range_max();
        if self.range_max_m.is_none() && self.range_min_m > range_max {
            return check("range_min_m", self.range_min_m, 0.0, range_max, "choose less, or a range_max_m");
        }
        check("range_max_m", range_max, self.range_min_m, 1e4, "choose range_min_m to 10000")?;
        check("range_max_m", range_max, 0.0, 1e4 * voxel, "choose at most 10000 voxels")?;
        check("max_weight", self.max_weight.into(), 1.0, 255.0, "choose 1 to 255")
    }

    /// How far behind a voxel at range `r` (m) a beam has to end to have seen through it, metres: the band in which the surface
    /// is held, two voxels, and a twentieth of the range, as grazing beams end far behind the floor that they nearly touch
    /// (the margin of [`CloudParams`](crate::CloudParams)).
    pub(super) fn carve_margin(&self, r: f64) -> f64 {
        self.truncation() + 2.0 * self.voxel_size_m + CARVE_MARGIN_RATIO * r
    }
}

/// Of the range, which a look through a voxel has to exceed that by.
pub(super) const CARVE_MARGIN_RATIO: f64 = 0.05;
/// Looks through a voxel that take the largest weight away.
pub(super) const LOOKS_TO_CARVE: f32 = 3.0;
