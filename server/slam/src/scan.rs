//! What an odometry registers: one frame of one sensor with its geometry.

use percept_geometry::{CameraIntrinsics, DepthImage, LaserScan, PointCloud, Pose, RgbImage};
use std::sync::Arc;

/// A depth image, with colour if there is some.
#[derive(Debug, Clone)]
pub struct DepthScan {
    /// Depth along the optical axis, metres.
    pub depth: Arc<DepthImage>,
    /// Colour of the same size; registered to the depth or nearly so.
    pub color: Option<Arc<RgbImage>>,
    /// Of the depth image.
    pub intrinsics: CameraIntrinsics,
    /// Optical frame to base.
    pub t_base_sensor: Pose,
}

/// A 3D point cloud as it came.
#[derive(Debug, Clone)]
pub struct CloudScan {
    /// In the sensor frame, metres; `time_offsets_s` lets the odometry undo the motion during the sweep.
    pub cloud: Arc<PointCloud>,
    /// Sensor to base.
    pub t_base_sensor: Pose,
}

/// A planar scan as it came.
#[derive(Debug, Clone)]
pub struct PlanarScan {
    /// In the sensor frame.
    pub scan: Arc<LaserScan>,
    /// Sensor to base.
    pub t_base_sensor: Pose,
}

/// One frame of a sensor that sees surfaces.
#[derive(Debug, Clone)]
pub enum Scan {
    /// A depth camera's.
    Depth(DepthScan),
    /// A 3D lidar's.
    Cloud(CloudScan),
    /// A planar lidar's.
    Planar(PlanarScan),
}

impl Scan {
    /// Whether its points were taken one after the other, at known times.
    pub fn is_sweep(&self) -> bool {
        match self {
            Self::Depth(_) => false,
            Self::Cloud(s) => s.cloud.time_offsets_s.is_some(),
            Self::Planar(s) => s.scan.time_increment_s != 0.0,
        }
    }

    /// Sensor to base.
    pub fn t_base_sensor(&self) -> &Pose {
        match self {
            Self::Depth(s) => &s.t_base_sensor,
            Self::Cloud(s) => &s.t_base_sensor,
            Self::Planar(s) => &s.t_base_sensor,
        }
    }
}
