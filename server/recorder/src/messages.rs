//! A frame as messages, a pose as messages.

use percept_geometry::{
    CameraIntrinsics, Covariance6, DepthImage, Pose, RgbImage, SensorData, SensorFrame, SensorSpec, Timestamp,
};
use percept_ros::convert::{self, ConvertError};
use percept_ros::messages::{Header, TFMessage, TransformStamped};
use percept_ros::{EncodeError, Message};
use std::collections::BTreeMap;

/// The frame that poses are in, and the robot's own.
const MAP: &str = "map";
const BASE: &str = "base_link";
/// Where mounts are told.
const MOUNTS: &str = "/tf_static";

/// A message on its way to a file.
pub(crate) struct Encoded {
    pub(crate) topic: String,
    pub(crate) type_name: &'static str,
    /// Its type's definition, made once a file.
    pub(crate) definition: fn() -> String,
    pub(crate) bytes: Vec<u8>,
}

/// What cannot be said in messages.
#[derive(Debug, thiserror::Error)]
pub(crate) enum Unwritable {
    #[error(transparent)]
    Convert(#[from] ConvertError),
    #[error(transparent)]
    Encode(#[from] EncodeError),
}

impl Encoded {
    fn of<'a, M: Message<'a>>(topic: String, message: &M) -> Result<Self, Unwritable> {
        Ok(Self { topic, type_name: M::TYPE_NAME, definition: M::definition, bytes: message.encode()? })
    }

    /// Whether those who listen later need it, too.
    pub(crate) fn is_latched(&self) -> bool {
        self.topic == MOUNTS
    }
}

/// The messages of a frame of the sensor that ROS calls `name`, at a stamp of the session's clock.
pub(crate) fn of_frame(
    name: &str,
    spec: &SensorSpec,
    frame: &SensorFrame,
    stamp: Timestamp,
) -> Result<Vec<Encoded>, Unwritable> {
    let header = Header::new(stamp, name);
    let topic = |ending: &str| format!("/{name}/{ending}");
    let camera = spec.intrinsics.as_ref();
    match &frame.data {
        SensorData::Scan(scan) => Ok(vec![Encoded::of(topic("scan"), &convert::scan_message(scan, header))?]),
        SensorData::Cloud(cloud) => Ok(vec![Encoded::of(topic("points"), &convert::cloud_message(cloud, header)?)?]),
        SensorData::Depth(depth) => depth_image(name, depth, camera, header),
        SensorData::Rgbd(depth, color) => {
            let mut messages = depth_image(name, depth, camera, header)?;
            messages.extend(color_image(name, color, camera, header)?);
            Ok(messages)
        }
        SensorData::Camera(color) => color_image(name, color, camera, header),
        SensorData::Imu(sample) => Ok(vec![Encoded::of(topic("imu"), &convert::imu_message(sample, header))?]),
        SensorData::Odometry(sample) => {
            let odom = format!("{name}/odom");
            let message = convert::odometry_message(sample, Header::new(stamp, &odom), name);
            Ok(vec![Encoded::of(topic("odometry"), &message)?])
        }
    }
}

fn depth_image(
    name: &str,
    depth: &DepthImage,
    camera: Option<&CameraIntrinsics>,
    header: Header<'_>,
) -> Result<Vec<Encoded>, Unwritable> {
    let mut messages = calibration(format!("/{name}/depth/camera_info"), camera, header)?;
    messages.push(Encoded::of(format!("/{name}/depth/image_raw"), &convert::depth_message(depth, header)?)?);
    Ok(messages)
}

fn color_image(
    name: &str,
    color: &RgbImage,
    camera: Option<&CameraIntrinsics>,
    header: Header<'_>,
) -> Result<Vec<Encoded>, Unwritable> {
    let mut messages = calibration(format!("/{name}/color/camera_info"), camera, header)?;
    messages.push(Encoded::of(format!("/{name}/color/image_raw"), &convert::color_message(color, header)?)?);
    Ok(messages)
}

/// Calibration goes before each image, as drivers send it: so a new one counts from its first image on.
fn calibration(
    topic: String,
    camera: Option<&CameraIntrinsics>,
    header: Header<'_>,
) -> Result<Vec<Encoded>, Unwritable> {
    let message = camera.map(|camera| Encoded::of(topic, &convert::camera_info_message(camera, header)?));
    message.into_iter().collect()
}

/// Where base is in the map.
pub(crate) fn of_pose(
    stamp: Timestamp,
    t_map_base: &Pose,
    covariance: Option<&Covariance6>,
) -> Result<Vec<Encoded>, Unwritable> {
    let header = Header::new(stamp, MAP);
    let pose = convert::pose_with_covariance_message(t_map_base, covariance, header);
    let transforms = vec![transform(header, BASE, t_map_base)];
    Ok(vec![Encoded::of("/tf".to_owned(), &TFMessage { transforms })?, Encoded::of("/percept/pose".to_owned(), &pose)?])
}

/// Where each frame sits on base, all of them: who listens later gets the last message alone.
pub(crate) fn of_mounts(stamp: Timestamp, t_base_sensors: &BTreeMap<String, Pose>) -> Result<Encoded, Unwritable> {
    let header = Header::new(stamp, BASE);
    let transforms = t_base_sensors.iter().map(|(name, t_base_sensor)| transform(header, name, t_base_sensor));
    Encoded::of(MOUNTS.to_owned(), &TFMessage { transforms: transforms.collect() })
}

fn transform<'a>(header: Header<'a>, child_frame_id: &'a str, t_parent_child: &Pose) -> TransformStamped<'a> {
    TransformStamped { header, child_frame_id, transform: convert::transform_message(t_parent_child) }
}
