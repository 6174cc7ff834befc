//! What an odometry registers: one frame of one sensor with its geometry.

use percept_geometry::{CameraIntrinsics, DepthImage, LaserScan, PointCloud, Pose, RgbImage};
use std::sync::Arc;

/// A depth image, with colour if there is some.
#[derive(Debug, Clone)]
pub struct DepthScan {
    /// Depth along the optical axis, metres.
    pub depth: Arc<DepthImage>,
    /// Colour of the same size; if it is not registered to the depth, where it belongs is learned from the images.
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

/// An image of a camera without depth, or with depth now and then.
#[derive(Debug, Clone)]
pub struct ImageScan {
    /// As it came: distortion is undone by the intrinsics.
    pub image: Arc<RgbImage>,
    /// Depth of the same view (same size, same intrinsics), metres, when there is some: it tells the scale.
    pub depth: Option<Arc<DepthImage>>,
    /// An image of a second camera taken at the same time: its distance tells the scale, too.
    pub second: Option<SecondCamera>,
    /// Of the image, lens distortion included.
    pub intrinsics: CameraIntrinsics,
    /// Optical frame to base.
    pub t_base_sensor: Pose,
}

/// An image of a camera that is mounted beside another one.
#[derive(Debug, Clone)]
pub struct SecondCamera {
    /// As it came.
    pub image: Arc<RgbImage>,
    /// Of the image.
    pub intrinsics: CameraIntrinsics,
    /// Its optical frame to that of the first camera, metres.
    pub t_sensor_second: Pose,
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
    /// A camera's.
    Image(ImageScan),
}

impl Scan {
    /// Whether its points were taken one after the other, at known times.
    pub fn is_sweep(&self) -> bool {
        match self {
            Self::Depth(_) | Self::Image(_) => false,
            Self::Cloud(s) => s.cloud.time_offsets_s.is_some(),
            Self::Planar(s) => s.scan.time_increment_s != 0.0,
        }
    }

    /// Seconds from the stamp to the first point and to the last one.
    pub(crate) fn sweep_s(&self) -> (f64, f64) {
        let s = match self {
            Self::Cloud(s) => s,
            Self::Planar(s) => {
                let last = s.scan.ranges_m.len().saturating_sub(1) as f64 * s.scan.time_increment_s;
                return (last.min(0.0), last.max(0.0));
            }
            Self::Depth(_) | Self::Image(_) => return (0.0, 0.0),
        };
        let finite = s.cloud.time_offsets_s.iter().flatten().filter(|t| t.is_finite());
        let (first, last) = finite.fold((f32::MAX, f32::MIN), |(a, b), &t| (a.min(t), b.max(t)));
        if first <= last { (f64::from(first), f64::from(last)) } else { (0.0, 0.0) }
    }

    /// Sensor to base.
    pub fn t_base_sensor(&self) -> &Pose {
        match self {
            Self::Depth(s) => &s.t_base_sensor,
            Self::Cloud(s) => &s.t_base_sensor,
            Self::Planar(s) => &s.t_base_sensor,
            Self::Image(s) => &s.t_base_sensor,
        }
    }
}
