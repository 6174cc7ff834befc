//! The body: vertices into a cloud.

use super::FORMAT;
use super::cursor::Cursor;
use super::header::{Element, Encoding, Header, Property};
use crate::layout::{Colors, Column, Layout, Rows, color_value, unit_or_zero};
use crate::scalar::Scalar;
use crate::text::Lines;
use crate::{FormatError, Limits};
use nalgebra::{Point3, Vector3};
use percept_geometry::PointCloud;

/// Columns of a vertex, in the order of `Vertex`.
const X: usize = 0;
const RED: usize = 3;
const INTENSITY: usize = 6;
const NX: usize = 7;
const TIME: usize = 10;
const NUM_SLOTS: usize = 11;

/// One vertex: x y z, red green blue, intensity, nx ny nz, time offset.
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
    let (index, slots) = vertex_slots(&header)?;
    let (before, vertex) = (&header.elements[..index], &header.elements[index]);
    let count = limits.points(vertex.count)?;
    let mut cloud = Builder::new(&slots);
    match header.encoding {
        Encoding::Ascii => read_ascii(bytes, &header, before, vertex, &slots, count, &mut cloud)?,
        _ => read_binary(bytes, &header, before, vertex, &slots, count, &mut cloud)?,
    }
    Ok(cloud.cloud)
}

/// Which element holds the vertices, and what each of its properties is.
fn vertex_slots(header: &Header) -> Result<(usize, Vec<Option<usize>>), FormatError> {
    let position = header.elements.iter().position(|e| e.name == "vertex");
    let index = position.ok_or(FormatError::Missing { format: FORMAT, field: "element vertex" })?;
    let slots: Vec<Option<usize>> = header.elements[index].properties.iter().map(slot).collect();
    for (slot, field) in [(X, "x"), (X + 1, "y"), (X + 2, "z")] {
        if !slots.contains(&Some(slot)) {
            return Err(FormatError::Missing { format: FORMAT, field });
        }
    }
    Ok((index, slots))
}

/// The rows of a file that begins with `head`, if they follow the header at once, binary and all of one size.
pub(crate) fn rows(head: &[u8], limits: &Limits) -> Option<Rows> {
    let header = super::header::parse(head).ok()?;
    let (index, slots) = vertex_slots(&header).ok()?;
    let vertex = &header.elements[index];
    let stride = vertex.stride().filter(|_| index == 0 && header.encoding != Encoding::Ascii)?;
    let num_points = limits.points(vertex.count).ok()?;
    let layout = layout(vertex, stride, &slots, header.encoding == Encoding::BinaryBigEndian);
    Some(Rows { offset: header.body_offset, num_points, stride, layout })
}

/// The encoding that a file declares, as far as it can be read; ascii if it cannot.
pub(crate) fn encoding(bytes: &[u8]) -> Encoding {
    super::header::parse(bytes).map_or(Encoding::Ascii, |h| h.encoding)
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
        "time_offset_s" => TIME,
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
                time_offsets_s: has(TIME, 1).then(Vec::new),
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
        cloud.time_offsets_s.iter_mut().for_each(|c| c.reserve_exact(count));
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
        if let Some(times) = &mut self.cloud.time_offsets_s {
            times.push(v[TIME] as f32);
        }
    }
}

/// Colours to 0..255 by the type they came in.
fn scaled(slot: usize, scalar: Scalar, value: f64) -> f64 {
    if (RED..RED + 3).contains(&slot) { f64::from(color_value(scalar, value)) } else { value }
}

/// The layout of vertices without lists.
fn layout(vertex: &Element, stride: usize, slots: &[Option<usize>], big_endian: bool) -> Layout {
    let mut columns = [None; NUM_SLOTS];
    let mut base = 0;
    for (property, slot) in vertex.properties.iter().zip(slots) {
        if let Some(slot) = *slot {
            columns[slot] = Some(Column { base, step: stride, scalar: property.scalar });
        }
        base += property.scalar.size();
    }
    let three = |from: usize| Some([columns[from]?, columns[from + 1]?, columns[from + 2]?]);
    // The caller has found x, y and z.
    let nothing = Column { base: 0, step: stride, scalar: Scalar::U8 };
    Layout {
        big_endian,
        positions: three(X).unwrap_or([nothing; 3]),
        colors: three(RED).map(Colors::Separate),
        intensities: columns[INTENSITY],
        normals: three(NX),
        time_offsets_s: columns[TIME],
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
    before.iter().try_for_each(|element| cursor.skip(element))?;
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
    let layout = layout(vertex, stride, slots, big_endian);
    cloud.cloud = layout.empty_cloud(count);
    layout.append(body, count, &mut cloud.cloud);
    Ok(())
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
