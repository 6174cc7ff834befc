//! Sensors on the robot: what each would measure, noise and faults included.

mod depth_camera;
mod imu;
mod lidar2d;
mod lidar3d;
mod odometry;
mod raster;

pub use depth_camera::DepthCameraParams;
pub use imu::ImuParams;
pub use lidar2d::Lidar2dParams;
pub use lidar3d::{Lidar3dParams, ScanPattern};
pub use odometry::OdometryParams;

pub(crate) use depth_camera::capture;
pub(crate) use imu::Imu;
pub(crate) use lidar2d::scan;
pub(crate) use lidar3d::sweep;
pub(crate) use odometry::Wheels;

use crate::robot::Drive;
use crate::world::World;
use crate::{SimError, check};
use nalgebra::{Translation3, UnitQuaternion, Vector3};
use percept_geometry::{Pose, SensorId, SensorKind, SensorSpec, se3};
use serde::{Deserialize, Serialize};

/// Which sensors the robot carries; none where it carries no such sensor.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SensorSuite {
    /// Depth camera, sensor `camera`.
    pub depth_camera: Option<DepthCameraParams>,
    /// 3D lidar, sensor `lidar`.
    pub lidar3d: Option<Lidar3dParams>,
    /// 2D lidar, sensor `scan`.
    pub lidar2d: Option<Lidar2dParams>,
    /// Wheel odometry, sensor `odometry`.
    pub odometry: Option<OdometryParams>,
    /// Inertial sensor, sensor `imu`.
    pub imu: Option<ImuParams>,
}

impl Default for SensorSuite {
    /// Depth camera with colour, 2D lidar and wheel odometry.
    fn default() -> Self {
        Self {
            depth_camera: Some(DepthCameraParams::default()),
            lidar2d: Some(Lidar2dParams::default()),
            odometry: Some(OdometryParams::default()),
            ..Self::none()
        }
    }
}

impl SensorSuite {
    /// No sensor at all, to add to.
    pub fn none() -> Self {
        Self { depth_camera: None, lidar3d: None, lidar2d: None, odometry: None, imu: None }
    }

    /// Every sensor with its defaults.
    pub fn all() -> Self {
        Self { lidar3d: Some(Lidar3dParams::default()), imu: Some(ImuParams::default()), ..Self::default() }
    }

    /// Only the depth camera, with its defaults.
    pub fn only_depth_camera() -> Self {
        Self { depth_camera: Some(DepthCameraParams::default()), ..Self::none() }
    }

    /// Only a camera without depth, otherwise with the depth camera's defaults.
    pub fn only_camera() -> Self {
        let camera = DepthCameraParams { depth: false, ..DepthCameraParams::default() };
        Self { depth_camera: Some(camera), ..Self::none() }
    }

    /// Only the 3D lidar, with its defaults.
    pub fn only_lidar3d() -> Self {
        Self { lidar3d: Some(Lidar3dParams::default()), ..Self::none() }
    }

    /// Only the 2D lidar, with its defaults.
    pub fn only_lidar2d() -> Self {
        Self { lidar2d: Some(Lidar2dParams::default()), ..Self::none() }
    }

    /// Checks every sensor.
    ///
    /// # Errors
    /// `OutOfRange` naming the field.
    pub fn validate(&self) -> Result<(), SimError> {
        self.depth_camera.as_ref().map_or(Ok(()), DepthCameraParams::validate)?;
        self.lidar3d.as_ref().map_or(Ok(()), Lidar3dParams::validate)?;
        self.lidar2d.as_ref().map_or(Ok(()), Lidar2dParams::validate)?;
        self.odometry.as_ref().map_or(Ok(()), OdometryParams::validate)?;
        self.imu.as_ref().map_or(Ok(()), ImuParams::validate)
    }

    /// The sensors as a session declares them, in the order in which equal stamps are sent.
    pub fn specs(&self) -> Vec<SensorSpec> {
        let spec = |id: &str, kind, t_base_sensor, intrinsics| SensorSpec {
            id: SensorId::from(id),
            kind,
            t_base_sensor,
            intrinsics,
            time_offset_s: 0.0,
            range_max_m: None,
        };
        let mut out = Vec::new();
        if self.odometry.is_some() {
            out.push(spec("odometry", SensorKind::Odometry, Pose::identity(), None));
        }
        if self.imu.is_some() {
            out.push(spec("imu", SensorKind::Imu, imu::t_base_sensor(), None));
        }
        if let Some(p) = &self.lidar2d {
            out.push(spec("scan", SensorKind::Lidar2d, p.t_base_sensor(), None));
        }
        if let Some(p) = &self.lidar3d {
            out.push(spec("lidar", SensorKind::Lidar3d, p.t_base_sensor(), None));
        }
        if let Some(p) = &self.depth_camera {
            out.push(spec("camera", p.kind(), p.t_base_sensor(), Some(p.intrinsics)));
        }
        out
    }

    /// Seconds from the first point of a message of this kind to its last.
    pub(crate) fn lasts_s(&self, kind: SensorKind) -> f64 {
        match kind {
            SensorKind::Lidar3d => self.lidar3d.as_ref().filter(|p| p.motion_distortion).map(|p| 1.0 / p.rate_hz),
            SensorKind::Lidar2d => self.lidar2d.as_ref().filter(|p| p.motion_distortion).map(Lidar2dParams::sweep_s),
            _ => None,
        }
        .unwrap_or(0.0)
    }

    /// Messages a second of the sensor of this kind; 0 if there is none.
    pub(crate) fn rate_hz(&self, kind: SensorKind) -> f64 {
        match kind {
            SensorKind::Depth | SensorKind::Rgbd | SensorKind::Camera => {
                self.depth_camera.as_ref().map_or(0.0, |p| p.rate_hz)
            }
            SensorKind::Lidar3d => self.lidar3d.as_ref().map_or(0.0, |p| p.rate_hz),
            SensorKind::Lidar2d => self.lidar2d.as_ref().map_or(0.0, |p| p.rate_hz),
            SensorKind::Odometry => self.odometry.as_ref().map_or(0.0, |p| p.rate_hz),
            SensorKind::Imu => self.imu.as_ref().map_or(0.0, |p| p.rate_hz),
        }
    }
}

/// What sensors look at: the world, the drive through it, and the seed of all noise.
pub(crate) struct Scene<'a> {
    pub(crate) world: &'a World,
    pub(crate) drive: &'a Drive,
    pub(crate) seed: u64,
}

/// A place on the robot, `forward` and `up` (m), looking down by `pitch` (rad), all of that turned by `yaw` (rad) to the left.
pub(crate) fn mount(forward: f64, up: f64, pitch: f64, yaw: f64) -> Pose {
    let ahead = Pose::from_parts(
        Translation3::new(forward, 0.0, up),
        UnitQuaternion::from_axis_angle(&Vector3::y_axis(), pitch),
    );
    se3::from_xy_yaw(0.0, 0.0, yaw) * ahead
}

/// Bounds that every sensor shares.
pub(crate) fn check_rate(rate_hz: f64) -> Result<(), SimError> {
    check("rate_hz", rate_hz, 0.1, 1000.0, "between 0.1 and 1000")
}

/// Bounds of a probability.
pub(crate) fn check_share(field: &'static str, value: f64) -> Result<(), SimError> {
    check(field, value, 0.0, 1.0, "between 0 and 1")
}
