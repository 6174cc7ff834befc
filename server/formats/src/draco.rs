//! Draco (`.drc`): clouds and meshes out, quantised to a bound that the caller states.
//!
//! Source: Google, "Draco bitstream specification", 2.2, by the crate draco-core. Positions become whole numbers in the cube
//! around them, a step apart; how many bits these take follows from the bound, and nothing else is lost of them but the order of
//! a cloud's points. Web pages read it by three.js' loader, others by Draco's library. Nothing is read here.

use crate::FormatError;
use draco_core::{
    DataType, EncoderBuffer, EncoderOptions, GeometryAttributeType, Mesh, MeshEncoder, PointAttribute,
    PointCloudEncoder,
};
use nalgebra::{Point3, Vector3};
use percept_geometry::cloud::is_finite;
use percept_geometry::{PointCloud, TriangleMesh};
use std::ops::RangeInclusive;

const FORMAT: &str = "Draco";

/// What may be asked for, metres: below, f32 itself is coarser where a map is some kilometres wide.
pub const BOUNDS_M: RangeInclusive<f64> = 1e-4..=1.0;

/// Bits of a normal's octahedral coordinates: it is off by a quarter of a degree at most.
const NORMAL_BITS: i32 = 10;
/// Bits of an intensity, of the range that they have.
const INTENSITY_BITS: i32 = 16;
/// The format holds no more.
const MOST_BITS: i32 = 30;
/// How hard it tries, 0 to 10. Maps of a room and a street at 2 mm: clouds of 317,000 and 281,000 points take 1.43, 1.55, 1.21 and 1.21
/// MB, and 0.78, 0.71, 0.68 and 0.68, with 0, 5, 7 and 10 (4.7 and 3.4 as PLY); a mesh of 13,000 triangles 129, 50, 46 and 44 kB
/// (385), the last in twice the time.
const LEVEL: i32 = 7;

/// Bytes of a mesh, whose positions are off by at most `max_error_m` metres.
///
/// Colours keep their values; normals are off by at most a quarter of a degree, and left out if one is undefined. Triangles keep their
/// corners and their sense, not their order; vertices are numbered anew.
///
/// # Errors
/// `Geometry` if the mesh's parts do not fit each other; `Unsupported` for an empty mesh, which the format cannot hold, and for a bound
/// out of [`BOUNDS_M`]; `TooLarge` beyond what it numbers.
pub fn encode_mesh(mesh: &TriangleMesh, max_error_m: f64) -> Result<Vec<u8>, FormatError> {
    mesh.validate()?;
    if mesh.triangles.is_empty() {
        return Err(unsupported("triangles", "none", "at least one"));
    }
    let (attributes, options) = attributes(&mesh.positions, &mesh.normals, &mesh.colors, None, max_error_m)?;
    let mut out = Mesh::new();
    out.set_num_points(mesh.positions.len());
    attributes.into_iter().for_each(|a| {
        out.add_attribute(a);
    });
    out.set_num_faces(mesh.triangles.len());
    out.set_faces_from_flat_indices(mesh.triangles.as_flattened());
    let (mut encoder, mut bytes) = (MeshEncoder::new(), EncoderBuffer::new());
    encoder.set_mesh(out);
    encoder.encode(&options, &mut bytes).map_err(failed)?;
    Ok(bytes.data().to_vec())
}

/// Bytes of a cloud, whose positions are off by at most `max_error_m` metres, in another order.
///
/// Colours keep their values; intensities become an attribute of their own, off by at most a 131,000th of their range; normals as of
/// meshes. Time offsets are left out.
///
/// # Errors
/// `Geometry` if a channel has another length than the positions; `Unsupported` for a position that is not finite (drop points
/// without return first), an empty cloud, which the format cannot hold, and a bound out of [`BOUNDS_M`]; `TooLarge` beyond what it
/// numbers.
pub fn encode_cloud(cloud: &PointCloud, max_error_m: f64) -> Result<Vec<u8>, FormatError> {
    cloud.validate()?;
    if cloud.is_empty() {
        return Err(unsupported("points", "none", "at least one"));
    }
    if !cloud.positions.iter().all(is_finite) {
        return Err(unsupported("position", "not finite", "finite numbers: drop points without return first"));
    }
    let (normals, colors) = (cloud.normals.as_deref().unwrap_or_default(), cloud.colors.as_deref().unwrap_or_default());
    let (attributes, options) =
        attributes(&cloud.positions, normals, colors, cloud.intensities.as_deref(), max_error_m)?;
    let mut out = draco_core::PointCloud::new();
    out.set_num_points(cloud.len());
    attributes.into_iter().for_each(|a| {
        out.add_attribute(a);
    });
    let (mut encoder, mut bytes) = (PointCloudEncoder::new(), EncoderBuffer::new());
    encoder.set_point_cloud(out);
    encoder.encode(&options, &mut bytes).map_err(failed)?;
    Ok(bytes.data().to_vec())
}

/// What meshes and clouds have alike, and how it is quantised.
fn attributes(
    positions: &[Point3<f32>],
    normals: &[Vector3<f32>],
    colors: &[[u8; 3]],
    intensities: Option<&[f32]>,
    max_error_m: f64,
) -> Result<(Vec<PointAttribute>, EncoderOptions), FormatError> {
    if u32::try_from(positions.len()).is_err() {
        let (value, limit) = (positions.len() as u64, u64::from(u32::MAX));
        return Err(FormatError::TooLarge { field: "num_points", value, limit });
    }
    let mut options = EncoderOptions::new();
    options.set_compression_level(LEVEL);
    let mut out = vec![];
    let mut add = |kind, width: u8, data_type, is_normalized, bytes: &[u8], bits: Option<i32>| {
        let mut attribute = PointAttribute::new();
        attribute.init(kind, width, data_type, is_normalized, positions.len());
        attribute.buffer_mut().write(0, bytes);
        if let Some(bits) = bits {
            options.set_attribute_quantization(out.len() as i32, bits);
        }
        out.push(attribute);
    };
    let bits = position_bits(positions, max_error_m)?;
    let floats = |v: &mut dyn Iterator<Item = f32>| v.flat_map(f32::to_le_bytes).collect::<Vec<u8>>();
    let bytes = floats(&mut positions.iter().flat_map(|p| [p.x, p.y, p.z]));
    add(GeometryAttributeType::Position, 3, DataType::Float32, false, &bytes, Some(bits));
    let is_defined = |n: &Vector3<f32>| n.norm() > 1e-6;
    if !normals.is_empty() && normals.iter().all(is_defined) {
        let bytes = floats(&mut normals.iter().flat_map(|n| [n.x, n.y, n.z]));
        add(GeometryAttributeType::Normal, 3, DataType::Float32, false, &bytes, Some(NORMAL_BITS));
    }
    if !colors.is_empty() {
        add(GeometryAttributeType::Color, 3, DataType::Uint8, true, colors.as_flattened(), None);
    }
    if let Some(intensities) = intensities {
        // One that is not a number is none.
        let bytes = floats(&mut intensities.iter().map(|v| if v.is_finite() { *v } else { 0.0 }));
        add(GeometryAttributeType::Generic, 1, DataType::Float32, false, &bytes, Some(INTENSITY_BITS));
    }
    Ok((out, options))
}

/// The fewest bits a coordinate by which no position is off by more than the bound: in the cube around all, whose edge is their
/// largest extent, half of a cell's diagonal.
fn position_bits(positions: &[Point3<f32>], max_error_m: f64) -> Result<i32, FormatError> {
    if !BOUNDS_M.contains(&max_error_m) {
        return Err(unsupported("max_error_m", &max_error_m.to_string(), "0.0001 to 1 m"));
    }
    let first = positions.first().map_or_else(Vector3::zeros, |p| p.coords);
    let (min, max) = positions.iter().fold((first, first), |(a, b), p| (a.inf(&p.coords), b.sup(&p.coords)));
    let edge = f64::from((max - min).max());
    // A tenth is left for what f32 rounds when it is read again.
    let step = 0.9 * max_error_m * 2.0 / 3.0f64.sqrt();
    Ok(((edge / step + 1.0).log2().ceil() as i32).clamp(1, MOST_BITS))
}

fn unsupported(field: &'static str, value: &str, supported: &'static str) -> FormatError {
    FormatError::Unsupported { format: FORMAT, field, value: value.to_owned(), supported }
}

fn failed(e: draco_core::DracoError) -> FormatError {
    unsupported("geometry", &e.to_string(), "what Draco's encoder takes")
}

#[cfg(test)]
mod tests {
    use super::*;
    use draco_core::{DecoderBuffer, MeshDecoder, PointCloudDecoder};

    fn spread(i: u32, m: u32) -> f32 {
        (i.wrapping_mul(m) >> 8) as f32 / (1u32 << 24) as f32 - 0.5
    }

    fn cloud(num: u32, edge: f32) -> PointCloud {
        let position = |i| edge * Vector3::new(spread(i, 2_654_435_761), spread(i, 2_246_822_519), spread(i, 40_503));
        PointCloud {
            positions: (0..num).map(|i| Point3::new(100.0, -40.0, 3.0) + position(i)).collect(),
            colors: Some((0..num).map(|i| [i as u8, (i >> 3) as u8, 200]).collect()),
            intensities: Some((0..num).map(|i| 100.0 * spread(i, 97_531)).collect()),
            ..PointCloud::default()
        }
    }

    #[test]
    fn no_point_is_off_by_more_than_the_bound() {
        for (edge, bound) in [(1.0, 1e-4), (8.0, 1e-3), (300.0, 2e-3), (300.0, 0.05), (0.0, 0.01), (2.0, 1.0)] {
            let cloud = cloud(400, edge);
            let bytes = encode_cloud(&cloud, bound).unwrap();
            let mut read = draco_core::PointCloud::new();
            PointCloudDecoder::new().decode(&mut DecoderBuffer::new(&bytes), &mut read).unwrap();
            assert_eq!(read.num_points(), cloud.len());
            let at = |k: i32, n: usize| read.attribute(k).read_f32s(cloud.len(), n);
            let positions = at(0, 3);
            // In another order: each of ours has one of theirs.
            for p in &cloud.positions {
                let off = positions.chunks_exact(3).map(|q| (p - Point3::new(q[0], q[1], q[2])).norm());
                let nearest = off.fold(f32::INFINITY, f32::min);
                assert!(f64::from(nearest) <= bound, "{edge} m: off by {nearest}, not {bound}");
            }
            let mut intensities = at(2, 1);
            let mut ours = cloud.intensities.clone().unwrap();
            intensities.sort_by(f32::total_cmp);
            ours.sort_by(f32::total_cmp);
            assert!(intensities.iter().zip(&ours).all(|(a, b)| (a - b).abs() < 1e-3));
        }
    }

    #[test]
    fn a_mesh_keeps_its_triangles_and_their_sense() {
        // A bent sheet.
        let (rows, columns) = (20u32, 30u32);
        let at = |i: u32| Point3::new((i % columns) as f32 * 0.05, (i / columns) as f32 * 0.05, (i % 7) as f32 * 0.01);
        let square = |i: u32| [[i, i + 1, i + columns], [i + 1, i + columns + 1, i + columns]];
        let inner = (0..(rows - 1) * columns).filter(|i| i % columns + 1 < columns);
        let mesh = TriangleMesh {
            positions: (0..rows * columns).map(at).collect(),
            normals: vec![Vector3::z(); (rows * columns) as usize],
            colors: (0..rows * columns).map(|i| [i as u8, 7, 9]).collect(),
            triangles: inner.flat_map(square).collect(),
        };
        let bytes = encode_mesh(&mesh, 0.001).unwrap();
        let mut read = Mesh::new();
        MeshDecoder::new().decode(&mut DecoderBuffer::new(&bytes), &mut read).unwrap();
        let positions = read.attribute(0).read_f32s(read.num_points(), 3);
        let corner = |i: u32| Point3::from(Vector3::from_column_slice(&positions[3 * i as usize..][..3]));
        // To the bound, from whichever corner is the first.
        let key = |corners: [Point3<f32>; 3]| {
            let corners = corners.map(|p| [p.x, p.y, p.z].map(|v| (v / 0.01).round() as i32));
            (0..3).map(|k| [0, 1, 2].map(|i| corners[(i + k) % 3])).min().unwrap()
        };
        let sorted = |mut triangles: Vec<[[i32; 3]; 3]>| {
            triangles.sort_unstable();
            triangles
        };
        let theirs = sorted(read.faces().iter().map(|f| key(f.map(|i| corner(i.0)))).collect());
        let ours = sorted(mesh.triangles.iter().map(|t| key(t.map(|i| mesh.positions[i as usize]))).collect());
        assert!(bytes.len() * 8 < 12 * mesh.triangles.len() + 27 * mesh.positions.len(), "{}", bytes.len());
        assert_eq!(theirs, ours);
    }

    #[test]
    fn what_the_format_cannot_hold_is_refused() {
        let refused = |e: FormatError| matches!(e, FormatError::Unsupported { format: FORMAT, .. });
        assert!(refused(encode_cloud(&PointCloud::default(), 0.01).unwrap_err()));
        assert!(refused(encode_mesh(&TriangleMesh::default(), 0.01).unwrap_err()));
        for bound in [0.0, -1.0, 9e-5, 1.1, f64::NAN, f64::INFINITY] {
            assert!(refused(encode_cloud(&cloud(3, 1.0), bound).unwrap_err()), "{bound}");
        }
        let nowhere = PointCloud { positions: vec![Point3::new(0.0, f32::NAN, 0.0)], ..PointCloud::default() };
        assert!(refused(encode_cloud(&nowhere, 0.01).unwrap_err()));
    }
}
