//! What can be tuned about planning in space.

use crate::PlanError;

/// How a path in space is searched.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum FlightPlanner {
    /// A* from voxel to voxel, 26 neighbours: the shortest of such ways, as it is.
    Lattice,
    /// Lazy Theta*: legs at any angle. Never longer than [`FlightPlanner::Lattice`]'s, though not always the shortest.
    #[default]
    AnyAngle,
}

/// Parameters of [`plan_flight`](super::plan_flight).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FlightParams {
    /// The robot is a ball of this radius: no part of it touches an obstacle, metres; 0 to 100, and at most 80 voxels.
    pub robot_radius_m: f64,
    /// Voxels at or above this probability are obstacles; above 0, at most 1.
    pub occupied_probability: f64,
    /// Whether unknown voxels are free, and the ball may reach out of the box (its centre may not); if not they are
    /// obstacles, and so is all that lies outside.
    pub allow_unknown: bool,
    /// Around the start, unknown voxels are free, and a start nearer to obstacles than `robot_radius_m` (on the ground, say)
    /// may be left without going any nearer, metres; 0 to 10.
    pub start_tolerance_m: f64,
    /// The ball's centre keeps at or above this height, map frame, metres; none: the box is the limit.
    pub min_z_m: Option<f64>,
    /// The ball's centre keeps at or below this height, map frame, metres; none: the box is the limit.
    pub max_z_m: Option<f64>,
    /// Voxels that the search may expand before it gives up; at least 1.
    pub max_expansions: usize,
    /// Voxels that the box may have; at least 1. Planning takes some 20 bytes for each at most.
    pub max_voxels: usize,
}

impl Default for FlightParams {
    /// For a small quadrotor.
    fn default() -> Self {
        Self {
            robot_radius_m: 0.3,
            occupied_probability: 0.5,
            allow_unknown: false,
            start_tolerance_m: 0.5,
            min_z_m: None,
            max_z_m: None,
            max_expansions: 4_000_000,
            max_voxels: 32_000_000,
        }
    }
}

/// Voxels along the largest radius: squares of distances fit into 16 bits.
pub(super) const MOST_RADIUS: f64 = 80.0;

impl FlightParams {
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
        check("occupied_probability", self.occupied_probability, 1e-9, 1.0, "choose above 0 and at most 1")?;
        check("start_tolerance_m", self.start_tolerance_m, 0.0, 10.0, "choose 0 to 10")?;
        let (low, high) = (self.min_z_m.unwrap_or(-1e9), self.max_z_m.unwrap_or(1e9));
        check("min_z_m", low, -1e9, 1e9, "choose a finite height")?;
        check("max_z_m", high, low, 1e9, "choose a finite height of at least min_z_m")?;
        check("max_expansions", self.max_expansions as f64, 1.0, f64::MAX, "choose at least 1")?;
        check("max_voxels", self.max_voxels as f64, 1.0, 4e9, "choose 1 to 4000000000")
    }

    /// As [`FlightParams::validate`], over voxels of this edge.
    pub(super) fn validate_over(&self, voxel_size_m: f64) -> Result<(), PlanError> {
        self.validate()?;
        if self.robot_radius_m <= MOST_RADIUS * voxel_size_m {
            return Ok(());
        }
        let remedy = "choose at most 80 voxels, or larger voxels";
        Err(PlanError::InvalidParam { field: "robot_radius_m", value: self.robot_radius_m, remedy })
    }
}
