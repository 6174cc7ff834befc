//! Clouds of any layout.

use super::times::{self, PointTimes, TimeUnit};
use super::{ConvertError, rows};
use crate::Message;
use crate::messages::{PointCloud2, PointField};
use nalgebra::Point3;
use percept_geometry::{PointCloud, cloud::is_finite};

/// A cloud, and what came of its points.
#[derive(Debug, Clone, PartialEq)]
pub struct Cloud {
    /// The points that are finite, row by row, with the channels that the message has.
    pub cloud: PointCloud,
    /// Points that were dropped because a coordinate is NaN or infinite: no return.
    pub num_dropped: usize,
    /// How the points' times were read.
    pub times: PointTimes,
}

const MESSAGE: &str = PointCloud2::TYPE_NAME;

/// Type of a field's numbers, 1 to 8 in the message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Scalar {
    fn of(datatype: u8) -> Option<Self> {
        let all = [Self::I8, Self::U8, Self::I16, Self::U16, Self::I32, Self::U32, Self::F32, Self::F64];
        all.get(usize::from(datatype).checked_sub(1)?).copied()
    }

    fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    fn is_integer(self) -> bool {
        !matches!(self, Self::F32 | Self::F64)
    }
}

/// Where a channel's number lies in a point.
#[derive(Debug, Clone, Copy)]
struct Column {
    offset: usize,
    scalar: Scalar,
    big_endian: bool,
}

fn array<const N: usize>(point: &[u8], offset: usize, big_endian: bool) -> [u8; N] {
    // The layout was checked against the point's size.
    let mut bytes = point.get(offset..).and_then(|b| b.first_chunk::<N>()).copied().unwrap_or([0; N]);
    if big_endian {
        bytes.reverse();
    }
    bytes
}

impl Column {
    fn read(self, point: &[u8]) -> f64 {
        let Self { offset, scalar, big_endian } = self;
        match scalar {
            Scalar::I8 => i8::from_le_bytes(array(point, offset, big_endian)).into(),
            Scalar::U8 => u8::from_le_bytes(array(point, offset, big_endian)).into(),
            Scalar::I16 => i16::from_le_bytes(array(point, offset, big_endian)).into(),
            Scalar::U16 => u16::from_le_bytes(array(point, offset, big_endian)).into(),
            Scalar::I32 => i32::from_le_bytes(array(point, offset, big_endian)).into(),
            Scalar::U32 => u32::from_le_bytes(array(point, offset, big_endian)).into(),
            Scalar::F32 => f32::from_le_bytes(array(point, offset, big_endian)).into(),
            Scalar::F64 => f64::from_le_bytes(array(point, offset, big_endian)),
        }
    }
}

/// Where colour lies.
#[derive(Debug, Clone, Copy)]
enum Colors {
    /// `0x00rrggbb` in four bytes, whatever number they pass for.
    Packed(Column),
    /// Three fields.
    Apart([Column; 3]),
}

impl Colors {
    fn read(self, point: &[u8]) -> [u8; 3] {
        match self {
            Self::Packed(Column { offset, big_endian, .. }) => {
                let [b, g, r, _] = array(point, offset, big_endian);
                [r, g, b]
            }
            Self::Apart(columns) => columns.map(|c| c.read(point) as u8),
        }
    }
}

struct Layout {
    positions: [Column; 3],
    intensities: Option<Column>,
    colors: Option<Colors>,
    normals: Option<[Column; 3]>,
    times: Option<Column>,
}

impl Layout {
    fn of(message: &PointCloud2<'_>) -> Result<Self, ConvertError> {
        let find = |name: &str| {
            let found = message.fields.iter().enumerate().find(|(_, f)| f.name == name);
            found.map(|(index, field)| column(message, index, field)).transpose()
        };
        let first = |names: &[&str]| names.iter().find_map(|name| find(name).transpose()).transpose();
        let three = |names: [&str; 3]| {
            let [a, b, c] = [find(names[0])?, find(names[1])?, find(names[2])?];
            Ok::<_, ConvertError>(a.zip(b).zip(c).map(|((a, b), c)| [a, b, c]))
        };
        let remedy = "send fields x, y and z";
        let positions = three(["x", "y", "z"])?;
        let packed = first(&["rgb", "rgba"])?.filter(|c| c.scalar.size() == 4).map(Colors::Packed);
        Ok(Self {
            positions: positions.ok_or(ConvertError::Missing { message: MESSAGE, field: "fields", remedy })?,
            intensities: first(&["intensity", "intensities", "i", "reflectivity", "reflectance"])?,
            colors: packed.or(three(["r", "g", "b"])?.map(Colors::Apart)),
            normals: three(["normal_x", "normal_y", "normal_z"])?,
            times: first(&times::NAMES)?,
        })
    }
}

fn column(message: &PointCloud2<'_>, index: usize, field: &PointField<'_>) -> Result<Column, ConvertError> {
    let scalar = Scalar::of(field.datatype).ok_or_else(|| {
        let expected = "1 to 8 (i8, u8, i16, u16, i32, u32, f32, f64)";
        ConvertError::invalid(MESSAGE, format!("fields[{index}].datatype of {}", field.name), field.datatype, expected)
    })?;
    if u64::from(field.offset) + scalar.size() as u64 > u64::from(message.point_step) {
        let expected = "the field's bytes to lie within point_step";
        let (path, found) = (format!("fields[{index}].offset of {}", field.name), field.offset);
        return Err(ConvertError::invalid(MESSAGE, path, found, expected));
    }
    Ok(Column { offset: field.offset as usize, scalar, big_endian: message.is_bigendian })
}

/// The points of a message, in the frame of its header.
///
/// Read are `x y z` of any numeric type, `intensity` (or `reflectivity`, and the like), `rgb` or `rgba` packed or `r g b` apart,
/// `normal_x normal_y normal_z`, and the points' times by their usual names. `time_unit` is for drivers whose unit is not
/// found by type and size. 64-bit coordinates lose what 32 bits cannot hold.
///
/// # Errors
/// `Missing` (no x, y or z), `Invalid` (an unknown type, a field beyond the point, rows that overlap), `Truncated`.
pub fn cloud(message: &PointCloud2<'_>, time_unit: Option<TimeUnit>) -> Result<Cloud, ConvertError> {
    let PointCloud2 { width, height, point_step, row_step, .. } = *message;
    if width == 0 || height == 0 {
        return Ok(Cloud { cloud: PointCloud::default(), num_dropped: 0, times: PointTimes::Absent });
    }
    let layout = Layout::of(message)?;
    let row_bytes = u64::from(width).saturating_mul(u64::from(point_step));
    let rows = rows(MESSAGE, &message.data, height, row_bytes, row_step)?;
    // No more than the bytes that are there: a point has one at least.
    let n = width as usize * height as usize;
    let mut out = PointCloud {
        positions: Vec::with_capacity(n),
        intensities: layout.intensities.map(|_| Vec::with_capacity(n)),
        colors: layout.colors.map(|_| Vec::with_capacity(n)),
        normals: layout.normals.map(|_| Vec::with_capacity(n)),
        time_offsets_s: None,
    };
    let mut times = Vec::with_capacity(if layout.times.is_some() { n } else { 0 });
    for point in rows.flat_map(|row| row.chunks_exact(point_step as usize)) {
        let position = Point3::from(layout.positions.map(|c| c.read(point) as f32));
        if !is_finite(&position) {
            continue;
        }
        out.positions.push(position);
        if let (Some(column), Some(intensities)) = (layout.intensities, &mut out.intensities) {
            intensities.push(column.read(point) as f32);
        }
        if let (Some(place), Some(colors)) = (layout.colors, &mut out.colors) {
            colors.push(place.read(point));
        }
        if let (Some(columns), Some(normals)) = (layout.normals, &mut out.normals) {
            normals.push(columns.map(|c| c.read(point) as f32).into());
        }
        if let Some(column) = layout.times {
            times.push(column.read(point));
        }
    }
    let num_dropped = n - out.len();
    let mut read_as = PointTimes::Absent;
    if let Some(column) = layout.times.filter(|_| !out.is_empty()) {
        (read_as, out.time_offsets_s) =
            times::offsets(&times, column.scalar.is_integer(), message.header.stamp.into(), time_unit);
    }
    Ok(Cloud { cloud: out, num_dropped, times: read_as })
}
