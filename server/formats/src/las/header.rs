//! The public header block.

use super::FORMAT;
use crate::{FormatError, Limits, Place};

/// Bytes of the header up to version 1.2, and of 1.4.
pub(super) const HEADER_BYTES: usize = 227;
const HEADER_BYTES_1_4: usize = 375;
/// Least bytes of a record of each point format.
pub(super) const RECORD_BYTES: [usize; 11] = [20, 28, 26, 34, 57, 63, 30, 36, 38, 59, 67];
/// Where red, green and blue (u16) of a point format lie.
pub(super) const COLOR_AT: [Option<usize>; 11] = {
    let (a, b, c) = (Some(20), Some(28), Some(30));
    [None, None, a, b, None, b, None, c, c, None, c]
};

/// What is needed to find and scale the points.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Header {
    pub(super) header_bytes: usize,
    pub(super) points_at: usize,
    pub(super) num_vlrs: u32,
    /// 0 to 10.
    pub(super) point_format: u8,
    pub(super) is_packed: bool,
    pub(super) record_bytes: usize,
    pub(super) num_points: u64,
    pub(super) scale: [f64; 3],
    pub(super) offset: [f64; 3],
    /// Whether something may follow the points.
    pub(super) has_trailer: bool,
}

/// Little-endian bytes at a place that the caller has checked.
pub(super) fn at<const N: usize>(bytes: &[u8], at: usize) -> [u8; N] {
    let mut out = [0; N];
    out.copy_from_slice(&bytes[at..at + N]);
    out
}

/// Whether the points are packed (LAZ), as far as the bytes tell.
pub(crate) fn is_compressed(bytes: &[u8]) -> bool {
    bytes.get(104).is_some_and(|b| b & 0xc0 != 0)
}

fn truncated(field: &'static str, needed: usize, bytes: &[u8]) -> FormatError {
    FormatError::Truncated { format: FORMAT, field, needed: needed as u64, available: bytes.len() as u64 }
}

fn malformed(place: usize, field: &str, found: impl std::fmt::Display, expected: &'static str) -> FormatError {
    FormatError::malformed(FORMAT, Place::Byte(place as u64), field, found.to_string().as_bytes(), expected)
}

pub(super) fn parse(bytes: &[u8], limits: &Limits) -> Result<Header, FormatError> {
    if bytes.len() < HEADER_BYTES {
        return Err(truncated("header", HEADER_BYTES, bytes));
    }
    if !bytes.starts_with(b"LASF") {
        return Err(FormatError::malformed(FORMAT, Place::Byte(0), "signature", &bytes[..4], "'LASF'"));
    }
    let (major, minor) = (bytes[24], bytes[25]);
    if major != 1 || minor > 4 {
        let (value, supported) = (format!("{major}.{minor}"), "1.0 to 1.4");
        return Err(FormatError::Unsupported { format: FORMAT, field: "version", value, supported });
    }
    let header_bytes = usize::from(u16::from_le_bytes(at(bytes, 94)));
    let least = if minor == 4 { HEADER_BYTES_1_4 } else { HEADER_BYTES };
    if header_bytes < least {
        return Err(malformed(94, "header size", header_bytes, "227 or more, 375 or more for 1.4"));
    }
    let points_at = u32::from_le_bytes(at(bytes, 96)) as usize;
    if points_at < header_bytes {
        return Err(malformed(96, "offset to point data", points_at, "a place after the header"));
    }
    if points_at > bytes.len() {
        return Err(truncated("header and variable length records", points_at, bytes));
    }
    let (point_format, is_packed) = (bytes[104] & 0x3f, is_compressed(bytes));
    let Some(&least) = RECORD_BYTES.get(usize::from(point_format)) else {
        let (value, supported) = (point_format.to_string(), "0 to 10");
        return Err(FormatError::Unsupported { format: FORMAT, field: "point format", value, supported });
    };
    let record_bytes = usize::from(u16::from_le_bytes(at(bytes, 105)));
    if record_bytes < least {
        return Err(malformed(105, "point record length", record_bytes, "the bytes of the point format or more"));
    }
    let num_points = num_points(bytes, minor)?;
    limits.points(num_points)?;
    let number = |i: usize| f64::from_le_bytes(at(bytes, i));
    let (scale, offset) = ([131, 139, 147].map(number), [155, 163, 171].map(number));
    if let Some(k) = (0..3).find(|&k| !scale[k].is_finite() || scale[k] == 0.0) {
        return Err(malformed(131 + 8 * k, "scale factor", scale[k], "finite and not zero"));
    }
    if let Some(k) = (0..3).find(|&k| !offset[k].is_finite()) {
        return Err(malformed(155 + 8 * k, "offset", offset[k], "finite"));
    }
    let has_waves = minor >= 3 && header_bytes >= 235 && at::<8>(bytes, 227) != [0; 8];
    let has_trailer = has_waves || (minor == 4 && at::<4>(bytes, 243) != [0; 4]);
    let num_vlrs = u32::from_le_bytes(at(bytes, 100));
    let h = Header {
        header_bytes,
        points_at,
        num_vlrs,
        point_format,
        is_packed,
        record_bytes,
        num_points,
        scale,
        offset,
        has_trailer,
    };
    if is_packed { Ok(h) } else { check_length(h, bytes) }
}

/// The count of 1.4, if there is one; the count of before must not contradict it.
fn num_points(bytes: &[u8], minor: u8) -> Result<u64, FormatError> {
    let legacy = u64::from(u32::from_le_bytes(at(bytes, 107)));
    if minor < 4 {
        return Ok(legacy);
    }
    let count = u64::from_le_bytes(at(bytes, 247));
    match (legacy, count) {
        (0, count) => Ok(count),
        (legacy, count) if legacy == count => Ok(count),
        _ => Err(malformed(247, "number of points", count, "the legacy number of points")),
    }
}

/// The records that are there must be those that are declared.
fn check_length(header: Header, bytes: &[u8]) -> Result<Header, FormatError> {
    let available = (bytes.len() - header.points_at) as u64;
    let needed = header.num_points.saturating_mul(header.record_bytes as u64);
    if needed > available {
        return Err(FormatError::Truncated { format: FORMAT, field: "points", needed, available });
    }
    if !header.has_trailer && available - needed >= header.record_bytes as u64 {
        return Err(malformed(107, "number of points", header.num_points, "as many as there are records"));
    }
    Ok(header)
}
