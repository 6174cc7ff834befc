//! Worlds, robots and noisy sensors with exact truth, for demos and every crate's tests.
//!
//! Comes in: [`SimParams`], a few numbers and a seed. Goes out: [`SimFrame`]s, sensor messages in the
//! order in which they are complete, each with the true pose; beside them the truth: objects, occupancy, distance to surfaces.
//! It knows nothing of perception, and reads no clock: the same parameters give the same bytes,
//! whatever the number of threads.
//! Start with [`Simulation`]; a world alone is [`World::generate`]. What SLAM is measured on, kidnaps and other
//! trouble included, is [`Scenario`].
//!
//! The world frame has z up and the floor at z = 0. It is not the map frame: the robot starts at
//! [`Simulation::t_world_start`], and a map that begins there differs from the world by that pose.

mod bvh;
mod disturbances;
mod rng;
mod robot;
mod scenario;
mod sensors;
mod simulation;
mod solid;
mod texture;
mod world;

pub use disturbances::{Blackout, ClockJump, Disturbances, Kidnap, Pause};
pub use robot::{HandheldParams, RobotParams, RobotPath, RobotState};
pub use scenario::{MainSensor, Scenario};
pub use sensors::{
    DepthCameraParams, ImuParams, Lidar2dParams, Lidar3dParams, OdometryParams, ScanPattern, SensorSuite,
};
pub use simulation::{Frames, SimFrame, SimParams, Simulation};
pub use world::{Door, Hit, Room, TrueObject, TrueOccupancy, World, WorldParams};

/// Why a simulation cannot be built: the facts, for the caller to put into words.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SimError {
    /// A parameter is outside its bounds.
    #[error("{field}: {value} is not {requirement}")]
    OutOfRange {
        /// Field name.
        field: &'static str,
        /// The value as given.
        value: f64,
        /// What it has to be.
        requirement: &'static str,
    },
}

/// Checks that `low <= value <= high`; NaN fails.
pub(crate) fn check(
    field: &'static str,
    value: f64,
    low: f64,
    high: f64,
    requirement: &'static str,
) -> Result<(), SimError> {
    if value >= low && value <= high { Ok(()) } else { Err(SimError::OutOfRange { field, value, requirement }) }
}
