//! What a recording of ROS messages holds: one walk through it.

use crate::FormatError;
use percept_bags::Recording;
use percept_geometry::sensor::OdometrySample;
use percept_geometry::{Pose, SensorData, SensorFrame, Timestamp};
use percept_ros::cdr::Encoding;
use percept_ros::convert;
use percept_ros::messages::{
    CameraInfo, CompressedImage, Header, Image, Imu, LaserScan, Odometry, PointCloud2, TFMessage,
};
use percept_ros::topics::{Content, Topic, sensor_id};
use percept_ros::{DecodeError, FrameTree, Message};
use std::sync::Arc;

/// A topic as it was recorded.
#[derive(Debug, Clone)]
pub(super) struct Recorded {
    pub(super) topic: Topic,
    pub(super) encoding: Option<Encoding>,
    pub(super) count: usize,
    /// Of each message that can be a frame, in the order of the recording.
    pub(super) stamps: Vec<Timestamp>,
    /// Samples of wheels and inertial sensors.
    pub(super) samples: Vec<SensorFrame>,
    /// Messages that cannot be read, and why the first cannot.
    pub(super) num_unreadable: usize,
    pub(super) fault: Option<String>,
}

/// All topics, and how frames lie to each other.
#[derive(Debug, Clone)]
pub(super) struct Survey {
    pub(super) topics: Vec<Recorded>,
    pub(super) frames: FrameTree,
    /// Where the robot was in `odom`, by transforms: of a robot that publishes no odometry.
    pub(super) t_odom_base: Vec<(Timestamp, String, Pose)>,
    /// What the container had to say: what is cut, what was left out.
    pub(super) warnings: Vec<String>,
}

impl Survey {
    /// Walks through a recording.
    pub(super) fn of(recording: &Arc<Recording>) -> Result<Self, FormatError> {
        let topics = recording.topics().iter().map(|t| Recorded {
            topic: Topic::new(&t.name, &t.type_name),
            encoding: match t.encoding.as_str() {
                "cdr" => Some(Encoding::CdrLittleEndian),
                "ros1" => Some(Encoding::Ros1),
                _ => None,
            },
            count: 0,
            stamps: vec![],
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
        let Some(recorded) = self.topics.get_mut(topic) else { return };
        recorded.count += 1;
        let Some(encoding) = recorded.encoding else { return };
        if let Err(reason) = read(recorded, encoding, log_time, data, &mut self.frames, &mut self.t_odom_base) {
            recorded.num_unreadable += 1;
            recorded.fault.get_or_insert(reason);
            // So that the count of messages stays that of stamps.
            if recorded.topic.content.is_sensing() {
                recorded.stamps.push(log_time);
            }
        }
    }
}

fn read(
    recorded: &mut Recorded,
    encoding: Encoding,
    log_time: Timestamp,
    data: &[u8],
    frames: &mut FrameTree,
    t_odom_base: &mut Vec<(Timestamp, String, Pose)>,
) -> Result<(), String> {
    let words = |e: DecodeError| e.to_string();
    match recorded.topic.content.clone() {
        Content::Scan => {
            let message = LaserScan::decode_as(encoding, data).map_err(words)?;
            note(recorded, &message.header, log_time);
        }
        Content::Cloud => {
            let message = PointCloud2::decode_as(encoding, data).map_err(words)?;
            note(recorded, &message.header, log_time);
        }
        Content::Depth { compressed: false, .. } | Content::Color { compressed: false, .. } => {
            let message = Image::decode_as(encoding, data).map_err(words)?;
            recorded.topic.note_image(&message);
            note(recorded, &message.header, log_time);
        }
        Content::Depth { .. } | Content::Color { .. } => {
            let message = CompressedImage::decode_as(encoding, data).map_err(words)?;
            recorded.topic.note_compressed(&message);
            note(recorded, &message.header, log_time);
        }
        Content::Calibration { .. } => {
            let message = CameraInfo::decode_as(encoding, data).map_err(words)?;
            recorded.topic.note_calibration(&message);
        }
        Content::Imu => {
            let message = Imu::decode_as(encoding, data).map_err(words)?;
            let sample = convert::imu(&message).map_err(|e| e.to_string())?;
            keep(recorded, &message.header, log_time, SensorData::Imu(sample));
        }
        Content::Odometry => {
            let message = Odometry::decode_as(encoding, data).map_err(words)?;
            let sample = convert::odometry(&message).map_err(|e| e.to_string())?;
            message.child_frame_id.clone_into(&mut recorded.topic.child_frame_id);
            keep(recorded, &message.header, log_time, SensorData::Odometry(sample));
        }
        Content::Transforms => {
            let message = TFMessage::decode_as(encoding, data).map_err(words)?;
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

fn note(recorded: &mut Recorded, header: &Header<'_>, log_time: Timestamp) {
    recorded.topic.note(header);
    recorded.stamps.push(stamp(header, log_time));
}

fn keep(recorded: &mut Recorded, header: &Header<'_>, log_time: Timestamp, data: SensorData) {
    recorded.topic.note(header);
    let (sensor, stamp) = (recorded.topic.sensor_id(), stamp(header, log_time));
    recorded.samples.push(SensorFrame { sensor, stamp, data });
}

/// Where the robot was by transforms alone, as samples of odometry.
pub(super) fn odometry_of_transforms(survey: &Survey, base: &str) -> Vec<SensorFrame> {
    let mine = survey.t_odom_base.iter().filter(|(_, child, _)| child == base);
    let sample = |pose: &Pose| SensorData::Odometry(OdometrySample { t_odom_base: *pose, covariance: None });
    mine.map(|(stamp, _, pose)| SensorFrame { sensor: sensor_id("tf"), stamp: *stamp, data: sample(pose) }).collect()
}
