//! What can be tuned about planning.

use crate::PlanError;
use serde::{Deserialize, Serialize};

/// Parameters of [`plan`](crate::plan()).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PlanParams {
    /// The robot is a disc of this radius: no part of it touches an obstacle, metres; 0 to 100.
    pub robot_radius_m: f64,
    /// Up to this distance from obstacles a way costs extra, metres; `robot_radius_m` to 100.
    pub inflation_radius_m: f64,
    /// Cells at or above this probability are obstacles; above 0, at most 1.
    pub occupied_probability: f64,
    /// Whether unknown cells are free; if not they are obstacles, and so is all that lies outside the map.
    pub allow_unknown: bool,
    /// Extra cost of a metre that just clears the obstacles, in metres of free way; 0 to 1000.
    pub clearance_weight: f64,
    /// How fast the extra cost falls with clearance: `exp(-cost_scaling * distance)`, 1/m; 0 to 1000.
    /// As nav2's inflation layer.
    pub cost_scaling: f64,
    /// Around the start, unknown cells are free (the robot stands there, where its sensors do not look), and a start
    /// nearer to obstacles than `robot_radius_m` may be left without going any nearer, metres; 0 to 10.
    pub start_tolerance_m: f64,
    /// Cells that the search may expand before it gives up; at least 1.
    pub max_expansions: usize,
    /// Cells that the map may have; at least 1.
    pub max_cells: usize,
    /// Whether the cells' path is shortened and smoothed.
    pub smooth: bool,
    /// Distance between waypoints of a smoothed path, metres; 0.001 to 100.
    pub waypoint_spacing_m: f64,
}

impl Default for PlanParams {
    fn default() -> Self {
        Self {
            robot_radius_m: 0.22,
            inflation_radius_m: 0.5,
            occupied_probability: 0.6,
            allow_unknown: false,
            clearance_weight: 3.0,
            cost_scaling: 5.0,
            start_tolerance_m: 0.5,
            max_expansions: 4_000_000,
            max_cells: 16_000_000,
            smooth: true,
            waypoint_spacing_m: 0.2,
        }
    }
}

impl PlanParams {
    /// Checks every field.
    ///
    /// # Errors
    /// `InvalidParam` naming field, value and remedy.
    pub fn validate(&self) -> Result<(), PlanError> {
        let check = |field, value: f64, min: f64, max: f64, remedy| {
            let inside = value >= min && value <= max;
            if inside { Ok(()) } else { Err(PlanError::InvalidParam { field, value, remedy }) }
        };
        check("robot_radius_m", self.robot_radius_m, 0.0, 100.0, "choose 0 to 100")?;
        let radius = self.robot_radius_m;
        check("inflation_radius_m", self.inflation_radius_m, radius, 100.0, "choose robot_radius_m to 100")?;
        check("occupied_probability", self.occupied_probability, 1e-9, 1.0, "choose above 0 and at most 1")?;
        check("clearance_weight", self.clearance_weight, 0.0, 1e3, "choose 0 to 1000")?;
        check("cost_scaling", self.cost_scaling, 0.0, 1e3, "choose 0 to 1000")?;
        check("start_tolerance_m", self.start_tolerance_m, 0.0, 10.0, "choose 0 to 10")?;
        check("max_expansions", self.max_expansions as f64, 1.0, f64::MAX, "choose at least 1")?;
        // Cells are numbered with 32 bits.
        check("max_cells", self.max_cells as f64, 1.0, 4e9, "choose 1 to 4000000000")?;
        check("waypoint_spacing_m", self.waypoint_spacing_m, 1e-3, 100.0, "choose 0.001 to 100")
    }
}
