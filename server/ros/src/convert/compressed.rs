//! Images as image_transport's plugins compress them.
//!
//! Source: `compressed_image_transport` and `compressed_depth_image_transport` of ros-perception/image_transport_plugins.
//! `compressedDepth` has 12 bytes in front, an i32 and the f32 A and B, little endian; 32FC1 is stored as inverse depth
//! q = A / depth + B in 16 bits, 0 for no return.

use super::{ConvertError, picture, rvl};
use crate::Message;
use crate::messages::CompressedImage;
use percept_geometry::{DepthImage, RgbImage};

const MESSAGE: &str = CompressedImage::TYPE_NAME;
const HEADER_BYTES: usize = 12;

/// The colour image of a JPEG or PNG of at most `max_pixels`; grey becomes colour, opacity is dropped.
///
/// # Errors
/// `Invalid` (neither, by its first bytes), `TooLarge`, `Picture`.
pub fn compressed_color(message: &CompressedImage<'_>, max_pixels: u64) -> Result<RgbImage, ConvertError> {
    let rgb = picture::decode(MESSAGE, &message.data, max_pixels)?.into_rgb8();
    let (width, height) = (rgb.width() as usize, rgb.height() as usize);
    RgbImage::new(width, height, rgb.into_raw()).map_err(ConvertError::geometry(MESSAGE))
}

/// The depth image of a message of at most `max_pixels`: `16UC1` or `32FC1` of `compressedDepth` as PNG or RVL, or a plain PNG
/// of 16 bits in millimetres.
///
/// # Errors
/// `Invalid` (another format, PNG of other bits, parameters that are not finite), `Truncated`, `TooLarge`, `Picture`.
pub fn compressed_depth(message: &CompressedImage<'_>, max_pixels: u64) -> Result<DepthImage, ConvertError> {
    let (encoding, plugin) = message.format.split_once(';').unwrap_or((message.format, ""));
    if !message.format.contains("compressedDepth") {
        let (width, height, units) = png16(&message.data, max_pixels)?;
        return DepthImage::from_u16(width, height, &units, 0.001).map_err(ConvertError::geometry(MESSAGE));
    }
    let Some((header, body)) = message.data.split_at_checked(HEADER_BYTES) else {
        let (needed, available) = (HEADER_BYTES as u64, message.data.len() as u64);
        return Err(ConvertError::Truncated { message: MESSAGE, needed, available });
    };
    let (width, height, units) =
        if plugin.trim().ends_with("rvl") { rvl16(body, max_pixels)? } else { png16(body, max_pixels)? };
    if !encoding.trim().starts_with("32FC1") {
        return DepthImage::from_u16(width, height, &units, 0.001).map_err(ConvertError::geometry(MESSAGE));
    }
    let parameter = |at: usize| {
        let value = header.get(at..).and_then(|b| b.first_chunk()).map_or(f32::NAN, |b| f32::from_le_bytes(*b));
        let error =
            || ConvertError::invalid(MESSAGE, format!("data, parameter at byte {at}"), value, "a finite number");
        if value.is_finite() { Ok(value) } else { Err(error()) }
    };
    let (a, b) = (parameter(4)?, parameter(8)?);
    let metres = units.iter().map(|&q| if q == 0 { 0.0 } else { a / (f32::from(q) - b) }).collect();
    DepthImage::new(width, height, metres).map_err(ConvertError::geometry(MESSAGE))
}

/// Columns, rows and numbers of an image.
type Units = (usize, usize, Vec<u16>);

fn png16(bytes: &[u8], max_pixels: u64) -> Result<Units, ConvertError> {
    let picture = picture::decode(MESSAGE, bytes, max_pixels)?;
    let (width, height) = (picture.width() as usize, picture.height() as usize);
    match picture {
        image::DynamicImage::ImageLuma16(grey) => Ok((width, height, grey.into_raw())),
        other => Err(ConvertError::invalid(MESSAGE, "data", format!("{:?}", other.color()), "a grey PNG of 16 bits")),
    }
}

fn rvl16(bytes: &[u8], max_pixels: u64) -> Result<Units, ConvertError> {
    let (sizes, rest) = bytes.as_chunks::<4>();
    let [width, height, ..] = *sizes else {
        return Err(ConvertError::Truncated { message: MESSAGE, needed: 8, available: (bytes.len()) as u64 });
    };
    let [width, height] = [width, height].map(|b| u64::from(u32::from_le_bytes(b)));
    let value = width.saturating_mul(height);
    if value > max_pixels {
        return Err(ConvertError::TooLarge { message: MESSAGE, field: "num_pixels", value, limit: max_pixels });
    }
    let body = bytes.get(8..).unwrap_or(rest);
    Ok((width as usize, height as usize, rvl::decode(MESSAGE, body, value as usize)?))
}
