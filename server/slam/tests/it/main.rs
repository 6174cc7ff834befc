//! Odometry against closed-form rooms and recorded data.

#![allow(clippy::unwrap_used, clippy::panic)] // Helpers of tests, not only the tests themselves.

mod lidar2d;
mod lidar3d;
mod mono;
mod recorded;
mod rgbd;
mod room;
mod states;
mod visual;
