//! What sensors say as messages: scans, calibration, motion. Clouds and images are in `publish.rs`.

use super::publish::{pose_message, size};
use super::{ConvertError, pose_covariance};
use crate::Message;
use crate::messages::{
    CameraInfo, Header, Imu, LaserScan, Odometry, PoseWithCovariance, PoseWithCovarianceStamped, TwistWithCovariance,
    Vector3,
};
use percept_geometry::sensor::{ImuSample, OdometrySample};
use percept_geometry::{CameraIntrinsics, Covariance6, Distortion, LaserScan as Scan, Pose};

/// The nearest that 32 bits can say and that is finite.
fn single(value: f64) -> f32 {
    value.clamp(f32::MIN.into(), f32::MAX.into()) as f32
}

/// A scan. Angles, limits and times lose what 32 bits cannot hold; echoes behind the first have no place in the message.
pub fn scan_message<'a>(scan: &Scan, header: Header<'a>) -> LaserScan<'a> {
    let last = scan.ranges_m.len().saturating_sub(1);
    LaserScan {
        header,
        angle_min: single(scan.angle_min_rad),
        angle_max: single(scan.angle(last)),
        angle_increment: single(scan.angle_increment_rad),
        time_increment: single(scan.time_increment_s),
        scan_time: 0.0,
        range_min: single(scan.range_min_m),
        range_max: single(scan.range_max_m),
        ranges: scan.ranges_m.clone(),
        intensities: scan.intensities.clone().unwrap_or_default(),
    }
}

/// Calibration of an image as it is taken. P is K: rectified, it is seen by the same pinhole.
///
/// # Errors
/// `TooLarge` beyond 32 bits.
pub fn camera_info_message<'a>(camera: &CameraIntrinsics, header: Header<'a>) -> Result<CameraInfo<'a>, ConvertError> {
    const MESSAGE: &str = CameraInfo::TYPE_NAME;
    let CameraIntrinsics { fx, fy, cx, cy, .. } = *camera;
    let (distortion_model, d) = match camera.distortion {
        Distortion::None => ("plumb_bob", vec![0.0; 5]),
        Distortion::PlumbBob(d) => ("plumb_bob", d.to_vec()),
        Distortion::Rational(d) => ("rational_polynomial", d.to_vec()),
        Distortion::Fisheye(d) => ("equidistant", d.to_vec()),
    };
    Ok(CameraInfo {
        header,
        height: size(MESSAGE, "height", camera.height)?,
        width: size(MESSAGE, "width", camera.width)?,
        distortion_model,
        d,
        k: [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
        r: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        p: [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
        ..CameraInfo::default()
    })
}

fn vector(v: &nalgebra::Vector3<f64>) -> Vector3 {
    Vector3 { x: v.x, y: v.y, z: v.z }
}

/// An inertial sample, of unknown covariance; an orientation was not measured.
pub fn imu_message<'a>(sample: &ImuSample, header: Header<'a>) -> Imu<'a> {
    let mut message = Imu {
        header,
        angular_velocity: vector(&sample.angular_velocity),
        linear_acceleration: vector(&sample.linear_acceleration),
        ..Imu::default()
    };
    message.orientation_covariance[0] = -1.0;
    message
}

/// An odometry sample: `child_frame_id` in the header's frame. Covariances are zero, unknown: a sample's is that of its last
/// step, which the message has no place for. So is the velocity.
pub fn odometry_message<'a>(sample: &OdometrySample, header: Header<'a>, child_frame_id: &'a str) -> Odometry<'a> {
    let pose = PoseWithCovariance { pose: pose_message(&sample.t_odom_base), covariance: [0.0; 36] };
    Odometry { header, child_frame_id, pose, twist: TwistWithCovariance::default() }
}

/// A pose in the header's frame and how sure it is, a perturbation in the frame that the pose is of; none: unknown, zero.
pub fn pose_with_covariance_message<'a>(
    t_a_b: &Pose,
    covariance: Option<&Covariance6>,
    header: Header<'a>,
) -> PoseWithCovarianceStamped<'a> {
    let covariance = covariance.map_or([0.0; 36], |c| pose_covariance(t_a_b, c));
    PoseWithCovarianceStamped { header, pose: PoseWithCovariance { pose: pose_message(t_a_b), covariance } }
}
