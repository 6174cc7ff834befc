//! A cloud out: x y z, then those of colour, intensity, normals and time offsets that it has.

use super::header::Encoding;
use crate::FormatError;
use percept_geometry::PointCloud;
use std::io::Write;

/// Bytes of a PLY file; see [`write()`].
///
/// # Errors
/// `Geometry` if a channel has another length than the positions.
pub fn encode(cloud: &PointCloud, encoding: Encoding) -> Result<Vec<u8>, FormatError> {
    let mut out = Vec::with_capacity(512 + cloud.len() * 32);
    write(&mut out, cloud, encoding)?;
    Ok(out)
}

/// Writes a PLY file: float x y z (m), uchar red green blue, float intensity, float nx ny nz, float
/// time_offset_s.
///
/// Wrap files in a `BufWriter`: each point is a write of its own.
///
/// # Errors
/// `Geometry` if a channel has another length than the positions; `Write` if the writer refuses.
pub fn write(out: &mut impl Write, cloud: &PointCloud, encoding: Encoding) -> Result<(), FormatError> {
    cloud.validate()?;
    write!(out, "ply\nformat {} 1.0\nelement vertex {}\n", encoding_name(encoding), cloud.len())?;
    write_properties(out, "float", &["x", "y", "z"])?;
    if cloud.colors.is_some() {
        write_properties(out, "uchar", &["red", "green", "blue"])?;
    }
    if cloud.intensities.is_some() {
        write_properties(out, "float", &["intensity"])?;
    }
    if cloud.normals.is_some() {
        write_properties(out, "float", &["nx", "ny", "nz"])?;
    }
    if cloud.time_offsets_s.is_some() {
        write_properties(out, "float", &["time_offset_s"])?;
    }
    out.write_all(b"end_header\n")?;
    let mut row = Vec::with_capacity(160);
    for i in 0..cloud.len() {
        row.clear();
        append_row(&mut row, cloud, i, encoding);
        out.write_all(&row)?;
    }
    Ok(())
}

pub(super) fn encoding_name(encoding: Encoding) -> &'static str {
    match encoding {
        Encoding::Ascii => "ascii",
        Encoding::BinaryLittleEndian => "binary_little_endian",
        Encoding::BinaryBigEndian => "binary_big_endian",
    }
}

pub(super) fn write_properties(out: &mut impl Write, kind: &str, names: &[&str]) -> Result<(), FormatError> {
    for name in names {
        writeln!(out, "property {kind} {name}")?;
    }
    Ok(())
}

/// Numbers as they stand in a row, each followed by a space if it is a text.
pub(super) fn append_floats(row: &mut Vec<u8>, values: &[f32], encoding: Encoding) {
    for v in values {
        match encoding {
            Encoding::Ascii => row.extend(format!("{v} ").bytes()),
            Encoding::BinaryLittleEndian => row.extend(v.to_le_bytes()),
            Encoding::BinaryBigEndian => row.extend(v.to_be_bytes()),
        }
    }
}

fn append_row(row: &mut Vec<u8>, cloud: &PointCloud, i: usize, encoding: Encoding) {
    append_floats(row, cloud.positions[i].coords.as_slice(), encoding);
    if let Some(colors) = &cloud.colors {
        match encoding {
            Encoding::Ascii => colors[i].iter().for_each(|c| row.extend(format!("{c} ").bytes())),
            _ => row.extend(colors[i]),
        }
    }
    if let Some(intensities) = &cloud.intensities {
        append_floats(row, &intensities[i..=i], encoding);
    }
    if let Some(normals) = &cloud.normals {
        append_floats(row, normals[i].as_slice(), encoding);
    }
    if let Some(times) = &cloud.time_offsets_s {
        append_floats(row, &times[i..=i], encoding);
    }
    if encoding == Encoding::Ascii {
        row.pop();
        row.push(b'\n');
    }
}
