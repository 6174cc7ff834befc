//! Inertial fusion: samples of an IMU and registered frames in, poses, velocities, biases and gravity out.
//!
//! Samples wait in an [`ImuBuffer`]. Between two frames they become one factor ([`preintegration`]); a window of frames is
//! smoothed over those factors and the frames' registrations ([`window`]); [`fusion`] begins it, predicts the next frame and
//! its sweep ([`curve`]) from it, and puts it aside where the IMU does worse than no IMU would; [`faults`] says what is wrong with one.
//! Nothing here knows what a frame is registered against.

mod buffer;
mod check;
mod curve;
mod faults;
mod fusion;
mod gravity;
mod preintegration;
mod so3;
mod window;

pub use buffer::ImuBuffer;
pub(crate) use check::GyroCheck;
pub(crate) use curve::Curve;
pub use faults::ImuFault;
pub(crate) use fusion::{Expected, Inertial, PlacedFrame};
pub(crate) use window::PoseFactor;
