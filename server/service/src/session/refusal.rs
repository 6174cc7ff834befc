//! Why a frame is refused, in the caller's words.

use crate::reason;
use crate::{Error, ErrorCode};
use percept_geometry::{SensorId, SensorKind, Timestamp};
use percept_pipeline::FrameError;

/// Reason of what is refused because the session has just been put to sleep; trying again wakes it.
pub(super) const STOPPED: &str = reason::SESSION_STOPPED;

pub(super) fn stopped() -> Error {
    Error::new(ErrorCode::Unavailable, STOPPED, "the session is stopping; try again in a moment")
}

/// The pipeline failed at a frame.
pub(super) fn failed() -> Error {
    let words = "the frame made the session fail; it goes on from what is stored, without this frame; \
                 the server's log has the cause";
    Error::new(ErrorCode::Internal, reason::PIPELINE_FAILED, words)
}

/// A frame that was processed, or a change that was made, waits for the storage.
pub(super) fn not_yet_durable(cause: &Error) -> Error {
    let words = format!(
        "it was taken in but is not durable yet: {}; it will be when that is over; send it again to learn when",
        cause.message
    );
    Error::new(ErrorCode::Unavailable, reason::NOT_YET_DURABLE, words)
}

/// Stamps may be ahead of the server's clock by as much as this: clocks of robots that nobody has set.
const MOST_AHEAD_NS: i64 = 3600 * 1_000_000_000;
/// 2026-01-01: a server whose clock is behind this has not been told the time, and judges nobody's.
const CLOCK_IS_SET_NS: i64 = 1_767_225_600 * 1_000_000_000;

/// A sensor's stamps that leap ahead of the server's clock by more than this, which they were not before, are a slip.
const MOST_LEAP_NS: i64 = 60 * 1_000_000_000;

/// How far a stamp is ahead of the server's clock, nanoseconds; negative behind it.
pub(super) fn ahead_ns(stamp: Timestamp) -> i64 {
    stamp.nanos().saturating_sub(crate::clock::now_ns())
}

/// Refuses stamps from the future: a sensor's stamps have to grow, so that one of them would end it. `before_ns`: how far its
/// last was ahead of the server's clock when it came.
pub(super) fn check_stamp(stamp: Timestamp, before_ns: Option<i64>) -> crate::Result<()> {
    let ahead_ns = ahead_ns(stamp);
    let leap_ns = before_ns.map_or(0, |before_ns| ahead_ns.saturating_sub(before_ns));
    let is_slip = ahead_ns > MOST_LEAP_NS && leap_ns > MOST_LEAP_NS;
    let is_told_the_time = crate::clock::now_ns() >= CLOCK_IS_SET_NS;
    if !is_told_the_time || (ahead_ns <= MOST_AHEAD_NS && !is_slip) {
        return Ok(());
    }
    let (sent, ahead_s, leap_s) = (stamp.nanos(), ahead_ns as f64 / 1e9, leap_ns as f64 / 1e9);
    let words = match ahead_ns <= MOST_AHEAD_NS {
        true => format!(
            "stamp_ns is {sent}, {ahead_s:.0} s ahead of the server's clock, {leap_s:.0} s more than the sensor's last was; \
             send the time of measuring; if the sensor's clock was set, declare it under another name"
        ),
        false => format!(
            "stamp_ns is {sent}, {:.1} hours ahead of the server's clock; at most one is allowed; send nanoseconds since \
             1970, and set the clocks (SyncTime measures their offset)",
            ahead_s / 3600.0
        ),
    };
    Err(Error::invalid(reason::STAMP_IMPLAUSIBLE, "stamp_ns", words))
}

pub(crate) fn sensor_not_found(id: &SensorId) -> Error {
    Error::not_found(
        reason::SENSOR_NOT_FOUND,
        "sensor_id",
        format!("sensor_id {id:?} is not declared in this session; declare it first", id = id.0),
    )
}

/// Frames that are farther back than this were not overtaken on the way, seconds: the sensor's clock was set.
const SET_BACK_S: f64 = 5.0;

fn not_increasing(stamp: Timestamp, last: Timestamp) -> Error {
    let (sent, newest, back_s) = (stamp.nanos(), last.nanos(), last.seconds_since(stamp));
    if back_s <= SET_BACK_S {
        let words =
            format!("stamp_ns is {sent}, not after the sensor's last, {newest}; send frames in order, each once");
        return Error::invalid(reason::STAMP_NOT_INCREASING, "stamp_ns", words);
    }
    let words = format!(
        "stamp_ns is {sent}, {back_s:.1} s before the sensor's last, {newest}; if that one was wrong, declare the sensor under \
         another name; if the robot's clock was set back, declare each of its sensors under another name with time_offset_s \
         {:.1}, so that the session's time goes on",
        back_s + 1.0
    );
    Error::invalid(reason::CLOCK_SET_BACK, "stamp_ns", words)
}

/// Another frame of this stamp was taken in.
pub(crate) fn stamp_repeated(stamp: Timestamp) -> Error {
    let words = format!(
        "stamp_ns is {}, which another frame of this sensor had; send the time of measuring in nanoseconds: each frame has its \
         own",
        stamp.nanos()
    );
    Error::invalid(reason::STAMP_REPEATED, "stamp_ns", words)
}

/// A kind of sensor as the contract spells it.
fn word(kind: SensorKind) -> String {
    format!("{kind:?}").to_lowercase()
}

/// The one table from the pipeline's facts to the caller's words.
pub(crate) fn frame_error(e: &FrameError) -> Error {
    match e {
        FrameError::UnknownSensor { sensor } => sensor_not_found(sensor),
        FrameError::KindMismatch { sensor, declared, sent } => Error::invalid(
            reason::SENSOR_KIND_MISMATCH,
            "data",
            format!(
                "sensor {sensor} is declared as {} but sent {}; declare it anew or send what was declared",
                word(*declared),
                word(*sent)
            ),
        ),
        FrameError::StampNotIncreasing { stamp, last, .. } => not_increasing(*stamp, *last),
        FrameError::IntrinsicsMismatch { width, height, expected_width, expected_height, .. } => Error::invalid(
            reason::INTRINSICS_MISMATCH,
            "width_px",
            format!(
                "image is {width}x{height} but the sensor's intrinsics are for {expected_width}x{expected_height}; declare intrinsics for the images you send"
            ),
        ),
        FrameError::CloudEmpty { num_points } => Error::invalid(
            reason::CLOUD_EMPTY,
            "cloud",
            format!("cloud has {num_points} points and none is finite; send at least one return"),
        ),
        FrameError::TimeOffsetTooLarge { seconds } => Error::invalid(
            reason::TIME_OFFSET_TOO_LARGE,
            "cloud.time_offsets_s",
            format!(
                "cloud.time_offsets_s has {seconds}, more than 10 s from the frame's stamp; send seconds from the stamp"
            ),
        ),
        FrameError::Implausible(e) => e.clone().into(),
        FrameError::CloudDegenerate { num_points } => Error::invalid(
            reason::CLOUD_DEGENERATE,
            "cloud",
            format!("all {num_points} finite points of the cloud are equal; check the driver"),
        ),
    }
}
