//! Frames in, poses out: odometry for depth cameras, 3D lidars and planar lidars, and keyframes.
//!
//! Comes in: a [`Scan`] with its stamp, and what wheels and an IMU say if there are any. Goes out: the pose of base
//! in the drifting frame `odom` with its covariance, and the [`TrackingState`]. Lost is a state, not a
//! wrong pose. Then keyframes in, loops and corrected poses out ([`BackEnd`]). No map layers, no I/O, no clock live here.
//!
//! Start with [`odometry::Odometry::register`]; each sensor's method is a folder of [`odometry`].

pub mod back_end;
mod deskew;
mod downsample;
mod inertial;
pub mod keyframe;
pub mod loops;
mod matching;
mod motion_prior;
pub mod odometry;
pub mod pose_graph;
pub mod scan;
pub mod tracking;

pub use back_end::{
    BackEnd, BackEndKeyframe, BackEndMemory, BackEndParams, BackEndUpdate, Loop, LoopId, LoopState, MergedKeyframe,
};
pub use inertial::{ImuBuffer, ImuFault};
pub use keyframe::{KeyframeParams, KeyframePolicy};
pub use loops::{LoopClosure, Relocalisation};
pub use motion_prior::MotionPrior;
pub use odometry::{Growth, Odometry, OdometryEstimate, OdometryKind, OdometryNoise, OdometryParams, way_m};
pub use scan::{CloudScan, DepthScan, ImageScan, PlanarScan, Scan, SecondCamera};
pub use tracking::{LostReason, Scale, TrackingState, Waiting};

/// A parameter that cannot be used: the facts, for the caller to put into words.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{field}: {value} is not {requirement}; {remedy}")]
pub struct ParamError {
    /// Field with its path inside the crate's parameters, e.g. `rgbd.max_depth_m`.
    pub field: &'static str,
    /// The value as given.
    pub value: f64,
    /// What it has to be.
    pub requirement: &'static str,
    /// What to do instead.
    pub remedy: &'static str,
}

/// Checks `min <= value <= max`, finite.
pub(crate) fn check_range(
    field: &'static str,
    value: f64,
    (min, max): (f64, f64),
    requirement: &'static str,
    remedy: &'static str,
) -> Result<(), ParamError> {
    if value >= min && value <= max { Ok(()) } else { Err(ParamError { field, value, requirement, remedy }) }
}
