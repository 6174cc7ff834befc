//! Sensors' messages as readings of percept's kinds.

use crate::cdr::Encoding;
use crate::convert::{self, ConvertError};
use crate::messages::{CompressedImage, Header, Image, Imu, LaserScan, Odometry, PointCloud2};
use crate::topics::Content;
use crate::{DecodeError, Message};
use percept_geometry::{DepthImage, RgbImage, SensorData, Timestamp};

/// What a sensor's message says.
#[derive(Debug, Clone, PartialEq)]
pub struct Reading {
    /// Of the header; 0 where nobody has set it.
    pub stamp: Timestamp,
    /// In the frame of the header.
    pub data: SensorData,
}

/// Why a message is no reading.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error(transparent)]
pub enum ReadingError {
    /// Its bytes are no such message.
    Decode(#[from] DecodeError),
    /// It does not say what its type is for.
    Convert(#[from] ConvertError),
    /// Messages of this content are none of a sensor.
    #[error("{0} is no content of a sensor's messages")]
    NoSensor(&'static str),
}

/// The reading of a message; `color` is that of the colour image that depth is registered to. Images have `max_pixels` at most.
///
/// # Errors
/// [`ReadingError`].
pub fn reading(
    content: &Content,
    encoding: Encoding,
    bytes: &[u8],
    color: Option<&[u8]>,
    max_pixels: u64,
) -> Result<Reading, ReadingError> {
    let of = |header: &Header<'_>, data| Ok(Reading { stamp: header.stamp.into(), data });
    match content {
        Content::Scan => {
            let message = LaserScan::decode_as(encoding, bytes)?;
            of(&message.header, SensorData::Scan(convert::scan(&message)?))
        }
        Content::Cloud => {
            let message = PointCloud2::decode_as(encoding, bytes)?;
            of(&message.header, SensorData::Cloud(convert::cloud(&message, None)?.cloud))
        }
        Content::Depth { compressed, .. } => {
            let (stamp, depth) = depth_image(encoding, bytes, *compressed, max_pixels)?;
            let data = match color {
                Some(color) => SensorData::Rgbd(depth, color_image(encoding, color, max_pixels)?.1),
                None => SensorData::Depth(depth),
            };
            Ok(Reading { stamp, data })
        }
        Content::Color { .. } => {
            let (stamp, image) = color_image(encoding, bytes, max_pixels)?;
            Ok(Reading { stamp, data: SensorData::Camera(image) })
        }
        Content::Imu => {
            let message = Imu::decode_as(encoding, bytes)?;
            of(&message.header, SensorData::Imu(convert::imu(&message)?))
        }
        Content::Odometry => {
            let message = Odometry::decode_as(encoding, bytes)?;
            of(&message.header, SensorData::Odometry(convert::odometry(&message)?))
        }
        Content::Calibration { .. } => Err(ReadingError::NoSensor("calibration")),
        Content::Transforms => Err(ReadingError::NoSensor("transforms")),
        Content::Other => Err(ReadingError::NoSensor("another type")),
    }
}

fn depth_image(
    encoding: Encoding,
    bytes: &[u8],
    compressed: bool,
    max_pixels: u64,
) -> Result<(Timestamp, DepthImage), ReadingError> {
    if compressed {
        let message = CompressedImage::decode_as(encoding, bytes)?;
        return Ok((message.header.stamp.into(), convert::compressed_depth(&message, max_pixels)?));
    }
    let message = Image::decode_as(encoding, bytes)?;
    Ok((message.header.stamp.into(), convert::depth(&message)?))
}

fn color_image(encoding: Encoding, bytes: &[u8], max_pixels: u64) -> Result<(Timestamp, RgbImage), ReadingError> {
    // Which of the two it is, its length tells: a reader that is wrong fails at once.
    if let Ok(message) = Image::decode_as(encoding, bytes) {
        return Ok((message.header.stamp.into(), convert::color(&message)?));
    }
    let message = CompressedImage::decode_as(encoding, bytes)?;
    Ok((message.header.stamp.into(), convert::compressed_color(&message, max_pixels)?))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::Time;

    #[test]
    fn a_depth_image_has_its_colour_and_a_message_of_another_type_is_refused() {
        let header = Header::new(Time { sec: 5, nanosec: 7 }, "optical");
        let bytes = |encoding, step, data: Vec<u8>| {
            let (height, width) = (1, 2);
            Image { header, height, width, encoding, is_bigendian: 0, step, data: data.into() }.encode().unwrap()
        };
        let depth = bytes("16UC1", 4, vec![0xe8, 3, 0, 0]);
        let color = bytes("rgb8", 6, vec![1, 2, 3, 4, 5, 6]);
        let content = Content::Depth { compressed: false, size: None };
        let read = |color| reading(&content, Encoding::CdrLittleEndian, &depth, color, 100).unwrap();
        let alone = read(None);
        assert_eq!(alone.stamp, Timestamp(5_000_000_007));
        assert!(matches!(&alone.data, SensorData::Depth(d) if d.data() == [1.0, 0.0]));
        assert!(matches!(&read(Some(&color)).data, SensorData::Rgbd(_, c) if c.data() == [1, 2, 3, 4, 5, 6]));
        let scan = reading(&Content::Scan, Encoding::CdrLittleEndian, &depth, None, 100);
        assert!(matches!(scan, Err(ReadingError::Decode(_))), "{scan:?}");
        let other = reading(&Content::Other, Encoding::CdrLittleEndian, &depth, None, 100);
        assert!(matches!(other, Err(ReadingError::NoSensor(_))));
    }
}
