//! A cloud out: LAS 1.2, point format 0 or, with colours, 2; packed by LASzip on request.

use super::header::{HEADER_BYTES, RECORD_BYTES};
use crate::FormatError;
use laz::{LasZipCompressor, LazItemRecordBuilder, LazVlr, LazVlrBuilder};
use percept_geometry::PointCloud;
use std::io::Cursor;

/// Bytes of a LAS file (LAZ if `packed`) of a cloud whose positions are relative to `origin` (m).
///
/// The origin becomes the file's offset. Positions are kept to 0.1 mm, in clouds beyond 200 km to what 32 bits hold.
/// Intensities are rounded to 0..65535 (those of 0..1 are spread over that range), colours become 16 bits. Normals and
/// time offsets are left out.
///
/// # Errors
/// `Geometry` if a channel has another length than the positions; `Unsupported` for a position or origin that is not
/// finite (drop points without return first); `TooLarge` beyond 2^32 points.
pub fn encode(cloud: &PointCloud, origin: [f64; 3], packed: bool) -> Result<Vec<u8>, FormatError> {
    cloud.validate()?;
    let finite = cloud.positions.iter().all(percept_geometry::cloud::is_finite);
    if !finite || origin.iter().any(|v| !v.is_finite()) {
        let supported = "finite numbers: drop points without return first";
        return Err(FormatError::Unsupported {
            format: super::FORMAT,
            field: "position",
            value: "not finite".to_owned(),
            supported,
        });
    }
    let point_format = if cloud.colors.is_some() { 2u8 } else { 0 };
    let scale = scale(cloud);
    let records = records(cloud, scale, RECORD_BYTES[usize::from(point_format)]);
    let vlr = packed.then(|| laszip_record(point_format)).transpose()?;
    let mut out = header(cloud, origin, scale, point_format, vlr.as_ref())?;
    match vlr {
        None => out.extend(records),
        Some(vlr) => {
            let end = out.len() as u64;
            let mut cursor = Cursor::new(&mut out);
            cursor.set_position(end);
            let library = |e: laz::LasZipError| FormatError::Image { format: "LAZ", reason: e.to_string() };
            let mut points = LasZipCompressor::new(cursor, vlr).map_err(library)?;
            points.compress_many(&records)?;
            points.done()?;
        }
    }
    Ok(out)
}

/// Metres of one unit: 0.1 mm, or ten, a hundred … times that until every coordinate fits.
fn scale(cloud: &PointCloud) -> f64 {
    let largest = cloud.positions.iter().flat_map(|p| p.coords.iter()).fold(0f64, |m, v| m.max(f64::from(v.abs())));
    let mut scale = 1e-4;
    while largest / scale > 2e9 {
        scale *= 10.0;
    }
    scale
}

fn records(cloud: &PointCloud, scale: f64, record_bytes: usize) -> Vec<u8> {
    let mut out = vec![0; cloud.len() * record_bytes];
    let spread = cloud.intensities.iter().flatten().all(|v| (0.0..=1.0).contains(v));
    let gain = if spread { 65535.0 } else { 1.0 };
    for (i, record) in out.chunks_exact_mut(record_bytes).enumerate() {
        for k in 0..3 {
            let units = (f64::from(cloud.positions[i][k]) / scale).round() as i32;
            record[4 * k..4 * k + 4].copy_from_slice(&units.to_le_bytes());
        }
        if let Some(intensities) = &cloud.intensities {
            record[12..14].copy_from_slice(&((intensities[i] * gain).round() as u16).to_le_bytes());
        }
        // The first of one return.
        record[14] = 0b1001;
        if let Some(colors) = &cloud.colors {
            for k in 0..3 {
                record[20 + 2 * k..22 + 2 * k].copy_from_slice(&(u16::from(colors[i][k]) * 257).to_le_bytes());
            }
        }
    }
    out
}

fn laszip_record(point_format: u8) -> Result<LazVlr, FormatError> {
    let library = |e: laz::LasZipError| FormatError::Image { format: "LAZ", reason: e.to_string() };
    let items = LazItemRecordBuilder::default_for_point_format_id(point_format, 0).map_err(library)?;
    Ok(LazVlrBuilder::new(items).build())
}

fn header(
    cloud: &PointCloud,
    origin: [f64; 3],
    scale: f64,
    point_format: u8,
    vlr: Option<&LazVlr>,
) -> Result<Vec<u8>, FormatError> {
    let (value, limit) = (cloud.len() as u64, u64::from(u32::MAX));
    let count = u32::try_from(value).map_err(|_| FormatError::TooLarge { field: "num_points", value, limit })?;
    let mut content = vec![];
    if let Some(vlr) = vlr {
        vlr.write_to(&mut content).map_err(|e| FormatError::Image { format: "LAZ", reason: e.to_string() })?;
    }
    let vlr_bytes = if vlr.is_some() { 54 + content.len() } else { 0 };
    let mut out = vec![0u8; HEADER_BYTES];
    let mut put = |at: usize, bytes: &[u8]| out[at..at + bytes.len()].copy_from_slice(bytes);
    put(0, b"LASF");
    put(24, &[1, 2]);
    put(58, b"percept");
    put(94, &(HEADER_BYTES as u16).to_le_bytes());
    put(96, &((HEADER_BYTES + vlr_bytes) as u32).to_le_bytes());
    put(100, &u32::from(vlr.is_some()).to_le_bytes());
    put(104, &[point_format | if vlr.is_some() { 0x80 } else { 0 }]);
    put(105, &(RECORD_BYTES[usize::from(point_format)] as u16).to_le_bytes());
    // All points are first returns.
    put(107, &count.to_le_bytes());
    put(111, &count.to_le_bytes());
    for k in 0..3 {
        put(131 + 8 * k, &scale.to_le_bytes());
        put(155 + 8 * k, &origin[k].to_le_bytes());
        let values = || cloud.positions.iter().map(|p| f64::from(p[k]));
        let (min, max) = values().fold((f64::MAX, f64::MIN), |(a, b), v| (a.min(v), b.max(v)));
        let (min, max) = if cloud.is_empty() { (0.0, 0.0) } else { (min, max) };
        put(179 + 16 * k, &(max + origin[k]).to_le_bytes());
        put(187 + 16 * k, &(min + origin[k]).to_le_bytes());
    }
    if vlr.is_some() {
        let mut head = [0u8; 54];
        head[2..2 + LazVlr::USER_ID.len()].copy_from_slice(LazVlr::USER_ID.as_bytes());
        head[18..20].copy_from_slice(&LazVlr::RECORD_ID.to_le_bytes());
        head[20..22].copy_from_slice(&(content.len() as u16).to_le_bytes());
        out.extend(head);
        out.extend(content);
    }
    Ok(out)
}
