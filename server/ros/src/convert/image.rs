//! Images that are not compressed.
//!
//! Source: sensor_msgs' `image_encodings.hpp` (names); REP-118 (depth); ITU-R BT.601 in video range (YUV), as OpenCV has it.

use super::{ConvertError, rows};
use crate::Message;
use crate::messages::Image;
use percept_geometry::{DepthImage, RgbImage};

const MESSAGE: &str = Image::TYPE_NAME;

/// How pixels lie.
#[derive(Debug, Clone, Copy)]
enum Pixels {
    /// Samples a pixel, bytes a sample, and which samples are red, green and blue.
    Samples(usize, usize, [usize; 3]),
    /// One byte a pixel; whether the red pixels are in odd columns, odd rows.
    Bayer(usize, usize),
    /// Two bytes a pixel, colour shared by two: where Y, U and V of a pair begin.
    Yuv422(usize, usize, usize),
}

impl Pixels {
    fn of(encoding: &str) -> Option<Self> {
        Some(match encoding {
            "rgb8" => Self::Samples(3, 1, [0, 1, 2]),
            // OpenCV's order, which is what senders of unnamed channels mean.
            "bgr8" | "8UC3" => Self::Samples(3, 1, [2, 1, 0]),
            "rgba8" => Self::Samples(4, 1, [0, 1, 2]),
            "bgra8" | "8UC4" => Self::Samples(4, 1, [2, 1, 0]),
            "mono8" | "8UC1" => Self::Samples(1, 1, [0; 3]),
            "mono16" => Self::Samples(1, 2, [0; 3]),
            "rgb16" => Self::Samples(3, 2, [0, 1, 2]),
            "bgr16" => Self::Samples(3, 2, [2, 1, 0]),
            "bayer_rggb8" => Self::Bayer(0, 0),
            "bayer_grbg8" => Self::Bayer(1, 0),
            "bayer_gbrg8" => Self::Bayer(0, 1),
            "bayer_bggr8" => Self::Bayer(1, 1),
            "yuv422" | "uyvy" => Self::Yuv422(1, 0, 2),
            "yuv422_yuy2" | "yuyv" => Self::Yuv422(0, 1, 3),
            _ => return None,
        })
    }

    fn bytes_per_pixel(self) -> usize {
        match self {
            Self::Samples(samples, bytes, _) => samples * bytes,
            Self::Bayer(..) => 1,
            Self::Yuv422(..) => 2,
        }
    }
}

fn pixel_rows<'a>(image: &'a Image<'_>, bytes: usize) -> Result<Vec<&'a [u8]>, ConvertError> {
    if image.width == 0 || image.height == 0 {
        let found = format!("{} x {}", image.width, image.height);
        return Err(ConvertError::invalid(MESSAGE, "width, height", found, "a pixel at least"));
    }
    let row_bytes = u64::from(image.width).saturating_mul(bytes as u64);
    Ok(rows(MESSAGE, &image.data, image.height, row_bytes, image.step)?.collect())
}

/// A colour image; grey becomes colour, opacity is dropped, of 16 bits the upper 8 are kept.
///
/// Read are `rgb8 bgr8 rgba8 bgra8 mono8 mono16 rgb16 bgr16`, `8UC1 8UC3 8UC4` in OpenCV's order, `bayer_*8` (each colour the
/// mean of its neighbours), `yuv422 uyvy yuv422_yuy2 yuyv`.
///
/// # Errors
/// `Invalid` (another encoding, no pixels, rows that overlap), `Truncated`.
pub fn color(image: &Image<'_>) -> Result<RgbImage, ConvertError> {
    let pixels = Pixels::of(image.encoding).ok_or_else(|| {
        let expected = "rgb8, bgr8, rgba8, bgra8, mono8, mono16, rgb16, bgr16, bayer_*8, yuv422 or yuv422_yuy2";
        ConvertError::invalid(MESSAGE, "encoding", image.encoding, expected)
    })?;
    let rows = pixel_rows(image, pixels.bytes_per_pixel())?;
    let data = match pixels {
        Pixels::Samples(samples, bytes, rgb) => {
            let high = if bytes == 2 && image.is_bigendian == 0 { 1 } else { 0 };
            let at = rgb.map(|sample| sample * bytes + high);
            let pixels = rows.iter().flat_map(|row| row.chunks_exact(samples * bytes));
            pixels.flat_map(|p| at.map(|i| p.get(i).copied().unwrap_or(0))).collect()
        }
        Pixels::Bayer(x, y) => demosaic(&rows, x, y),
        Pixels::Yuv422(y, u, v) => {
            rows.iter().flat_map(|row| row.chunks(4)).flat_map(|pair| yuv_pair(pair, [y, u, v])).flatten().collect()
        }
    };
    RgbImage::new(image.width as usize, image.height as usize, data).map_err(ConvertError::geometry(MESSAGE))
}

/// Each colour of a pixel as the mean of that colour's samples among the pixel and its eight neighbours: bilinear.
fn demosaic(rows: &[&[u8]], red_x: usize, red_y: usize) -> Vec<u8> {
    let width = rows.first().map_or(0, |row| row.len());
    let mut out = Vec::with_capacity(rows.len() * width * 3);
    for y in 0..rows.len() {
        for x in 0..width {
            let (mut sums, mut counts) = ([0u16; 3], [0u16; 3]);
            for (v, row) in rows.iter().enumerate().take(y + 2).skip(y.saturating_sub(1)) {
                for (u, &sample) in row.iter().enumerate().take(x + 2).skip(x.saturating_sub(1)) {
                    // Red and blue share neither row nor column; green has the rest.
                    let color = usize::from(u % 2 != red_x) + usize::from(v % 2 != red_y);
                    sums[color] += u16::from(sample);
                    counts[color] += 1;
                }
            }
            let own = usize::from(x % 2 != red_x) + usize::from(y % 2 != red_y);
            let center = rows.get(y).and_then(|row| row.get(x)).copied().unwrap_or(0);
            for color in 0..3 {
                let mean = (sums[color] + counts[color] / 2).checked_div(counts[color]).unwrap_or(0) as u8;
                out.push(if color == own { center } else { mean });
            }
        }
    }
    out
}

/// Two pixels (at the end of an odd row, one) that share their colour.
fn yuv_pair(pair: &[u8], [y, u, v]: [usize; 3]) -> impl Iterator<Item = [u8; 3]> {
    let at = |i: usize, default: i32| pair.get(i).map_or(default, |&b| i32::from(b));
    let (u, v) = (at(u, 128) - 128, at(v, 128) - 128);
    let pixel = move |luma: i32| {
        // BT.601 in 1/1024.
        let luma = 1192 * (luma - 16).max(0);
        let rgb = [luma + 1634 * v, luma - 833 * v - 401 * u, luma + 2066 * u];
        rgb.map(|c| ((c + 512) >> 10).clamp(0, 255) as u8)
    };
    let lumas = [at(y, 16), at(y + 2, 16)];
    lumas.into_iter().take(pair.len() / 2).map(pixel)
}

/// A depth image: `16UC1` (or `mono16`) in millimetres, `32FC1` in metres; 0, NaN and infinite are no return (REP-118).
///
/// # Errors
/// `Invalid` (another encoding, no pixels, rows that overlap), `Truncated`.
pub fn depth(image: &Image<'_>) -> Result<DepthImage, ConvertError> {
    let (width, height) = (image.width as usize, image.height as usize);
    let big_endian = image.is_bigendian != 0;
    let made = match image.encoding {
        "16UC1" | "mono16" => {
            let rows = pixel_rows(image, 2)?;
            let samples = rows.iter().flat_map(|row| row.as_chunks::<2>().0);
            let number = |b: &[u8; 2]| if big_endian { u16::from_be_bytes(*b) } else { u16::from_le_bytes(*b) };
            DepthImage::from_u16(width, height, &samples.map(number).collect::<Vec<_>>(), 0.001)
        }
        "32FC1" => {
            let rows = pixel_rows(image, 4)?;
            let samples = rows.iter().flat_map(|row| row.as_chunks::<4>().0);
            let number = |b: &[u8; 4]| if big_endian { f32::from_be_bytes(*b) } else { f32::from_le_bytes(*b) };
            DepthImage::new(width, height, samples.map(number).collect())
        }
        other => {
            let expected = "16UC1 (millimetres) or 32FC1 (metres)";
            return Err(ConvertError::invalid(MESSAGE, "encoding", other, expected));
        }
    };
    made.map_err(ConvertError::geometry(MESSAGE))
}
