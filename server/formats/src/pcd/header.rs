//! The header: fields, sizes, types, and how many points.

use super::FORMAT;
use crate::FormatError;
use crate::scalar::Scalar;
use crate::text::{Fields, Line, Lines};
use nalgebra::{Quaternion, Translation3, UnitQuaternion};
use percept_geometry::Pose;

/// How the points are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Encoding {
    /// Decimal numbers, a point a line.
    Ascii,
    /// Little-endian, point after point.
    Binary,
    /// Little-endian, field after field, packed by LZF.
    BinaryCompressed,
}

/// The type of a letter and a size.
fn scalar_named(letter: &[u8], size: u64) -> Option<Scalar> {
    Some(match (letter, size) {
        (b"I", 1) => Scalar::I8,
        (b"I", 2) => Scalar::I16,
        (b"I", 4) => Scalar::I32,
        (b"I", 8) => Scalar::I64,
        (b"U", 1) => Scalar::U8,
        (b"U", 2) => Scalar::U16,
        (b"U", 4) => Scalar::U32,
        (b"U", 8) => Scalar::U64,
        (b"F", 4) => Scalar::F32,
        (b"F", 8) => Scalar::F64,
        _ => return None,
    })
}

/// One field of a point.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Field {
    pub(super) name: String,
    pub(super) size: u64,
    pub(super) scalar: Scalar,
    /// Values a point, all but the first being skipped.
    pub(super) count: u64,
}

/// What the header says, and where the points begin.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Header {
    pub(super) fields: Vec<Field>,
    pub(super) width: u64,
    pub(super) height: u64,
    pub(super) num_points: u64,
    pub(super) t_cloud_viewpoint: Pose,
    pub(super) encoding: Encoding,
    pub(super) body_offset: usize,
    pub(super) num_lines: u64,
}

impl Header {
    /// Bytes of a point; saturates.
    pub(super) fn stride(&self) -> u64 {
        self.fields.iter().fold(0u64, |sum, f| sum.saturating_add(f.size.saturating_mul(f.count)))
    }
}

fn missing(field: &'static str) -> FormatError {
    FormatError::Missing { format: FORMAT, field }
}

pub(super) fn parse(bytes: &[u8]) -> Result<Header, FormatError> {
    let mut lines = Lines::new(FORMAT, bytes);
    let (mut names, mut sizes, mut types, mut counts) = (vec![], vec![], vec![], vec![]);
    let (mut width, mut height, mut points) = (None, None, None);
    let mut t_cloud_viewpoint = Pose::identity();
    while let Some(line) = lines.next() {
        let mut fields = line.fields();
        match fields.token() {
            Some(b"FIELDS" | b"COLUMNS") => names = tokens(fields),
            Some(b"SIZE") => sizes = numbers(fields, "SIZE")?,
            Some(b"TYPE") => types = tokens(fields),
            Some(b"COUNT") => counts = numbers(fields, "COUNT")?,
            Some(b"WIDTH") => width = Some(fields.number("WIDTH")?),
            Some(b"HEIGHT") => height = Some(fields.number("HEIGHT")?),
            Some(b"POINTS") => points = Some(fields.number("POINTS")?),
            Some(b"DATA") if line.ended => {
                let encoding = match fields.required("DATA")? {
                    b"ascii" => Encoding::Ascii,
                    b"binary" => Encoding::Binary,
                    b"binary_compressed" => Encoding::BinaryCompressed,
                    other => return Err(line.malformed("DATA", other, "ascii, binary or binary_compressed")),
                };
                let width: u64 = width.ok_or(missing("WIDTH"))?;
                let height: u64 = height.unwrap_or(1);
                let num_points: u64 = points.unwrap_or(width.saturating_mul(height));
                if num_points != width.saturating_mul(height) {
                    let found = num_points.to_string();
                    return Err(line.malformed("POINTS", found.as_bytes(), "WIDTH x HEIGHT"));
                }
                return Ok(Header {
                    fields: zip(&names, &sizes, &types, &counts)?,
                    width,
                    height,
                    num_points,
                    t_cloud_viewpoint,
                    encoding,
                    body_offset: lines.offset(),
                    num_lines: lines.number(),
                });
            }
            Some(b"VIEWPOINT") => t_cloud_viewpoint = viewpoint(&line, fields)?,
            Some(b"VERSION") | None => {}
            Some(other) if other.starts_with(b"#") => {}
            Some(other) => return Err(line.malformed("header keyword", other, "a PCD keyword")),
        }
    }
    Err(missing("DATA"))
}

/// Position and quaternion (w first) from which the cloud was taken.
fn viewpoint(line: &Line<'_>, mut fields: Fields<'_>) -> Result<Pose, FormatError> {
    let mut v = [0.0; 7];
    for value in &mut v {
        *value = fields.finite("VIEWPOINT")?;
    }
    let q = UnitQuaternion::try_new(Quaternion::new(v[3], v[4], v[5], v[6]), 1e-9)
        .filter(|q| q.coords.iter().all(|c| c.is_finite()))
        .ok_or_else(|| line.malformed("VIEWPOINT", line.bytes, "a quaternion that is not zero"))?;
    Ok(Pose::from_parts(Translation3::new(v[0], v[1], v[2]), q))
}

fn tokens<'a>(mut fields: Fields<'a>) -> Vec<&'a [u8]> {
    std::iter::from_fn(|| fields.token()).collect()
}

fn numbers(mut fields: Fields<'_>, name: &str) -> Result<Vec<u64>, FormatError> {
    let mut out = vec![];
    let mut rest = fields.clone();
    while rest.token().is_some() {
        out.push(fields.number(name)?);
        rest = fields.clone();
    }
    Ok(out)
}

fn zip(names: &[&[u8]], sizes: &[u64], types: &[&[u8]], counts: &[u64]) -> Result<Vec<Field>, FormatError> {
    let one = vec![1; names.len()];
    let counts = if counts.is_empty() { &one } else { counts };
    for (field, length) in [("SIZE", sizes.len()), ("TYPE", types.len()), ("COUNT", counts.len())] {
        if length != names.len() {
            let (expected, actual) = (names.len(), length);
            return Err(percept_geometry::GeometryError::ShapeMismatch { field, expected, actual }.into());
        }
    }
    let field = |i: usize| {
        let (name, size) = (String::from_utf8_lossy(names[i]).into_owned(), sizes[i]);
        let scalar = scalar_named(types[i], size).ok_or_else(|| FormatError::Unsupported {
            format: FORMAT,
            field: "TYPE and SIZE",
            value: format!("{} {size}", String::from_utf8_lossy(types[i])),
            supported: "I and U of 1, 2, 4, 8 bytes, F of 4 and 8",
        })?;
        Ok(Field { name, size, scalar, count: counts[i] })
    };
    (0..names.len()).map(field).collect()
}
