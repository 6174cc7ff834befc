//! What a recording of ROS messages holds: one walk through it.

use crate::FormatError;
use percept_bags::Recording;
use percept_geometry::sensor::OdometrySample;
use percept_geometry::{CameraIntrinsics, Pose, SensorData, SensorFrame, SensorId, Timestamp};
use percept_ros::cdr::Encoding;
use percept_ros::convert;
use percept_ros::messages::{
    CameraInfo, CompressedImage, Header, Image, Imu, LaserScan, Odometry, PointCloud2, TFMessage,
};
use percept_ros::{DecodeError, FrameTree, Message};
use std::sync::Arc;

/// What one topic is for.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Content {
    /// A planar lidar's.
    Scan,
    /// A lidar's, or a depth camera's if its frame is one.
    Cloud,
    /// Depth images.
    Depth { compressed: bool, size: Option<(usize, usize)> },
    /// Colour images, or grey ones.
    Color { compressed: bool, size: Option<(usize, usize)> },
    /// Calibration of the images beside it.
    Calibration { raw: Option<CameraIntrinsics>, rectified: Option<CameraIntrinsics> },
    /// Inertial samples.
    Imu,
    /// Wheels, or what a robot made of them.
    Odometry,
    /// Transforms.
    Transforms,
    /// Nothing that is used.
    Other,
}

/// A topic, and what its messages say.
#[derive(Debug, Clone)]
pub(super) struct Topic {
    pub(super) name: String,
    pub(super) type_name: String,
    pub(super) encoding: Option<Encoding>,
    pub(super) content: Content,
    pub(super) count: usize,
    /// Of each message that can be a frame, in the order of the recording.
    pub(super) stamps: Vec<Timestamp>,
    /// Of the first message.
    pub(super) frame_id: String,
    /// Of odometry: the frame that moves.
    pub(super) child_frame_id: String,
    /// Samples of wheels and inertial sensors.
    pub(super) samples: Vec<SensorFrame>,
    /// Messages that cannot be read, and why the first cannot.
    pub(super) num_unreadable: usize,
    pub(super) fault: Option<String>,
}

/// All topics, and how frames lie to each other.
#[derive(Debug, Clone)]
pub(super) struct Survey {
    pub(super) topics: Vec<Topic>,
    pub(super) frames: FrameTree,
    /// Where the robot was in `odom`, by transforms: of a robot that publishes no odometry.
    pub(super) t_odom_base: Vec<(Timestamp, String, Pose)>,
    /// What the container had to say: what is cut, what was left out.
    pub(super) warnings: Vec<String>,
}

impl Survey {
    /// Walks through a recording.
    pub(super) fn of(recording: &Arc<Recording>) -> Result<Self, FormatError> {
        let topics = recording.topics().iter().map(|t| Topic {
            name: t.name.clone(),
            type_name: t.type_name.clone(),
            encoding: match t.encoding.as_str() {
                "cdr" => Some(Encoding::CdrLittleEndian),
                "ros1" => Some(Encoding::Ros1),
                _ => None,
            },
            content: content_of(&t.type_name),
            count: 0,
            stamps: vec![],
            frame_id: String::new(),
            child_frame_id: String::new(),
            samples: vec![],
            num_unreadable: 0,
            fault: None,
        });
        let mut survey =
            Self { topics: topics.collect(), frames: FrameTree::default(), t_odom_base: vec![], warnings: vec![] };
        survey.warnings.extend(recording.warnings().iter().map(ToString::to_string));
        for message in recording.messages() {
            let message = message.map_err(FormatError::recording)?;
            survey.take(message.topic, message.log_time, &message.bytes);
        }
        Ok(survey)
    }

    fn take(&mut self, topic: usize, log_time: Timestamp, data: &[u8]) {
        let Some(topic) = self.topics.get_mut(topic) else { return };
        topic.count += 1;
        let Some(encoding) = topic.encoding else { return };
        if let Err(reason) = read(topic, encoding, log_time, data, &mut self.frames, &mut self.t_odom_base) {
            topic.num_unreadable += 1;
            topic.fault.get_or_insert(reason);
            // So that the count of messages stays that of stamps.
            if is_sensing(&topic.content) {
                topic.stamps.push(log_time);
            }
        }
    }
}

/// Whether its messages can be frames that poses are found by.
pub(super) fn is_sensing(content: &Content) -> bool {
    matches!(content, Content::Scan | Content::Cloud | Content::Depth { .. } | Content::Color { .. })
}

fn content_of(type_name: &str) -> Content {
    let name = type_name.rsplit('/').next().unwrap_or_default();
    match (type_name.split('/').next().unwrap_or_default(), name) {
        ("sensor_msgs", "LaserScan") => Content::Scan,
        ("sensor_msgs", "PointCloud2") => Content::Cloud,
        // Until the first message tells which.
        ("sensor_msgs", "Image") => Content::Color { compressed: false, size: None },
        ("sensor_msgs", "CompressedImage") => Content::Color { compressed: true, size: None },
        ("sensor_msgs", "CameraInfo") => Content::Calibration { raw: None, rectified: None },
        ("sensor_msgs", "Imu") => Content::Imu,
        ("nav_msgs", "Odometry") => Content::Odometry,
        ("tf2_msgs" | "tf", "TFMessage" | "tfMessage") => Content::Transforms,
        _ => Content::Other,
    }
}

/// A message of either generation of ROS.
pub(super) fn decode<'a, M: Message<'a>>(encoding: Encoding, data: &'a [u8]) -> Result<M, DecodeError> {
    if encoding == Encoding::Ros1 { M::decode_ros1(data) } else { M::decode(data) }
}

fn read(
    topic: &mut Topic,
    encoding: Encoding,
    log_time: Timestamp,
    data: &[u8],
    frames: &mut FrameTree,
    t_odom_base: &mut Vec<(Timestamp, String, Pose)>,
) -> Result<(), String> {
    let words = |e: DecodeError| e.to_string();
    match &mut topic.content {
        Content::Scan => {
            let message: LaserScan<'_> = decode(encoding, data).map_err(words)?;
            note(topic, &message.header, log_time);
        }
        Content::Cloud => {
            let message: PointCloud2<'_> = decode(encoding, data).map_err(words)?;
            note(topic, &message.header, log_time);
        }
        Content::Depth { compressed: false, .. } | Content::Color { compressed: false, .. } => {
            let message: Image<'_> = decode(encoding, data).map_err(words)?;
            let size = Some((message.width as usize, message.height as usize));
            let is_depth = matches!(message.encoding, "16UC1" | "32FC1" | "mono16");
            topic.content = if is_depth {
                Content::Depth { compressed: false, size }
            } else {
                Content::Color { compressed: false, size }
            };
            note(topic, &message.header, log_time);
        }
        Content::Depth { .. } | Content::Color { .. } => {
            let message: CompressedImage<'_> = decode(encoding, data).map_err(words)?;
            if message.format.contains("compressedDepth") {
                topic.content = Content::Depth { compressed: true, size: None };
            }
            note(topic, &message.header, log_time);
        }
        Content::Calibration { raw, rectified } => {
            let message: CameraInfo<'_> = decode(encoding, data).map_err(words)?;
            if raw.is_none() {
                *raw = convert::intrinsics(&message).ok();
                *rectified = convert::rectified_intrinsics(&message).ok();
                topic.frame_id = message.header.frame_id.to_owned();
            }
        }
        Content::Imu => {
            let message: Imu<'_> = decode(encoding, data).map_err(words)?;
            let sample = convert::imu(&message).map_err(|e| e.to_string())?;
            keep(topic, &message.header, log_time, SensorData::Imu(sample));
        }
        Content::Odometry => {
            let message: Odometry<'_> = decode(encoding, data).map_err(words)?;
            let sample = convert::odometry(&message).map_err(|e| e.to_string())?;
            message.child_frame_id.clone_into(&mut topic.child_frame_id);
            keep(topic, &message.header, log_time, SensorData::Odometry(sample));
        }
        Content::Transforms => {
            let message: TFMessage<'_> = decode(encoding, data).map_err(words)?;
            for t in message.transforms.iter().filter(|t| t.header.frame_id.trim_start_matches('/') == "odom") {
                if let Ok(pose) = convert::transform(&t.transform) {
                    let child = t.child_frame_id.trim_start_matches('/').to_owned();
                    t_odom_base.push((stamp(&t.header, log_time), child, pose));
                }
            }
            frames.take(&message).map_err(|e| e.to_string())?;
        }
        Content::Other => {}
    }
    Ok(())
}

/// The header's stamp, or when the message was recorded if the header has none.
fn stamp(header: &Header<'_>, log_time: Timestamp) -> Timestamp {
    let stamp = Timestamp::from(header.stamp);
    if stamp.0 == 0 { log_time } else { stamp }
}

fn note(topic: &mut Topic, header: &Header<'_>, log_time: Timestamp) {
    if topic.frame_id.is_empty() {
        header.frame_id.clone_into(&mut topic.frame_id);
    }
    topic.stamps.push(stamp(header, log_time));
}

fn keep(topic: &mut Topic, header: &Header<'_>, log_time: Timestamp, data: SensorData) {
    if topic.frame_id.is_empty() {
        header.frame_id.clone_into(&mut topic.frame_id);
    }
    topic.samples.push(SensorFrame { sensor: sensor_id(&topic.name), stamp: stamp(header, log_time), data });
}

/// A topic as the id of a sensor: `/front/scan` is `front_scan`.
pub(super) fn sensor_id(topic: &str) -> SensorId {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || c == '-';
    let name: String =
        topic.trim_start_matches('/').chars().map(|c| if is_plain(c) { c } else { '_' }).take(64).collect();
    SensorId(if name.is_empty() { "sensor".to_owned() } else { name })
}

/// Where the robot was by transforms alone, as samples of odometry.
pub(super) fn odometry_of_transforms(survey: &Survey, base: &str) -> Vec<SensorFrame> {
    let mine = survey.t_odom_base.iter().filter(|(_, child, _)| child == base);
    let sample = |pose: &Pose| SensorData::Odometry(OdometrySample { t_odom_base: *pose, covariance: None });
    mine.map(|(stamp, _, pose)| SensorFrame { sensor: sensor_id("tf"), stamp: *stamp, data: sample(pose) }).collect()
}
