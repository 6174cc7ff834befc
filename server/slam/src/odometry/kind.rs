//! Which methods of odometry there are.

use serde::{Deserialize, Serialize};

/// Which method registers the scans.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum OdometryKind {
    /// Depth images, with or without colour.
    Rgbd,
    /// 3D point clouds.
    Lidar3d,
    /// Planar scans: the robot moves in the plane z = 0 of odom.
    Lidar2d,
    /// Images of one camera: no depth, no scale unless another source gives it.
    Mono,
}
