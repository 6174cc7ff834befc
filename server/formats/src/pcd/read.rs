//! The points: columns into a cloud.

use super::FORMAT;
use super::header::{Encoding, Field, Header, Scalar};
use crate::ply::unit_or_zero;
use crate::text::{Lines, parse};
use crate::{FormatError, Limits};
use nalgebra::{Point3, Vector3};
use percept_geometry::PointCloud;

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
}

/// A cloud from the bytes of a PCD file.
///
/// Read are `x y z`, `rgb` or `rgba` (packed, as float or integer), `intensity`, `normal_x normal_y normal_z`
/// and `label`; other fields are stepped over.
///
/// # Errors
/// `Malformed`, `Missing` (no x, y or z), `Truncated`, `TooLarge`, `Unsupported` (a type), `Geometry` (header
/// rows of different lengths).
pub fn decode(bytes: &[u8], limits: &Limits) -> Result<Pcd, FormatError> {
    let header = super::header::parse(bytes)?;
    let n = limits.points(header.num_points)?;
    let column = |name: &str| header.fields.iter().position(|f| f.name == name && f.count > 0);
    let required = |field| column(field).ok_or(FormatError::Missing { format: FORMAT, field });
    let (x, y, z) = (required("x")?, required("y")?, required("z")?);
    let body = &bytes[header.body_offset..];
    let data = match header.encoding {
        Encoding::Ascii => ascii(bytes, &header, n)?,
        Encoding::Binary => binary(body, &header)?,
        Encoding::BinaryCompressed => compressed(body, &header, limits)?,
    };
    let f = |column: usize, i: usize| data.value(&header.fields, column, i) as f32;
    let positions = (0..n).map(|i| Point3::new(f(x, i), f(y, i), f(z, i))).collect();
    let rgb = column("rgb").or(column("rgba")).filter(|&c| header.fields[c].size == 4);
    let normals = [column("normal_x"), column("normal_y"), column("normal_z")];
    let cloud = PointCloud {
        positions,
        colors: rgb.map(|c| (0..n).map(|i| data.packed_color(c, i)).collect()),
        intensities: column("intensity").or(column("i")).map(|c| (0..n).map(|i| f(c, i)).collect()),
        normals: match normals {
            [Some(nx), Some(ny), Some(nz)] => {
                Some((0..n).map(|i| unit_or_zero(Vector3::new(f(nx, i), f(ny, i), f(nz, i)))).collect())
            }
            _ => None,
        },
        time_offsets_s: None,
    };
    let labels = column("label").map(|c| (0..n).map(|i| data.value(&header.fields, c, i) as u32).collect());
    Ok(Pcd { cloud, labels, width: header.width as usize, height: header.height as usize })
}

/// Points as bytes: value `i` of a column lies at `base + i * step`.
struct Columns<'a> {
    bytes: std::borrow::Cow<'a, [u8]>,
    base_and_step: Vec<(usize, usize)>,
}

impl Columns<'_> {
    fn at(&self, column: usize, i: usize) -> &[u8] {
        let (base, step) = self.base_and_step[column];
        &self.bytes[base + i * step..]
    }

    fn value(&self, fields: &[Field], column: usize, i: usize) -> f64 {
        fields[column].scalar.read(self.at(column, i))
    }

    /// 0x..rrggbb, whatever the type that the four bytes are declared as.
    fn packed_color(&self, column: usize, i: usize) -> [u8; 3] {
        let b = self.at(column, i);
        [b[2], b[1], b[0]]
    }
}

fn truncated(field: &'static str, needed: u64, available: usize) -> FormatError {
    FormatError::Truncated { format: FORMAT, field, needed, available: available as u64 }
}

/// Point after point.
fn binary<'a>(body: &'a [u8], header: &Header) -> Result<Columns<'a>, FormatError> {
    let needed = header.num_points.saturating_mul(header.stride());
    if needed > body.len() as u64 {
        return Err(truncated("points", needed, body.len()));
    }
    let stride = header.stride() as usize;
    let mut base = 0usize;
    let mut base_and_step = vec![];
    for field in &header.fields {
        base_and_step.push((base, stride));
        base = base.saturating_add(field.size.saturating_mul(field.count) as usize);
    }
    Ok(Columns { bytes: body.into(), base_and_step })
}

/// Two sizes, then column after column as LZF.
fn compressed<'a>(body: &[u8], header: &Header, limits: &Limits) -> Result<Columns<'a>, FormatError> {
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
    let mut base_and_step = vec![];
    for field in &header.fields {
        // The product is within `unpacked` unless there is no point to read.
        let step = field.size.saturating_mul(field.count) as usize;
        base_and_step.push((base, step));
        base = base.saturating_add(step.saturating_mul(header.num_points as usize));
    }
    Ok(Columns { bytes: bytes.into(), base_and_step })
}

/// Lines of numbers, brought into the binary form of the first value of each field.
fn ascii<'a>(bytes: &[u8], header: &Header, n: usize) -> Result<Columns<'a>, FormatError> {
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
    let mut base_and_step = vec![];
    for field in &header.fields {
        base_and_step.push((base, stride));
        base += size(field);
    }
    Ok(Columns { bytes: out.into(), base_and_step })
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
