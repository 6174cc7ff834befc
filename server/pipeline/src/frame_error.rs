//! Why a frame was refused; the session is as it was before.

use percept_geometry::{SensorId, SensorKind, Timestamp};

/// The facts about a frame that cannot be processed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum FrameError {
    /// The sensor was not declared.
    #[error("sensor {sensor} is not declared in this session")]
    UnknownSensor {
        /// As sent.
        sensor: SensorId,
    },
    /// The data is not of the declared kind.
    #[error("sensor {sensor} is declared as {declared:?} but sent {sent:?}")]
    KindMismatch {
        /// The sensor.
        sensor: SensorId,
        /// As declared.
        declared: SensorKind,
        /// As sent.
        sent: SensorKind,
    },
    /// The stamp is not after the sensor's last one.
    #[error("stamp {stamp} of sensor {sensor} is not after its last, {last}")]
    StampNotIncreasing {
        /// The sensor.
        sensor: SensorId,
        /// As sent.
        stamp: Timestamp,
        /// Newest accepted.
        last: Timestamp,
    },
    /// The image is not of the size that the intrinsics are for.
    #[error("image is {width}x{height} but the intrinsics of {sensor} are for {expected_width}x{expected_height}")]
    IntrinsicsMismatch {
        /// The sensor.
        sensor: SensorId,
        /// As sent.
        width: usize,
        /// As sent.
        height: usize,
        /// As declared.
        expected_width: usize,
        /// As declared.
        expected_height: usize,
    },
    /// A cloud without a single finite point.
    #[error("the cloud has no finite point among {num_points}")]
    CloudEmpty {
        /// Points sent.
        num_points: usize,
    },
    /// A cloud whose finite points are all one and the same.
    #[error("all {num_points} points of the cloud are equal")]
    CloudDegenerate {
        /// Finite points sent.
        num_points: usize,
    },
    /// A point's time lies too far from its frame's stamp.
    #[error("a point's time is {seconds} s from the frame's stamp, more than 10 s")]
    TimeOffsetTooLarge {
        /// As sent.
        seconds: f32,
    },
    /// A number that no sensor of that kind can have measured.
    #[error(transparent)]
    Implausible(percept_geometry::GeometryError),
}
