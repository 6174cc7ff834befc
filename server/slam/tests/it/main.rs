//! Odometry against closed-form rooms.

#![allow(clippy::unwrap_used, clippy::panic)] // Helpers of tests, not only the tests themselves.

mod inertial;
mod lidar2d;
mod lidar3d;
mod mono;
mod rgbd;
mod room;
mod states;
mod visual;
