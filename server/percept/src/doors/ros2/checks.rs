//! What a message has to be, before it is a frame.

use percept_geometry::{SensorData, Timestamp};
use percept_ros::cdr::Reader;
use percept_ros::messages::{CompressedImage, Header, Image};
use percept_ros::topics::Content;
use percept_ros::{DecodeError, Message, Wire};
use percept_service::{Error, reason};
use std::sync::PoisonError;
use zenoh::bytes::ZBytes;

pub(super) fn no_message(error: DecodeError) -> Error {
    Error::invalid(reason::MESSAGE_INVALID, "", error.to_string())
}

/// The stamp of a message. A sensor stays where its first message said: what comes of another frame would be taken to be there.
pub(super) fn checked(bytes: &[u8], frame: &str) -> Result<i64, Error> {
    let header = Reader::cdr(bytes).and_then(|mut reader| Header::read(&mut reader)).map_err(no_message)?;
    if header.frame_id == frame {
        return Ok(Timestamp::from(header.stamp).0);
    }
    let words = format!("its frame was {frame:?} and is {:?} now; give each frame a topic of its own", header.frame_id);
    Err(Error::invalid(reason::MESSAGE_INVALID, "header.frame_id", words))
}

/// The stamp of an image's header, or when it was sent if that is not set.
pub(super) fn stamp_of(content: &Content, payload: &ZBytes, sent_ns: i64) -> Result<Timestamp, Error> {
    let bytes = payload.to_bytes();
    let is_compressed =
        matches!(content, Content::Depth { compressed: true, .. } | Content::Color { compressed: true, .. });
    let stamp = if is_compressed {
        CompressedImage::decode(&bytes).map_err(no_message)?.header.stamp
    } else {
        Image::decode(&bytes).map_err(no_message)?.header.stamp
    };
    let stamp = Timestamp::from(stamp);
    Ok(if stamp.0 == 0 { Timestamp(sent_ns) } else { stamp })
}

/// What holds at the other doors holds here.
pub(super) fn check_size(data: &SensorData, limits: &percept_service::Limits) -> Result<(), Error> {
    let (num, limit, code, field) = match data {
        SensorData::Cloud(cloud) => (cloud.len(), limits.max_cloud_points, reason::CLOUD_TOO_LARGE, "data"),
        SensorData::Scan(scan) => (scan.ranges_m.len(), limits.max_cloud_points, reason::SCAN_TOO_LARGE, "ranges"),
        SensorData::Depth(d) | SensorData::Rgbd(d, _) => {
            (d.data().len(), limits.max_image_pixels, reason::IMAGE_TOO_LARGE, "data")
        }
        SensorData::Camera(c) => (c.width() * c.height(), limits.max_image_pixels, reason::IMAGE_TOO_LARGE, "data"),
        SensorData::Imu(_) | SensorData::Odometry(_) => return Ok(()),
    };
    if num > limit {
        let words = format!("it has {num} points, beams or pixels, the limit is {limit}; send fewer");
        return Err(Error::exhausted(code, field, words));
    }
    if let SensorData::Rgbd(depth, color) = data
        && (depth.width(), depth.height()) != (color.width(), color.height())
    {
        let (w, h) = (color.width(), color.height());
        let words = format!("colour is {w}x{h} but depth is {}x{}", depth.width(), depth.height());
        return Err(Error::invalid(reason::COLOUR_SIZE_MISMATCH, "colour", words));
    }
    Ok(())
}

/// Another thread's panic leaves nothing half done here.
pub(super) fn lock<T>(mutex: &std::sync::Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
