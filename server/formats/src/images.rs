//! PNG and JPEG, with sizes compared with the limits before pixels are allocated.

use crate::{FormatError, Limits, Place, pgm};
use image::codecs::jpeg::{JpegDecoder, JpegEncoder};
use image::codecs::png::{CompressionType, FilterType, PngDecoder, PngEncoder};
use image::{ColorType, ExtendedColorType, ImageDecoder, ImageEncoder};
use percept_geometry::{DepthImage, GrayImage, RgbImage};
use std::io::Cursor;

/// What a decoder may take for itself beside the pixels.
const DECODER_BYTES: u64 = 16 << 20;

/// A grey image of 8 or 16 bits.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Gray16 {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Bits of a sample in the file: 8 or 16 (fewer are spread to 8).
    pub bits: u8,
    /// `H x W` samples as stored, row-major.
    pub data: Vec<u16>,
}

/// A PNG as shades of its channels.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Shades {
    pub(crate) width: usize,
    pub(crate) height: usize,
    /// The largest value of a sample.
    pub(crate) white: u16,
    /// Samples of a pixel.
    pub(crate) channels: usize,
    /// Whether the last channel is opacity.
    pub(crate) has_alpha: bool,
    /// `H x W x channels` samples, row-major.
    pub(crate) data: Vec<u16>,
}

fn image_error(format: &'static str) -> impl Fn(image::ImageError) -> FormatError {
    move |error| FormatError::Image { format, reason: error.to_string() }
}

fn image_limits(limits: &Limits) -> image::Limits {
    let mut out = image::Limits::default();
    out.max_alloc = Some(limits.max_pixels.saturating_mul(8).saturating_add(DECODER_BYTES).min(limits.max_bytes));
    out
}

type Png<'a> = PngDecoder<Cursor<&'a [u8]>>;

/// A decoder that has read the header and nothing else, and the size that it declares.
fn open_png<'a>(bytes: &'a [u8], limits: &Limits) -> Result<(Png<'a>, usize, usize), FormatError> {
    let (width, height) = png_size(bytes)?;
    limits.pixels(width as u64, height as u64)?;
    let decoder = PngDecoder::with_limits(Cursor::new(bytes), image_limits(limits)).map_err(image_error("PNG"))?;
    Ok((decoder, width, height))
}

/// Columns and rows that a PNG declares, from its first 24 bytes.
///
/// # Errors
/// `Truncated` or `Malformed` if it does not begin as a PNG does.
pub fn png_size(bytes: &[u8]) -> Result<(usize, usize), FormatError> {
    const FORMAT: &str = "PNG";
    let Some(header) = bytes.get(..24) else {
        let available = bytes.len() as u64;
        return Err(FormatError::Truncated { format: FORMAT, field: "header", needed: 24, available });
    };
    if header[..8] != *b"\x89PNG\r\n\x1a\n" || header[12..16] != *b"IHDR" {
        let expected = "a PNG signature and IHDR";
        return Err(FormatError::malformed(FORMAT, Place::Byte(0), "signature", &header[..16], expected));
    }
    let number = |at: usize| u32::from_be_bytes([header[at], header[at + 1], header[at + 2], header[at + 3]]) as usize;
    Ok((number(16), number(20)))
}

fn pixels(decoder: impl ImageDecoder, format: &'static str, limits: &Limits) -> Result<Vec<u8>, FormatError> {
    let mut out = vec![0; limits.bytes(decoder.total_bytes())?];
    decoder.read_image(&mut out).map_err(image_error(format))?;
    Ok(out)
}

/// A grey PNG of up to 16 bits; other colour types are not taken for grey.
///
/// # Errors
/// `Truncated`, `Malformed`, `TooLarge`, `Unsupported`, `Image`.
pub fn decode_gray16(bytes: &[u8], limits: &Limits) -> Result<Gray16, FormatError> {
    let (decoder, width, height) = open_png(bytes, limits)?;
    match decoder.color_type() {
        ColorType::L8 => {
            let data = pixels(decoder, "PNG", limits)?.into_iter().map(u16::from).collect();
            Ok(Gray16 { width, height, bits: 8, data })
        }
        ColorType::L16 => {
            let bytes = pixels(decoder, "PNG", limits)?;
            let data = bytes.as_chunks::<2>().0.iter().map(|&b| u16::from_ne_bytes(b)).collect();
            Ok(Gray16 { width, height, bits: 16, data })
        }
        other => Err(FormatError::Unsupported {
            format: "PNG",
            field: "colour type",
            value: format!("{other:?}"),
            supported: "grey of 8 or 16 bits",
        }),
    }
}

/// A PNG of any colour type, grey or not, with all of its channels.
pub(crate) fn decode_png_shades(bytes: &[u8], limits: &Limits) -> Result<Shades, FormatError> {
    let (decoder, width, height) = open_png(bytes, limits)?;
    let color_type = decoder.color_type();
    let (channels, has_alpha) = (usize::from(color_type.channel_count()), color_type.has_alpha());
    let has_two_bytes = usize::from(color_type.bytes_per_pixel()) == 2 * channels;
    let samples = pixels(decoder, "PNG", limits)?;
    let (white, data) = if has_two_bytes {
        (u16::MAX, samples.as_chunks::<2>().0.iter().map(|&b| u16::from_ne_bytes(b)).collect())
    } else {
        (255, samples.into_iter().map(u16::from).collect())
    };
    Ok(Shades { width, height, white, channels, has_alpha, data })
}

/// A depth image from a 16-bit grey PNG; 0 and 65535 are 'no return'.
///
/// `metres_per_unit` is 0.001 for millimetres, 0.0002 for TUM RGB-D.
///
/// # Errors
/// Those of [`decode_gray16`]; `Unsupported` for 8 bits; `Geometry` for an unusable unit.
pub fn decode_depth_png(bytes: &[u8], metres_per_unit: f64, limits: &Limits) -> Result<DepthImage, FormatError> {
    let gray = decode_gray16(bytes, limits)?;
    if gray.bits != 16 {
        let value = format!("grey of {} bits", gray.bits);
        return Err(FormatError::Unsupported {
            format: "PNG",
            field: "colour type",
            value,
            supported: "16 bits for depth",
        });
    }
    Ok(DepthImage::from_u16(gray.width, gray.height, &gray.data, metres_per_unit)?)
}

/// A depth image from a 16-bit grey PNG or PGM, told apart by their first bytes; 0 and 65535 are 'no return'.
///
/// # Errors
/// Those of [`decode_depth_png`], and of [`pgm::decode`].
pub fn decode_depth(bytes: &[u8], metres_per_unit: f64, limits: &Limits) -> Result<DepthImage, FormatError> {
    if !bytes.starts_with(b"P") {
        return decode_depth_png(bytes, metres_per_unit, limits);
    }
    let image = pgm::decode(bytes, limits)?;
    if image.max_value <= 255 {
        let value = format!("{} (8 bits)", image.max_value);
        return Err(FormatError::Unsupported { format: "PGM", field: "maxval", value, supported: "16 bits for depth" });
    }
    Ok(DepthImage::from_u16(image.width, image.height, &image.data, metres_per_unit)?)
}

/// Columns and rows that a PNG or PGM declares.
pub(crate) fn declared_size(bytes: &[u8]) -> Result<(usize, usize), FormatError> {
    if bytes.starts_with(b"P") { pgm::size(bytes) } else { png_size(bytes) }
}

/// A colour image from a PNG or JPEG, told apart by their first bytes; grey becomes colour, alpha is dropped.
///
/// # Errors
/// `Truncated`, `Malformed`, `TooLarge`, `Unsupported`, `Image`.
pub fn decode_color(bytes: &[u8], limits: &Limits) -> Result<RgbImage, FormatError> {
    match bytes {
        [0x89, b'P', ..] => {
            let (decoder, width, height) = open_png(bytes, limits)?;
            to_rgb(decoder, "PNG", width, height, limits)
        }
        [0xff, 0xd8, ..] => decode_jpeg(bytes, limits),
        _ => Err(FormatError::malformed(
            "image",
            Place::Byte(0),
            "signature",
            &bytes[..bytes.len().min(4)],
            "PNG or JPEG",
        )),
    }
}

fn decode_jpeg(bytes: &[u8], limits: &Limits) -> Result<RgbImage, FormatError> {
    if !has_end_of_image(bytes) {
        let (needed, available) = (bytes.len() as u64 + 2, bytes.len() as u64);
        return Err(FormatError::Truncated { format: "JPEG", field: "image data", needed, available });
    }
    let mut decoder = JpegDecoder::new(Cursor::new(bytes)).map_err(image_error("JPEG"))?;
    let (width, height) = decoder.dimensions();
    limits.pixels(u64::from(width), u64::from(height))?;
    decoder.set_limits(image_limits(limits)).map_err(image_error("JPEG"))?;
    to_rgb(decoder, "JPEG", width as usize, height as usize, limits)
}

/// Whether an end-of-image marker follows the start of the scan: decoders fill up a cut image with grey
/// and say nothing. Thumbnails, which have ends of their own, lie in segments before the scan.
fn has_end_of_image(bytes: &[u8]) -> bool {
    let mut at = 2;
    while let Some(&[0xff, marker, high, low]) = bytes.get(at..at + 4) {
        at += 2 + usize::from(u16::from_be_bytes([high, low]));
        if marker == 0xda {
            return bytes.get(at..).is_some_and(|scan| scan.windows(2).any(|w| w == [0xff, 0xd9]));
        }
    }
    false
}

fn to_rgb(
    decoder: impl ImageDecoder,
    format: &'static str,
    width: usize,
    height: usize,
    limits: &Limits,
) -> Result<RgbImage, FormatError> {
    let color_type = decoder.color_type();
    let data = pixels(decoder, format, limits)?;
    let high = |b: &[u8]| (u16::from_ne_bytes([b[0], b[1]]) >> 8) as u8;
    let rgb = match color_type {
        ColorType::Rgb8 => data,
        ColorType::Rgba8 => data.as_chunks::<4>().0.iter().flat_map(|c| [c[0], c[1], c[2]]).collect(),
        ColorType::L8 => data.iter().flat_map(|&v| [v; 3]).collect(),
        ColorType::La8 => data.as_chunks::<2>().0.iter().flat_map(|c| [c[0]; 3]).collect(),
        ColorType::L16 => data.as_chunks::<2>().0.iter().flat_map(|c| [high(c); 3]).collect(),
        ColorType::La16 => data.as_chunks::<4>().0.iter().flat_map(|c| [high(c); 3]).collect(),
        ColorType::Rgb16 => data.as_chunks::<2>().0.iter().map(|c| high(c)).collect(),
        ColorType::Rgba16 => {
            data.as_chunks::<8>().0.iter().flat_map(|c| [high(&c[..2]), high(&c[2..4]), high(&c[4..6])]).collect()
        }
        other => {
            let value = format!("{other:?}");
            return Err(FormatError::Unsupported {
                format,
                field: "colour type",
                value,
                supported: "grey or RGB of 8 or 16 bits",
            });
        }
    };
    Ok(RgbImage::new(width, height, rgb)?)
}

fn encode_png(
    width: usize,
    height: usize,
    color_type: ExtendedColorType,
    bytes: &[u8],
) -> Result<Vec<u8>, FormatError> {
    let (width, height) = image_size(width, height)?;
    let mut out = vec![];
    PngEncoder::new_with_quality(&mut out, CompressionType::Fast, FilterType::Adaptive)
        .write_image(bytes, width, height, color_type)
        .map_err(image_error("PNG"))?;
    Ok(out)
}

fn image_size(width: usize, height: usize) -> Result<(u32, u32), FormatError> {
    match (u32::try_from(width), u32::try_from(height)) {
        (Ok(width), Ok(height)) => Ok((width, height)),
        _ => {
            let value = width.max(height) as u64;
            Err(FormatError::TooLarge { field: "image side", value, limit: u64::from(u32::MAX) })
        }
    }
}

/// An RGB8 PNG.
///
/// # Errors
/// `Image` if the image has no pixels.
pub fn encode_rgb_png(image: &RgbImage) -> Result<Vec<u8>, FormatError> {
    encode_png(image.width(), image.height(), ExtendedColorType::Rgb8, image.data())
}

/// An 8-bit grey PNG.
///
/// # Errors
/// `Image` if the image has no pixels.
pub fn encode_gray_png(image: &GrayImage) -> Result<Vec<u8>, FormatError> {
    encode_png(image.width(), image.height(), ExtendedColorType::L8, image.data())
}

/// An 8-bit PNG of pairs of grey and opacity.
pub(crate) fn encode_png_la8(width: usize, height: usize, pairs: &[u8]) -> Result<Vec<u8>, FormatError> {
    encode_png(width, height, ExtendedColorType::La8, pairs)
}

/// A 16-bit grey PNG of a depth image, rounded to units of `metres_per_unit`; what exceeds 65534 units
/// becomes 0, 'no return'.
///
/// # Errors
/// `Geometry` if the unit is not positive and finite; `Image` if the image has no pixels.
pub fn encode_depth_png(depth: &DepthImage, metres_per_unit: f64) -> Result<Vec<u8>, FormatError> {
    if !(metres_per_unit.is_finite() && metres_per_unit > 0.0) {
        let (field, requirement) = ("metres_per_unit", "positive and finite");
        return Err(percept_geometry::GeometryError::OutOfRange { field, value: metres_per_unit, requirement }.into());
    }
    let unit = |&d: &f32| {
        let units = (f64::from(d) / metres_per_unit).round();
        if units < f64::from(u16::MAX) { units as u16 } else { 0 }
    };
    let bytes: Vec<u8> = depth.data().iter().flat_map(|d| unit(d).to_ne_bytes()).collect();
    encode_png(depth.width(), depth.height(), ExtendedColorType::L16, &bytes)
}

/// A JPEG of quality 1..=100.
///
/// # Errors
/// `Image` if the image has no pixels or more than 65535 in a side.
pub fn encode_jpeg(image: &RgbImage, quality: u8) -> Result<Vec<u8>, FormatError> {
    let (width, height) = image_size(image.width(), image.height())?;
    let mut out = vec![];
    JpegEncoder::new_with_quality(&mut out, quality.clamp(1, 100))
        .write_image(image.data(), width, height, ExtendedColorType::Rgb8)
        .map_err(image_error("JPEG"))?;
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn picture(width: usize, height: usize) -> RgbImage {
        let data = (0..width * height * 3).map(|i| (i * 31 % 251) as u8).collect();
        RgbImage::new(width, height, data).unwrap()
    }

    fn depth(width: usize, height: usize) -> DepthImage {
        let units: Vec<u16> = (0..width * height).map(|i| (i * 977 % 6000) as u16).collect();
        DepthImage::from_u16(width, height, &units, 0.001).unwrap()
    }

    #[test]
    fn lossless_images_read_back_and_cut_ones_do_not() {
        let limits = Limits::default();
        let (picture, depth) = (picture(13, 7), depth(13, 7));
        let png = encode_rgb_png(&picture).unwrap();
        assert_eq!(decode_color(&png, &limits).unwrap(), picture);
        let depth_png = encode_depth_png(&depth, 0.001).unwrap();
        assert_eq!(decode_depth_png(&depth_png, 0.001, &limits).unwrap(), depth);
        let gray = picture.to_gray();
        let gray_png = encode_gray_png(&gray).unwrap();
        let back = decode_gray16(&gray_png, &limits).unwrap();
        assert_eq!((back.bits, back.data), (8, gray.data().iter().map(|&v| u16::from(v)).collect::<Vec<_>>()));
        // The last 16 bytes are the check sum of the pixels and the empty IEND chunk.
        for end in 0..png.len() - 16 {
            assert!(decode_color(&png[..end], &limits).is_err(), "cut at {end} of {}", png.len());
        }
        for end in 0..depth_png.len() - 16 {
            assert!(decode_depth_png(&depth_png[..end], 0.001, &limits).is_err(), "cut at {end}");
        }
        assert!(matches!(decode_depth_png(&gray_png, 0.001, &limits), Err(FormatError::Unsupported { .. })));
        assert!(matches!(decode_depth_png(&png, 0.001, &limits), Err(FormatError::Unsupported { .. })));
        assert!(matches!(decode_depth_png(&depth_png, f64::NAN, &limits), Err(FormatError::Geometry(_))));
    }

    #[test]
    fn jpegs_come_close_and_cut_ones_are_errors() {
        let limits = Limits::default();
        let smooth: Vec<u8> = (0..32 * 24).flat_map(|i| [(i % 32 * 8) as u8, (i / 32 * 10) as u8, 128]).collect();
        let picture = RgbImage::new(32, 24, smooth).unwrap();
        let jpeg = encode_jpeg(&picture, 95).unwrap();
        let back = decode_color(&jpeg, &limits).unwrap();
        let worst = picture.data().iter().zip(back.data()).map(|(a, b)| a.abs_diff(*b)).max().unwrap();
        assert!(worst < 24, "{worst}");
        for end in 0..jpeg.len() - 1 {
            assert!(decode_color(&jpeg[..end], &limits).is_err(), "cut at {end} of {}", jpeg.len());
        }
    }

    #[test]
    fn declared_sizes_are_checked_first() {
        let tight = Limits { max_pixels: 90, ..Limits::default() };
        let png = encode_rgb_png(&picture(13, 7)).unwrap();
        let jpeg = encode_jpeg(&picture(13, 7), 90).unwrap();
        for bytes in [&png, &jpeg] {
            let error = decode_color(bytes, &tight).unwrap_err();
            assert_eq!(error, FormatError::TooLarge { field: "num_pixels", value: 91, limit: 90 });
        }
        let mut lying = png;
        lying[16..24].copy_from_slice(&[0x7f, 0xff, 0xff, 0xff, 0x7f, 0xff, 0xff, 0xff]);
        assert!(matches!(decode_color(&lying, &Limits::default()), Err(FormatError::TooLarge { .. })));
        assert!(matches!(decode_color(b"GIF89a", &Limits::default()), Err(FormatError::Malformed { .. })));
        assert!(decode_color(b"", &Limits::default()).is_err());
    }

    proptest! {
        #[test]
        fn damaged_bytes_never_panic(kind in 0usize..3, hits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6)) {
            let limits = Limits { max_pixels: 1 << 20, ..Limits::default() };
            let mut bytes = match kind {
                0 => encode_rgb_png(&picture(16, 9)).unwrap(),
                1 => encode_depth_png(&depth(16, 9), 0.001).unwrap(),
                _ => encode_jpeg(&picture(16, 9), 90).unwrap(),
            };
            for (at, value) in hits {
                let at = at.index(bytes.len());
                bytes[at] = value;
            }
            let _ = (decode_color(&bytes, &limits), decode_depth_png(&bytes, 0.001, &limits));
        }
    }
}
