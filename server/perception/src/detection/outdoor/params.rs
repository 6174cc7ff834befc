//! What can be tuned about detection outdoors.

use crate::cloud::{CloudError, at_least, positive};
use crate::segmentation::GroundParams;
use percept_geometry::GeometryError;
use serde::{Deserialize, Serialize};

/// Parameters of the outdoor detector.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OutdoorParams {
    /// How the ground is told; its ranges are those in which objects are looked for, too.
    pub ground: GroundParams,
    /// Points lower than this above the ground belong to it, metres: kerbs and the ground's roughness.
    pub min_height_m: f64,
    /// Points higher than this above the ground belong to no object, metres: higher than a bus.
    pub max_height_m: f64,
    /// Points are thinned to one in a voxel of this edge before they are joined, metres; up to the next dense scan.
    pub voxel_size_m: f64,
    /// Angle between neighbouring points of one ring, radians; the gap that is bridged along the ground grows with it.
    pub horizontal_step_rad: f64,
    /// Angle between neighbouring rings, radians; the gap that is bridged upward grows with it.
    pub vertical_step_rad: f64,
    /// Objects have at least so many points; at least 5.
    pub min_points: usize,
    /// Objects are at most this long, metres: a bus.
    pub max_length_m: f64,
    /// What is an object of some class with less than this probability is `Unknown`, if it stands by itself; 0 to 1.
    pub min_confidence: f64,
    /// Whether compact things that fit no class are told, as `Unknown`.
    pub tell_unknown: bool,
}

impl Default for OutdoorParams {
    fn default() -> Self {
        Self {
            ground: GroundParams::default(),
            min_height_m: 0.2,
            max_height_m: 4.0,
            voxel_size_m: 0.1,
            // 64 rings over 26.8 degrees at 10 turns a second, as data sheets of such lidars have it.
            horizontal_step_rad: 0.003,
            vertical_step_rad: 0.0073,
            min_points: 8,
            max_length_m: 14.0,
            // `objects lidar-kitti-tracking-0000 --set min_confidence=...`: from 0.4 to 0.65 recall of named things
            // falls by one of 73 and precision rises from 0.93 to 0.985; beyond, recall falls. Things were put into
            // what the model learned from, so that it takes them to be more common than they are.
            min_confidence: 0.6,
            tell_unknown: true,
        }
    }
}

impl OutdoorParams {
    /// Checks the bounds.
    ///
    /// # Errors
    /// `Input` naming the field.
    pub fn validate(&self) -> Result<(), CloudError> {
        self.ground.validate()?;
        let within = |field, value: f64, low: f64, high: f64, requirement| {
            if (low..=high).contains(&value) {
                return Ok(());
            }
            Err(GeometryError::OutOfRange { field, value, requirement })
        };
        // Ranges bound the grids that are laid out.
        within("ground.max_range_m", self.ground.max_range_m, 1.0, 500.0, "from 1 to 500")?;
        within("min_height_m", self.min_height_m, 0.0, 2.0, "from 0 to 2")?;
        positive("max_height_m", self.max_height_m)?;
        within("max_height_m", self.max_height_m, self.min_height_m, 20.0, "between min_height_m and 20")?;
        within("voxel_size_m", self.voxel_size_m, 0.02, 1.0, "from 0.02 to 1")?;
        within("horizontal_step_rad", self.horizontal_step_rad, 0.0, 0.1, "from 0 to 0.1")?;
        within("vertical_step_rad", self.vertical_step_rad, 0.0, 0.2, "from 0 to 0.2")?;
        at_least("min_points", self.min_points, 5, "at least 5")?;
        within("max_length_m", self.max_length_m, 1.0, 50.0, "from 1 to 50")?;
        within("min_confidence", self.min_confidence, 0.0, 1.0, "from 0 to 1")?;
        Ok(())
    }
}
