//! Odometry against closed-form rooms and recorded data.

mod lidar2d;
mod lidar3d;
mod recorded;
mod rgbd;
mod room;
mod states;
