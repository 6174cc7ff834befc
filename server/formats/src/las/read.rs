//! Records into a cloud.

use super::header::{COLOR_AT, Header, at};
use crate::{FormatError, Limits};
use nalgebra::Point3;
use percept_geometry::PointCloud;

/// Coordinates beyond this (m) make the decoder state an origin: f32 steps by 2 mm there.
const FAR_M: f64 = 16384.0;

/// The integers of the records.
#[derive(Default)]
struct Raw {
    positions: Vec<[i32; 3]>,
    intensities: Vec<u16>,
    colors: Vec<[u16; 3]>,
}

/// A cloud from the bytes of a LAS or LAZ file, and the origin (m) that its positions are relative to.
///
/// The origin is zero unless a coordinate exceeds 16384 m; then it is the first point in whole metres: coordinate and
/// origin together, in f64, are the file's numbers to within half a millimetre in a cloud of 8 km. Intensities are the
/// sensor's 0..65535, absent if all are 0. Colours are 16 bits by the standard; where none exceeds 255 they are taken
/// for 8 bits, as many programs write them. Other fields (returns, classes, GPS time) are stepped over.
///
/// # Errors
/// `Malformed` (a count that contradicts the records, scale, items), `Missing`, `Truncated`, `TooLarge` (points, or bytes
/// once unpacked), `Unsupported` (version, point format), `Image` (the word of the unpacking library).
pub fn decode(bytes: &[u8], limits: &Limits) -> Result<(PointCloud, [f64; 3]), FormatError> {
    let header = super::header::parse(bytes, limits)?;
    let mut raw = Raw::default();
    let color_at = COLOR_AT[usize::from(header.point_format)];
    let mut take = |record: &[u8]| {
        let xyz = [0, 4, 8].map(|i| i32::from_le_bytes(at(record, i)));
        raw.positions.push(xyz);
        raw.intensities.push(u16::from_le_bytes(at(record, 12)));
        if let Some(c) = color_at {
            raw.colors.push([c, c + 2, c + 4].map(|i| u16::from_le_bytes(at(record, i))));
        }
    };
    if header.is_packed {
        // Few bytes may unpack to many, as records may have up to 64 KiB, mostly of fields that are stepped over.
        limits.bytes(header.num_points.saturating_mul(header.record_bytes as u64))?;
        super::packed::records(bytes, &header, take)?;
    } else {
        let body = &bytes[header.points_at..];
        body.chunks_exact(header.record_bytes).take(header.num_points as usize).for_each(&mut take);
    }
    let origin = origin(&raw.positions, &header);
    Ok((cloud(&raw, color_at.is_some(), &header, origin), origin))
}

fn metres(p: [i32; 3], header: &Header) -> [f64; 3] {
    [0, 1, 2].map(|k| f64::from(p[k]) * header.scale[k] + header.offset[k])
}

fn origin(positions: &[[i32; 3]], header: &Header) -> [f64; 3] {
    let far = positions.iter().any(|&p| metres(p, header).iter().any(|v| v.is_finite() && v.abs() > FAR_M));
    let first = positions.first().map(|&p| metres(p, header).map(f64::floor));
    first.filter(|o| far && o.iter().all(|v| v.is_finite())).unwrap_or([0.0; 3])
}

fn cloud(raw: &Raw, has_color: bool, header: &Header, origin: [f64; 3]) -> PointCloud {
    // Offset and origin first: their difference is exact where both are whole, so that nothing cancels per point.
    let shift = [0, 1, 2].map(|k| header.offset[k] - origin[k]);
    let local = |p: &[i32; 3]| Point3::from([0, 1, 2].map(|k| (f64::from(p[k]) * header.scale[k] + shift[k]) as f32));
    let is_wide = raw.colors.iter().flatten().any(|&c| c > 255);
    let narrow = |c: u16| if is_wide { (c / 257) as u8 } else { c as u8 };
    let has_intensity = raw.intensities.iter().any(|&v| v != 0);
    PointCloud {
        positions: raw.positions.iter().map(local).collect(),
        colors: has_color.then(|| raw.colors.iter().map(|c| c.map(narrow)).collect()),
        intensities: has_intensity.then(|| raw.intensities.iter().map(|&v| f32::from(v)).collect()),
        ..PointCloud::default()
    }
}
