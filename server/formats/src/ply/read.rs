//! The body: vertices into a cloud.

use super::FORMAT;
use super::header::{Element, Encoding, Header, Property, Scalar};
use crate::text::Lines;
use crate::{FormatError, Limits, Place};
use nalgebra::{Point3, Vector3};
use percept_geometry::PointCloud;

/// Columns of a vertex, in the order of `Vertex`.
const X: usize = 0;
const RED: usize = 3;
const INTENSITY: usize = 6;
const NX: usize = 7;
const NUM_SLOTS: usize = 10;

/// One vertex: x y z, red green blue, intensity, nx ny nz.
type Vertex = [f64; NUM_SLOTS];

/// A cloud from the bytes of a PLY file.
///
/// Colours of type float are taken as 0..1, of ushort as 0..65535. Coordinates become f32: far-off
/// (georeferenced) ones lose what f32 cannot hold. Bytes after the vertices are not looked at.
///
/// # Errors
/// `Malformed`, `Missing` (no vertex element, no x, y or z), `Truncated`, `TooLarge`.
pub fn decode(bytes: &[u8], limits: &Limits) -> Result<PointCloud, FormatError> {
    let header = super::header::parse(bytes)?;
    let position = header.elements.iter().position(|e| e.name == "vertex");
    let index = position.ok_or(FormatError::Missing { format: FORMAT, field: "element vertex" })?;
    let (before, vertex) = (&header.elements[..index], &header.elements[index]);
    let slots: Vec<Option<usize>> = vertex.properties.iter().map(slot).collect();
    for (slot, field) in [(X, "x"), (X + 1, "y"), (X + 2, "z")] {
        if !slots.contains(&Some(slot)) {
            return Err(FormatError::Missing { format: FORMAT, field });
        }
    }
    let count = limits.points(vertex.count)?;
    let mut cloud = Builder::new(&slots);
    match header.encoding {
        Encoding::Ascii => read_ascii(bytes, &header, before, vertex, &slots, count, &mut cloud)?,
        _ => read_binary(bytes, &header, before, vertex, &slots, count, &mut cloud)?,
    }
    Ok(cloud.cloud)
}

fn slot(property: &Property) -> Option<usize> {
    if property.list_length.is_some() {
        return None;
    }
    Some(match property.name.as_str() {
        "x" => X,
        "y" => X + 1,
        "z" => X + 2,
        "red" | "r" | "diffuse_red" => RED,
        "green" | "g" | "diffuse_green" => RED + 1,
        "blue" | "b" | "diffuse_blue" => RED + 2,
        "intensity" | "scalar_intensity" | "scalar_Intensity" | "reflectance" => INTENSITY,
        "nx" | "normal_x" => NX,
        "ny" | "normal_y" => NX + 1,
        "nz" | "normal_z" => NX + 2,
        _ => return None,
    })
}

/// Grows a cloud with those channels that the file has.
struct Builder {
    cloud: PointCloud,
}

impl Builder {
    fn new(slots: &[Option<usize>]) -> Self {
        let has = |from: usize, n: usize| (from..from + n).all(|s| slots.contains(&Some(s)));
        Self {
            cloud: PointCloud {
                colors: has(RED, 3).then(Vec::new),
                intensities: has(INTENSITY, 1).then(Vec::new),
                normals: has(NX, 3).then(Vec::new),
                ..PointCloud::default()
            },
        }
    }

    fn reserve(&mut self, count: usize) {
        let cloud = &mut self.cloud;
        cloud.positions.reserve_exact(count);
        cloud.colors.iter_mut().for_each(|c| c.reserve_exact(count));
        cloud.intensities.iter_mut().for_each(|c| c.reserve_exact(count));
        cloud.normals.iter_mut().for_each(|c| c.reserve_exact(count));
    }

    fn push(&mut self, v: &Vertex) {
        self.cloud.positions.push(Point3::new(v[X] as f32, v[X + 1] as f32, v[X + 2] as f32));
        if let Some(colors) = &mut self.cloud.colors {
            colors.push([v[RED] as u8, v[RED + 1] as u8, v[RED + 2] as u8]);
        }
        if let Some(intensities) = &mut self.cloud.intensities {
            intensities.push(v[INTENSITY] as f32);
        }
        if let Some(normals) = &mut self.cloud.normals {
            normals.push(unit_or_zero(Vector3::new(v[NX] as f32, v[NX + 1] as f32, v[NX + 2] as f32)));
        }
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

/// Colours to 0..255 by the type they came in.
fn scaled(slot: usize, scalar: Scalar, value: f64) -> f64 {
    match scalar {
        _ if !(RED..RED + 3).contains(&slot) => value,
        Scalar::F32 | Scalar::F64 => (value * 255.0).round(),
        Scalar::U16 => value / 257.0,
        _ => value,
    }
}

fn read_binary(
    bytes: &[u8],
    header: &Header,
    before: &[Element],
    vertex: &Element,
    slots: &[Option<usize>],
    count: usize,
    cloud: &mut Builder,
) -> Result<(), FormatError> {
    let big_endian = header.encoding == Encoding::BinaryBigEndian;
    let mut cursor = Cursor { bytes, offset: header.body_offset, big_endian };
    for element in before.iter().filter(|e| !e.properties.is_empty()) {
        match element.stride() {
            Some(stride) => {
                cursor.take(element.count.saturating_mul(stride as u64), "element before the vertices")?;
            }
            None => {
                for _ in 0..element.count {
                    cursor.visit(element, |_, _| {})?;
                }
            }
        }
    }
    let mut v: Vertex = [0.0; NUM_SLOTS];
    let Some(stride) = vertex.stride() else {
        for _ in 0..count {
            cursor.visit(vertex, |i, value| {
                if let Some(slot) = slots[i] {
                    v[slot] = scaled(slot, vertex.properties[i].scalar, value);
                }
            })?;
            cloud.push(&v);
        }
        return Ok(());
    };
    let body = cursor.take(vertex.count.saturating_mul(stride as u64), "vertices")?;
    let mut offset = 0;
    let mut columns = vec![];
    for (property, slot) in vertex.properties.iter().zip(slots) {
        columns.extend(slot.map(|slot| (offset, property.scalar, slot)));
        offset += property.scalar.size();
    }
    cloud.reserve(count);
    for row in body.chunks_exact(stride) {
        for &(offset, scalar, slot) in &columns {
            v[slot] = scaled(slot, scalar, scalar.read(&row[offset..], big_endian));
        }
        cloud.push(&v);
    }
    Ok(())
}

/// A place in a binary body.
struct Cursor<'a> {
    bytes: &'a [u8],
    offset: usize,
    big_endian: bool,
}

impl<'a> Cursor<'a> {
    fn take(&mut self, needed: u64, field: &'static str) -> Result<&'a [u8], FormatError> {
        let rest = &self.bytes[self.offset..];
        match usize::try_from(needed).ok().and_then(|n| rest.get(..n)) {
            Some(taken) => {
                self.offset += taken.len();
                Ok(taken)
            }
            None => Err(FormatError::Truncated { format: FORMAT, field, needed, available: rest.len() as u64 }),
        }
    }

    /// One element with lists; `visit` gets the scalar properties, by their index.
    fn visit(&mut self, element: &Element, mut visit: impl FnMut(usize, f64)) -> Result<(), FormatError> {
        for (i, property) in element.properties.iter().enumerate() {
            match property.list_length {
                None => {
                    let bytes = self.take(property.scalar.size() as u64, "property")?;
                    visit(i, property.scalar.read(bytes, self.big_endian));
                }
                Some(length) => {
                    let at = self.offset as u64;
                    let bytes = self.take(length.size() as u64, "list length")?;
                    let n = length.read(bytes, self.big_endian);
                    if !(n >= 0.0 && n.fract() == 0.0) {
                        let found = n.to_string();
                        let field = format!("length of list {}", property.name);
                        return Err(FormatError::malformed(
                            FORMAT,
                            Place::Byte(at),
                            field,
                            found.as_bytes(),
                            "a count",
                        ));
                    }
                    self.take((n as u64).saturating_mul(property.scalar.size() as u64), "list")?;
                }
            }
        }
        Ok(())
    }
}

fn read_ascii(
    bytes: &[u8],
    header: &Header,
    before: &[Element],
    vertex: &Element,
    slots: &[Option<usize>],
    count: usize,
    cloud: &mut Builder,
) -> Result<(), FormatError> {
    let mut lines = Lines::resume(FORMAT, bytes, header.body_offset, header.num_lines).contents();
    let available = (bytes.len() - header.body_offset) as u64;
    // A number takes a digit and what parts it from the next; so a lying count fails before memory is taken.
    let needed = vertex.count.saturating_mul(2 * vertex.properties.len() as u64).saturating_sub(1);
    let truncated = FormatError::Truncated { format: FORMAT, field: "vertices", needed, available };
    if needed > available {
        return Err(truncated);
    }
    for element in before.iter().filter(|e| !e.properties.is_empty()) {
        for _ in 0..element.count {
            lines.next().ok_or_else(|| truncated.clone())?;
        }
    }
    cloud.reserve(count);
    let mut v: Vertex = [0.0; NUM_SLOTS];
    for _ in 0..count {
        let line = lines.next().ok_or_else(|| truncated.clone())?;
        let mut fields = line.fields();
        for (property, slot) in vertex.properties.iter().zip(slots) {
            if property.list_length.is_some() {
                for _ in 0..fields.number::<u32>(&property.name)? {
                    fields.required(&property.name)?;
                }
            } else if let Some(slot) = *slot {
                v[slot] = scaled(slot, property.scalar, fields.number(&property.name)?);
            } else {
                fields.required(&property.name)?;
            }
        }
        cloud.push(&v);
    }
    Ok(())
}
