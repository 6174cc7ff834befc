//! A cloud out: PCD 0.7, in the three encodings.

use super::header::Encoding;
use crate::FormatError;
use percept_geometry::PointCloud;
use std::io::Write;

/// Bytes of a binary PCD file; see [`write()`].
///
/// # Errors
/// `Geometry` if a channel has another length than the positions.
pub fn encode(cloud: &PointCloud) -> Result<Vec<u8>, FormatError> {
    encode_as(cloud, Encoding::Binary)
}

/// Bytes of a PCD file in an encoding; fields as [`write()`] has them.
///
/// # Errors
/// `Geometry` if a channel has another length than the positions; `TooLarge` for 4 GiB or more to be compressed.
pub fn encode_as(cloud: &PointCloud, encoding: Encoding) -> Result<Vec<u8>, FormatError> {
    let mut out = Vec::with_capacity(512 + cloud.len() * 32);
    match encoding {
        Encoding::Binary => write(&mut out, cloud)?,
        Encoding::Ascii => write_ascii(&mut out, cloud)?,
        Encoding::BinaryCompressed => write_compressed(&mut out, cloud)?,
    }
    Ok(out)
}

/// Writes a binary PCD file: `x y z` (m), then those of `rgb` (packed float, as PCL writes it), `intensity`,
/// `normal_x normal_y normal_z`, `time_offset_s` that the cloud has.
///
/// Wrap files in a `BufWriter`: each point is a write of its own.
///
/// # Errors
/// `Geometry` if a channel has another length than the positions; `Write` if the writer refuses.
pub fn write(out: &mut impl Write, cloud: &PointCloud) -> Result<(), FormatError> {
    write_header(out, cloud, "binary")?;
    let mut row = Vec::with_capacity(36);
    for i in 0..cloud.len() {
        row.clear();
        fields(cloud, i, |_, bytes| row.extend(bytes));
        out.write_all(&row)?;
    }
    Ok(())
}

fn write_header(out: &mut impl Write, cloud: &PointCloud, encoding: &str) -> Result<(), FormatError> {
    cloud.validate()?;
    let mut names = vec!["x", "y", "z"];
    names.extend(cloud.colors.iter().map(|_| "rgb"));
    names.extend(cloud.intensities.iter().map(|_| "intensity"));
    names.extend(cloud.normals.iter().flat_map(|_| ["normal_x", "normal_y", "normal_z"]));
    names.extend(cloud.time_offsets_s.iter().map(|_| "time_offset_s"));
    let repeated = |word: &str| vec![word; names.len()].join(" ");
    // A packed float could be a NaN, which no text holds: as text, a colour is an integer.
    let types: Vec<&str> = names.iter().map(|&n| if n == "rgb" && encoding == "ascii" { "U" } else { "F" }).collect();
    let n = cloud.len();
    write!(
        out,
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS {}\nSIZE {}\nTYPE {}\nCOUNT {}\n\
         WIDTH {n}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {n}\nDATA {encoding}\n",
        names.join(" "),
        repeated("4"),
        types.join(" "),
        repeated("1"),
    )?;
    Ok(())
}

/// The fields of a point in the order of the header: whether it is a colour, and its four bytes.
fn fields(cloud: &PointCloud, i: usize, mut field: impl FnMut(bool, [u8; 4])) {
    cloud.positions[i].iter().for_each(|v| field(false, v.to_le_bytes()));
    if let Some(colors) = &cloud.colors {
        let [r, g, b] = colors[i];
        field(true, [b, g, r, 0]);
    }
    if let Some(intensities) = &cloud.intensities {
        field(false, intensities[i].to_le_bytes());
    }
    if let Some(normals) = &cloud.normals {
        normals[i].iter().for_each(|v| field(false, v.to_le_bytes()));
    }
    if let Some(times) = &cloud.time_offsets_s {
        field(false, times[i].to_le_bytes());
    }
}

fn write_ascii(out: &mut Vec<u8>, cloud: &PointCloud) -> Result<(), FormatError> {
    write_header(out, cloud, "ascii")?;
    for i in 0..cloud.len() {
        fields(cloud, i, |is_color, bytes| {
            let text = if is_color {
                format!("{} ", u32::from_le_bytes(bytes))
            } else {
                format!("{} ", f32::from_le_bytes(bytes))
            };
            out.extend(text.bytes());
        });
        out.pop();
        out.push(b'\n');
    }
    Ok(())
}

fn write_compressed(out: &mut Vec<u8>, cloud: &PointCloud) -> Result<(), FormatError> {
    write_header(out, cloud, "binary_compressed")?;
    let mut columns: Vec<Vec<u8>> = vec![];
    for i in 0..cloud.len() {
        let mut at = 0;
        fields(cloud, i, |_, bytes| {
            if columns.len() == at {
                columns.push(Vec::with_capacity(4 * cloud.len()));
            }
            columns[at].extend(bytes);
            at += 1;
        });
    }
    let unpacked = columns.concat();
    let packed = super::lzf::compress(&unpacked);
    for length in [packed.len(), unpacked.len()] {
        let value = length as u64;
        let limit = u64::from(u32::MAX);
        let size = u32::try_from(length).map_err(|_| FormatError::TooLarge { field: "num_bytes", value, limit })?;
        out.extend(size.to_le_bytes());
    }
    out.extend(packed);
    Ok(())
}
