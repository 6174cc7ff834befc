//! Why a frame is refused, in the caller's words.

use crate::{Error, ErrorCode};
use percept_geometry::SensorId;
use percept_pipeline::FrameError;

pub(super) fn stopped() -> Error {
    Error::new(ErrorCode::Unavailable, "SESSION_STOPPED", "the session is stopping; try again in a moment")
}

pub(super) fn sensor_not_found(id: &SensorId) -> Error {
    Error::not_found(
        "SENSOR_NOT_FOUND",
        "sensor_id",
        format!("sensor_id {id:?} is not declared in this session; declare it first", id = id.0),
    )
}

/// The one table from the pipeline's facts to the caller's words.
pub(crate) fn frame_error(e: &FrameError) -> Error {
    match e {
        FrameError::UnknownSensor { sensor } => sensor_not_found(sensor),
        FrameError::KindMismatch { sensor, declared, sent } => Error::invalid(
            "SENSOR_KIND_MISMATCH",
            "data",
            format!(
                "sensor {sensor} is declared as {declared:?} but sent {sent:?}; declare it anew or send what was declared"
            ),
        ),
        FrameError::StampNotIncreasing { stamp, last, .. } => Error::invalid(
            "STAMP_NOT_INCREASING",
            "stamp_ns",
            format!(
                "stamp_ns is {}, not after the sensor's last, {}; send frames in order, each once",
                stamp.nanos(),
                last.nanos()
            ),
        ),
        FrameError::IntrinsicsMismatch { width, height, expected_width, expected_height, .. } => Error::invalid(
            "INTRINSICS_MISMATCH",
            "width_px",
            format!(
                "image is {width}x{height} but the sensor's intrinsics are for {expected_width}x{expected_height}; declare intrinsics for the images you send"
            ),
        ),
        FrameError::CloudEmpty { num_points } => Error::invalid(
            "CLOUD_EMPTY",
            "cloud",
            format!("cloud has {num_points} points and none is finite; send at least one return"),
        ),
        FrameError::TimeOffsetTooLarge { seconds } => Error::invalid(
            "TIME_OFFSET_TOO_LARGE",
            "cloud.time_offsets_s",
            format!(
                "cloud.time_offsets_s has {seconds}, more than 10 s from the frame's stamp; send seconds from the stamp"
            ),
        ),
        FrameError::CloudDegenerate { num_points } => Error::invalid(
            "CLOUD_DEGENERATE",
            "cloud",
            format!("all {num_points} finite points of the cloud are equal; check the driver"),
        ),
    }
}
