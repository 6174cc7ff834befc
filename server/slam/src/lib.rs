//! Frames in, poses out: odometry for depth cameras, 3D lidars and planar lidars, and keyframes.
//!
//! Comes in: a [`Scan`] with its stamp, and what wheels and an IMU say if there are any. Goes out: the pose of base
//! in the drifting frame `odom` with its covariance, and the [`TrackingState`]. Lost is a state, not a
//! wrong pose. Then keyframes in, loops and corrected poses out ([`BackEnd`]). No map layers, no I/O, no clock live here.
//!
//! Start with [`odometry::Odometry::register`]; each sensor's method is a folder of [`odometry`].

pub mod back_end;
mod color_camera;
mod covariance;
mod deskew;
mod downsample;
mod inertial;
pub mod keyframe;
pub mod loops;
mod matching;
pub mod motion_noise;
mod motion_prior;
pub mod odometry;
mod param_error;
pub mod pose_graph;
pub mod scan;
pub mod tracking;

pub use back_end::{
    BackEnd, BackEndKeyframe, BackEndMemory, BackEndParams, BackEndUpdate, Loop, LoopId, LoopState, MergedKeyframe,
};
pub use inertial::{ImuBuffer, ImuFault};
pub use keyframe::{KeyframeParams, KeyframePolicy};
pub use loops::{Evidence, LoopClosure, Relocalisation};
pub use motion_prior::MotionPrior;
pub use odometry::{Growth, Odometry, OdometryEstimate, OdometryKind, OdometryNoise, OdometryParams, ToldPlace, way_m};
pub use param_error::ParamError;
pub use scan::{CloudScan, DepthScan, ImageScan, PlanarScan, Scan, SecondCamera};
pub use tracking::{LostReason, Scale, TrackingState, Waiting};
