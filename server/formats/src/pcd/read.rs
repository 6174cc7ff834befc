//! The points: columns into a cloud.

use super::FORMAT;
use super::header::{Encoding, Field, Header};
use crate::layout::{Colors, Column, Layout, Rows};
use crate::scalar::Scalar;
use crate::text::{Lines, parse};
use crate::{FormatError, Limits};
use percept_geometry::{PointCloud, Pose};

/// A cloud as a PCD file holds it.
#[derive(Debug, Clone, PartialEq)]
pub struct Pcd {
    /// The points, row by row; points without return (NaN) are kept.
    pub cloud: PointCloud,
    /// N labels, if the file has them.
    pub labels: Option<Vec<u32>>,
    /// Columns of an organised cloud; N of one that is not.
    pub width: usize,
    /// Rows of an organised cloud; 1 of one that is not.
    pub height: usize,
    /// Where the sensor stood when it took the cloud (VIEWPOINT); not applied to the points.
    pub t_cloud_viewpoint: Pose,
}

/// A cloud from the bytes of a PCD file.
///
/// Read are `x y z`, `rgb` or `rgba` (packed, as float or integer), `intensity`, `normal_x normal_y normal_z`,
/// `time_offset_s` and `label`; other fields are stepped over.
///
/// # Errors
/// `Malformed`, `Missing` (no x, y or z), `Truncated`, `TooLarge`, `Unsupported` (a type), `Geometry` (header
/// rows of different lengths).
pub fn decode(bytes: &[u8], limits: &Limits) -> Result<Pcd, FormatError> {
    let header = super::header::parse(bytes)?;
    let n = limits.points(header.num_points)?;
    for field in ["x", "y", "z"] {
        column(&header, field).ok_or(FormatError::Missing { format: FORMAT, field })?;
    }
    let body = &bytes[header.body_offset..];
    let data = match header.encoding {
        Encoding::Ascii => ascii(bytes, &header, n)?,
        Encoding::Binary => binary(body, &header)?,
        Encoding::BinaryCompressed => compressed(body, &header, limits)?,
    };
    let layout = layout(&header, &data.columns)?;
    let mut cloud = layout.empty_cloud(n);
    layout.append(&data.bytes, n, &mut cloud);
    let label = column(&header, "label").map(|c| data.columns[c]);
    let value = |c: Column, i: usize| c.scalar.read(&data.bytes[c.base + i * c.step..], false) as u32;
    let labels = label.map(|c| (0..n).map(|i| value(c, i)).collect());
    let (width, height) = (header.width as usize, header.height as usize);
    Ok(Pcd { cloud, labels, width, height, t_cloud_viewpoint: header.t_cloud_viewpoint })
}

/// The rows of a file that begins with `head`, if they are binary and have no label.
pub(crate) fn rows(head: &[u8], limits: &Limits) -> Option<(Rows, Pcd)> {
    let header = super::header::parse(head).ok()?;
    let is_plain = header.encoding == Encoding::Binary && column(&header, "label").is_none();
    let stride = usize::try_from(header.stride()).ok().filter(|_| is_plain)?;
    let num_points = limits.points(header.num_points).ok()?;
    let layout = layout(&header, &columns_of_rows(&header)).ok()?;
    let (width, height) = (header.width as usize, header.height as usize);
    let cloud = PointCloud::default();
    let empty = Pcd { cloud, labels: None, width, height, t_cloud_viewpoint: header.t_cloud_viewpoint };
    Some((Rows { offset: header.body_offset, num_points, stride, layout }, empty))
}

/// The encoding that a file declares, as far as it can be read; ascii if it cannot.
pub(crate) fn encoding(bytes: &[u8]) -> Encoding {
    super::header::parse(bytes).map_or(Encoding::Ascii, |h| h.encoding)
}

/// Index of the field of this name.
fn column(header: &Header, name: &str) -> Option<usize> {
    header.fields.iter().position(|f| f.name == name && f.count > 0)
}

/// Which columns are which channels.
fn layout(header: &Header, columns: &[Column]) -> Result<Layout, FormatError> {
    let of = |name: &str| column(header, name).map(|c| columns[c]);
    let required = |field| of(field).ok_or(FormatError::Missing { format: FORMAT, field });
    let rgb = of("rgb").or(of("rgba")).filter(|c| c.scalar.size() == 4);
    let normals = [of("normal_x"), of("normal_y"), of("normal_z")];
    Ok(Layout {
        big_endian: false,
        positions: [required("x")?, required("y")?, required("z")?],
        colors: rgb.map(Colors::Packed),
        intensities: of("intensity").or(of("i")),
        normals: if let [Some(x), Some(y), Some(z)] = normals { Some([x, y, z]) } else { None },
        time_offsets_s: of("time_offset_s"),
    })
}

/// Points as bytes, and where the values of each field lie.
struct Body<'a> {
    bytes: std::borrow::Cow<'a, [u8]>,
    columns: Vec<Column>,
}

fn truncated(field: &'static str, needed: u64, available: usize) -> FormatError {
    FormatError::Truncated { format: FORMAT, field, needed, available: available as u64 }
}

/// Point after point.
fn binary<'a>(body: &'a [u8], header: &Header) -> Result<Body<'a>, FormatError> {
    let needed = header.num_points.saturating_mul(header.stride());
    if needed > body.len() as u64 {
        return Err(truncated("points", needed, body.len()));
    }
    Ok(Body { bytes: body.into(), columns: columns_of_rows(header) })
}

fn columns_of_rows(header: &Header) -> Vec<Column> {
    let step = header.stride() as usize;
    let mut base = 0usize;
    let mut columns = vec![];
    for field in &header.fields {
        columns.push(Column { base, step, scalar: field.scalar });
        base = base.saturating_add(field.size.saturating_mul(field.count) as usize);
    }
    columns
}

/// Two sizes, then column after column as LZF.
fn compressed<'a>(body: &[u8], header: &Header, limits: &Limits) -> Result<Body<'a>, FormatError> {
    let size = |at: usize| {
        let bytes = body.get(at..at + 4).ok_or(truncated("sizes of the compressed data", 8, body.len()))?;
        Ok::<u64, FormatError>(u64::from(u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]])))
    };
    let (packed, unpacked) = (size(0)?, size(4)?);
    let needed = header.num_points.saturating_mul(header.stride());
    if unpacked != needed {
        let place = crate::Place::Byte(header.body_offset as u64 + 4);
        let found = unpacked.to_string();
        let expected = "POINTS times the size of a point";
        return Err(FormatError::malformed(FORMAT, place, "uncompressed size", found.as_bytes(), expected));
    }
    let input = body.get(8..8 + packed as usize).ok_or(truncated("compressed data", packed, body.len() - 8))?;
    let bytes = super::lzf::decompress(input, limits.bytes(unpacked)?)?;
    let mut base = 0usize;
    let mut columns = vec![];
    for field in &header.fields {
        // The product is within `unpacked` unless there is no point to read.
        let step = field.size.saturating_mul(field.count) as usize;
        columns.push(Column { base, step, scalar: field.scalar });
        base = base.saturating_add(step.saturating_mul(header.num_points as usize));
    }
    Ok(Body { bytes: bytes.into(), columns })
}

/// Lines of numbers, brought into the binary form of the first value of each field.
fn ascii<'a>(bytes: &[u8], header: &Header, n: usize) -> Result<Body<'a>, FormatError> {
    let available = bytes.len() - header.body_offset;
    let numbers = header.fields.iter().fold(0u64, |sum, f| sum.saturating_add(f.count));
    // A number takes a digit and what parts it from the next; so a lying count fails before memory is taken.
    let needed = header.num_points.saturating_mul(numbers).saturating_mul(2).saturating_sub(1);
    if needed > available as u64 && n > 0 {
        return Err(truncated("points", needed, available));
    }
    let size = |f: &Field| if f.count == 0 { 0 } else { f.size as usize };
    let stride: usize = header.fields.iter().map(size).sum();
    let mut out = Vec::with_capacity(n * stride);
    let mut lines = Lines::resume(FORMAT, bytes, header.body_offset, header.num_lines).contents();
    for _ in 0..n {
        let line = lines.next().ok_or(truncated("points", needed, available))?;
        let mut fields = line.fields();
        for field in &header.fields {
            for k in 0..field.count {
                let token = fields.required(&field.name)?;
                if k == 0 && append(&mut out, field.scalar, token).is_none() {
                    return Err(line.malformed(&field.name, token, "a number of the declared type"));
                }
            }
        }
    }
    let mut base = 0usize;
    let mut columns = vec![];
    for field in &header.fields {
        columns.push(Column { base, step: stride, scalar: field.scalar });
        base += size(field);
    }
    Ok(Body { bytes: out.into(), columns })
}

fn append(out: &mut Vec<u8>, scalar: Scalar, token: &[u8]) -> Option<()> {
    match scalar {
        Scalar::F32 => out.extend(parse::<f32>(token)?.to_le_bytes()),
        Scalar::F64 => out.extend(parse::<f64>(token)?.to_le_bytes()),
        Scalar::I8 => out.extend(parse::<i8>(token)?.to_le_bytes()),
        Scalar::I16 => out.extend(parse::<i16>(token)?.to_le_bytes()),
        Scalar::I32 => out.extend(parse::<i32>(token)?.to_le_bytes()),
        Scalar::I64 => out.extend(parse::<i64>(token)?.to_le_bytes()),
        Scalar::U8 => out.extend(parse::<u8>(token)?.to_le_bytes()),
        Scalar::U16 => out.extend(parse::<u16>(token)?.to_le_bytes()),
        Scalar::U32 => out.extend(parse::<u32>(token)?.to_le_bytes()),
        Scalar::U64 => out.extend(parse::<u64>(token)?.to_le_bytes()),
    }
    Some(())
}
