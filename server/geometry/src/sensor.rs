//! Sensors as a session declares them, and the messages that they send.

use crate::{
    CameraIntrinsics, Covariance6, DepthImage, GeometryError, LaserScan, PointCloud, Pose, RgbImage, Timestamp,
};
use nalgebra::{UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

/// Name of a sensor, unique in its session.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct SensorId(pub String);

impl From<&str> for SensorId {
    fn from(name: &str) -> Self {
        Self(name.to_owned())
    }
}

impl std::fmt::Display for SensorId {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.0)
    }
}

/// What a sensor measures.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SensorKind {
    /// Depth images.
    Depth,
    /// Depth images with colour registered to them.
    Rgbd,
    /// Colour images.
    Camera,
    /// 3D point clouds, spinning or not.
    Lidar3d,
    /// Planar scans.
    Lidar2d,
    /// Inertial measurements.
    Imu,
    /// Wheel (or other) odometry.
    Odometry,
}

impl SensorKind {
    /// Whether it sees what a pose can be found by; the others only say how the robot moved.
    pub fn can_move_the_pose(self) -> bool {
        !matches!(self, Self::Imu | Self::Odometry)
    }
}

/// A sensor of a session.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SensorSpec {
    /// Name.
    pub id: SensorId,
    /// What it measures.
    pub kind: SensorKind,
    /// Extrinsics: sensor (optical frame for cameras) to base.
    pub t_base_sensor: Pose,
    /// Intrinsics, for depth, rgbd and camera.
    pub intrinsics: Option<CameraIntrinsics>,
    /// Seconds to add to this sensor's stamps to get the session's clock.
    pub time_offset_s: f64,
    /// How far it sees, metres, if that is told.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub range_max_m: Option<f64>,
}

/// Cosine of how far a planar lidar's plane may be tilted for poses to be found in it: 37 degrees.
const STEEPEST_PLANE_COS: f64 = 0.8;

impl SensorSpec {
    /// The optical frame's rotation in a forward-looking body frame: z forward becomes x forward (REP-103).
    pub fn optical_rotation() -> UnitQuaternion<f64> {
        UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(0.5, -0.5, 0.5, -0.5))
    }

    /// Whether poses may be found by it: it sees, and a planar lidar's plane is level enough on the robot. Poses found in a plane
    /// are those of a robot that moves in it; measured in a simulated room, 30 degrees do no harm and 45 do.
    pub fn can_move_the_pose(&self) -> bool {
        let is_level = (self.t_base_sensor.rotation * Vector3::z()).z.abs() > STEEPEST_PLANE_COS;
        self.kind.can_move_the_pose() && (self.kind != SensorKind::Lidar2d || is_level)
    }

    /// Checks that what the kind needs is there and sound.
    ///
    /// # Errors
    /// `OutOfRange` for intrinsics or offsets that are not usable, `ShapeMismatch` if they are missing.
    pub fn validate(&self) -> Result<(), GeometryError> {
        match (self.kind, &self.intrinsics) {
            (SensorKind::Depth | SensorKind::Rgbd | SensorKind::Camera, None) => {
                return Err(GeometryError::ShapeMismatch { field: "intrinsics", expected: 1, actual: 0 });
            }
            (_, Some(intrinsics)) => intrinsics.validate()?,
            _ => {}
        }
        // Nothing that a robot carries is farther away.
        check(
            "t_base_sensor.translation",
            &self.t_base_sensor.translation.vector,
            1e4,
            "at most 10 km from base; send metres",
        )?;
        if !self.time_offset_s.is_finite() {
            return Err(GeometryError::OutOfRange {
                field: "time_offset_s",
                value: self.time_offset_s,
                requirement: "finite",
            });
        }
        match self.range_max_m {
            Some(value) if !(value > 0.0 && value <= 1e4) => {
                let requirement = "above 0 and at most 10000 m; send metres, or leave it out";
                Err(GeometryError::OutOfRange { field: "range_max_m", value, requirement })
            }
            _ => Ok(()),
        }
    }
}

/// Refuses what has a component beyond `most`, or not finite.
fn check(field: &'static str, v: &Vector3<f64>, most: f64, requirement: &'static str) -> Result<(), GeometryError> {
    match v.iter().find(|c| c.is_nan() || c.abs() > most) {
        Some(&value) => Err(GeometryError::OutOfRange { field, value, requirement }),
        None => Ok(()),
    }
}

/// One inertial sample in the sensor frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ImuSample {
    /// Angular velocity, rad/s.
    pub angular_velocity: Vector3<f64>,
    /// Specific force, m/s^2 (at rest it points up with 9.81).
    pub linear_acceleration: Vector3<f64>,
}

impl ImuSample {
    /// Checks that a sensor may have measured it: no gyro's range reaches 100 rad/s (ST LSM6DSV320X, the widest on sale: 70), and
    /// no accelerometer's on a robot 5,000 m/s^2 (the same: 3,138). One sample beyond turns the robot over.
    ///
    /// # Errors
    /// `OutOfRange` naming the field.
    pub fn validate(&self) -> Result<(), GeometryError> {
        check(
            "imu.angular_velocity_radps",
            &self.angular_velocity,
            100.0,
            "within 100 rad/s; send rad/s, not degrees/s",
        )?;
        check("imu.linear_acceleration_mps2", &self.linear_acceleration, 5000.0, "within 5000 m/s^2; send m/s^2")
    }
}

/// One odometry sample: the pose of base in the odometry's own drifting frame.
#[derive(Debug, Clone, PartialEq)]
pub struct OdometrySample {
    /// Base to odom.
    pub t_odom_base: Pose,
    /// Covariance of the step since the sample before, in base, if the source knows it.
    pub covariance: Option<Covariance6>,
}

impl OdometrySample {
    /// Checks that a robot may have got there: 100,000 km from where it began lies nothing.
    ///
    /// # Errors
    /// `OutOfRange` naming the field.
    pub fn validate(&self) -> Result<(), GeometryError> {
        let there = &self.t_odom_base.translation.vector;
        check("odometry.t_odom_base.translation", there, 1e8, "within 100,000 km; send metres")
    }
}

/// What a sensor sent.
#[derive(Debug, Clone, PartialEq)]
pub enum SensorData {
    /// Depth alone.
    Depth(DepthImage),
    /// Depth and the colour image registered to it (same size).
    Rgbd(DepthImage, RgbImage),
    /// Colour alone.
    Camera(RgbImage),
    /// A cloud in the sensor frame.
    Cloud(PointCloud),
    /// A planar scan in the sensor frame.
    Scan(LaserScan),
    /// Inertial sample.
    Imu(ImuSample),
    /// Odometry sample.
    Odometry(OdometrySample),
}

impl SensorData {
    /// The kind of sensor that sends this.
    pub fn kind(&self) -> SensorKind {
        match self {
            Self::Depth(_) => SensorKind::Depth,
            Self::Rgbd(..) => SensorKind::Rgbd,
            Self::Camera(_) => SensorKind::Camera,
            Self::Cloud(_) => SensorKind::Lidar3d,
            Self::Scan(_) => SensorKind::Lidar2d,
            Self::Imu(_) => SensorKind::Imu,
            Self::Odometry(_) => SensorKind::Odometry,
        }
    }
}

/// One timestamped message of a sensor.
#[derive(Debug, Clone, PartialEq)]
pub struct SensorFrame {
    /// Which sensor.
    pub sensor: SensorId,
    /// When, by the sensor's clock.
    pub stamp: Timestamp,
    /// What.
    pub data: SensorData,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_optical_axis_looks_forward_in_the_body() {
        let r = SensorSpec::optical_rotation();
        assert!((r * Vector3::z() - Vector3::x()).norm() < 1e-12);
        assert!((r * Vector3::x() + Vector3::y()).norm() < 1e-12);
        assert!((r * Vector3::y() + Vector3::z()).norm() < 1e-12);
    }
}
