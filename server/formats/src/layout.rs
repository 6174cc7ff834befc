//! Where the channels of a point lie in binary data, and their decoding: shared by PCD and PLY.
//!
//! Rows can be handed over piece by piece, so that a file is decoded while it is read: a piece stays in the cache, and
//! the only large memory that is touched is the cloud's own.

use crate::scalar::Scalar;
use nalgebra::{Point3, Vector3};
use percept_geometry::PointCloud;

/// The values of one field: value `i` lies at `base + i * step`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Column {
    pub(crate) base: usize,
    pub(crate) step: usize,
    pub(crate) scalar: Scalar,
}

/// How colours are kept.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Colors {
    /// Four bytes 0x..rrggbb, whatever type they are declared as, little-endian.
    Packed(Column),
    /// A number each for red, green and blue: floats 0..1, ushort 0..65535, else 0..255.
    Separate([Column; 3]),
}

/// The columns of the channels that a cloud takes.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Layout {
    pub(crate) big_endian: bool,
    pub(crate) positions: [Column; 3],
    pub(crate) colors: Option<Colors>,
    pub(crate) intensities: Option<Column>,
    pub(crate) normals: Option<[Column; 3]>,
    pub(crate) time_offsets_s: Option<Column>,
}

/// Rows of equal size, from `offset` on.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Rows {
    pub(crate) offset: usize,
    pub(crate) num_points: usize,
    pub(crate) stride: usize,
    pub(crate) layout: Layout,
}

impl Layout {
    /// A cloud with the channels of this layout and memory for `n` points, which the caller has compared with the bytes
    /// that are there.
    pub(crate) fn empty_cloud(&self, n: usize) -> PointCloud {
        PointCloud {
            positions: Vec::with_capacity(n),
            colors: self.colors.as_ref().map(|_| Vec::with_capacity(n)),
            intensities: self.intensities.map(|_| Vec::with_capacity(n)),
            normals: self.normals.map(|_| Vec::with_capacity(n)),
            time_offsets_s: self.time_offsets_s.map(|_| Vec::with_capacity(n)),
        }
    }

    /// Appends `n` points, whose columns all lie within `bytes`.
    pub(crate) fn append(&self, bytes: &[u8], n: usize, cloud: &mut PointCloud) {
        let value = |column: Column, i: usize| {
            column.scalar.read(&bytes[column.base + i * column.step..], self.big_endian) as f32
        };
        let triple = |c: &[Column; 3], i: usize| [value(c[0], i), value(c[1], i), value(c[2], i)];
        match self.adjacent_floats(&self.positions) {
            Some((base, step)) => append_rows(bytes, base, step, n, &mut cloud.positions),
            None => cloud.positions.extend((0..n).map(|i| Point3::from(triple(&self.positions, i)))),
        }
        if let (Some(columns), Some(out)) = (&self.colors, &mut cloud.colors) {
            self.append_colors(columns, bytes, n, out);
        }
        if let (Some(column), Some(out)) = (self.intensities, &mut cloud.intensities) {
            out.extend((0..n).map(|i| value(column, i)));
        }
        if let (Some(columns), Some(out)) = (&self.normals, &mut cloud.normals) {
            out.extend((0..n).map(|i| unit_or_zero(Vector3::from(triple(columns, i)))));
        }
        if let (Some(column), Some(out)) = (self.time_offsets_s, &mut cloud.time_offsets_s) {
            out.extend((0..n).map(|i| value(column, i)));
        }
    }

    /// Base and step if the three columns are neighbouring little-endian f32.
    fn adjacent_floats(&self, columns: &[Column; 3]) -> Option<(usize, usize)> {
        let [x, y, z] = columns;
        let is_float = columns.iter().all(|c| c.scalar == Scalar::F32 && c.step == x.step);
        let is_adjacent = y.base == x.base + 4 && z.base == x.base + 8 && x.step >= 12;
        (is_float && is_adjacent && !self.big_endian).then_some((x.base, x.step))
    }

    fn append_colors(&self, columns: &Colors, bytes: &[u8], n: usize, out: &mut Vec<[u8; 3]>) {
        match columns {
            Colors::Packed(c) => out.extend((0..n).map(|i| {
                let at = c.base + i * c.step;
                let b: &[u8] = &bytes[at..at + 3];
                [b[2], b[1], b[0]]
            })),
            Colors::Separate(columns) => out.extend((0..n).map(|i| {
                columns.map(|c| color_value(c.scalar, c.scalar.read(&bytes[c.base + i * c.step..], self.big_endian)))
            })),
        }
    }
}

/// Points from rows of `step` bytes that hold three floats from `base` on.
fn append_rows(bytes: &[u8], base: usize, step: usize, n: usize, out: &mut Vec<Point3<f32>>) {
    let float = |b: &[u8; 12], i: usize| f32::from_le_bytes([b[i], b[i + 1], b[i + 2], b[i + 3]]);
    let point = |b: &[u8; 12]| Point3::new(float(b, 0), float(b, 4), float(b, 8));
    let bytes = bytes.get(base..).unwrap_or_default();
    if step == 12 {
        // Nothing lies between the points: the compiler makes this one copy.
        out.extend(bytes.as_chunks::<12>().0.iter().take(n).map(point));
    } else {
        out.extend(bytes.chunks(step).take(n).filter_map(|row| row.first_chunk::<12>()).map(point));
    }
}

/// A colour to 0..255 by the type it came in.
pub(crate) fn color_value(scalar: Scalar, value: f64) -> u8 {
    match scalar {
        Scalar::F32 | Scalar::F64 => (value * 255.0).round() as u8,
        Scalar::U16 => (value / 257.0) as u8,
        _ => value as u8,
    }
}

/// A normal of unit length; zero where it is undefined. One that is unit already keeps its bits.
pub(crate) fn unit_or_zero(n: Vector3<f32>) -> Vector3<f32> {
    let norm = n.norm();
    if (norm - 1.0).abs() < 1e-3 {
        n
    } else if norm > 1e-12 && norm.is_finite() {
        n / norm
    } else {
        Vector3::zeros()
    }
}
