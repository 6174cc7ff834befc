//! Poses, motion, and grids.

use super::ConvertError;
use crate::Message;
use crate::messages::{self as m, Imu, OccupancyGrid, Odometry};
use nalgebra::{Point2, Vector3};
use percept_geometry::sensor::{ImuSample, OdometrySample};
use percept_geometry::{GeometryError, GridGeometry, Pose, se3};

/// A pose as a transform: of what stands there, to the frame that it stands in.
///
/// # Errors
/// `Geometry` for numbers that are not finite and quaternions that are not of unit length (all zero, too: it says no rotation).
pub fn pose(pose: &m::Pose) -> Result<Pose, ConvertError> {
    let (p, q) = (pose.position, pose.orientation);
    se3::pose_from_parts("pose", [p.x, p.y, p.z], [q.x, q.y, q.z, q.w])
        .map_err(ConvertError::geometry(m::Pose::TYPE_NAME))
}

/// A transform, `t_parent_child`.
///
/// # Errors
/// As [`pose`].
pub fn transform(transform: &m::Transform) -> Result<Pose, ConvertError> {
    let (t, q) = (transform.translation, transform.rotation);
    let made = se3::pose_from_parts("transform", [t.x, t.y, t.z], [q.x, q.y, q.z, q.w]);
    made.map_err(ConvertError::geometry(m::Transform::TYPE_NAME))
}

fn vector(v: m::Vector3) -> Vector3<f64> {
    Vector3::new(v.x, v.y, v.z)
}

/// An inertial sample; the orientation is left aside.
///
/// # Errors
/// `Missing` if one of the two rates was not measured (its covariance begins with -1), `Geometry` for values that no sensor
/// measures.
pub fn imu(message: &Imu<'_>) -> Result<ImuSample, ConvertError> {
    let absent = [
        ("angular_velocity", message.angular_velocity_covariance[0]),
        ("linear_acceleration", message.linear_acceleration_covariance[0]),
    ];
    if let Some(&(field, _)) = absent.iter().find(|(_, variance)| *variance == -1.0) {
        let remedy = "its covariance begins with -1, which says that it was not measured";
        return Err(ConvertError::Missing { message: Imu::TYPE_NAME, field, remedy });
    }
    let sample = ImuSample {
        angular_velocity: vector(message.angular_velocity),
        linear_acceleration: vector(message.linear_acceleration),
    };
    sample.validate().map_err(ConvertError::geometry(Imu::TYPE_NAME))?;
    Ok(sample)
}

/// An odometry sample. Its covariance is none: ROS has that of the pose since the beginning, not of the step.
///
/// # Errors
/// `Geometry` for a pose that is none.
pub fn odometry(message: &Odometry<'_>) -> Result<OdometrySample, ConvertError> {
    let sample = OdometrySample { t_odom_base: pose(&message.pose.pose)?, covariance: None };
    sample.validate().map_err(ConvertError::geometry(Odometry::TYPE_NAME))?;
    Ok(sample)
}

/// An occupancy grid.
#[derive(Debug, Clone, PartialEq)]
pub struct Grid {
    /// Where it lies in the header's frame.
    pub geometry: GridGeometry,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// H x W, the row of the smallest y first: 0 free to 100 occupied, -1 unknown.
    pub cells: Vec<i8>,
}

/// The grid of a message.
///
/// # Errors
/// `Invalid` for a number of cells that is not width x height, or a grid that is turned against its frame; `Geometry` for an
/// origin or a resolution that is not usable.
pub fn grid(message: &OccupancyGrid<'_>) -> Result<Grid, ConvertError> {
    const MESSAGE: &str = OccupancyGrid::TYPE_NAME;
    let info = &message.info;
    let (needed, found) = (u64::from(info.width) * u64::from(info.height), message.data.len());
    if needed != found as u64 {
        let found = format!("{found} cells for {} x {}", info.width, info.height);
        return Err(ConvertError::invalid(MESSAGE, "data", found, "width x height cells"));
    }
    let resolution = f64::from(info.resolution);
    if !(resolution.is_finite() && resolution > 0.0) {
        let (field, requirement) = ("info.resolution", "positive and finite");
        return Err(ConvertError::geometry(MESSAGE)(GeometryError::OutOfRange {
            field,
            value: resolution,
            requirement,
        }));
    }
    // map_server leaves the orientation at zero if nobody has set it.
    let q = info.origin.orientation;
    let unset = m::Quaternion { x: 0.0, y: 0.0, z: 0.0, w: 0.0 };
    let origin = m::Pose { orientation: if q == unset { m::Quaternion::default() } else { q }, ..info.origin };
    let t_frame_grid = pose(&origin)?;
    if t_frame_grid.rotation.angle() > 1e-6 {
        let found = format!("{:.6} rad of rotation", t_frame_grid.rotation.angle());
        return Err(ConvertError::invalid(MESSAGE, "info.origin.orientation", found, "a grid along its frame's axes"));
    }
    let at = t_frame_grid.translation;
    Ok(Grid {
        geometry: GridGeometry::new(resolution, Point2::new(at.x, at.y)),
        width: info.width as usize,
        height: info.height as usize,
        cells: message.data.iter().collect(),
    })
}
