//! Poses, clouds, boxes.

use crate::v1;
use bytes::Bytes;
use nalgebra::{Point2, Point3, Vector3};
use percept_geometry::{Covariance6, OrientedBox3, Plane, PointCloud, Pose, se3};
use percept_service::reason;
use percept_service::{Error, Limits, Result};

/// A pose; absent parts are zero and no rotation.
///
/// # Errors
/// Non-finite numbers, quaternions that are not unit.
pub fn pose(field: &'static str, p: Option<&v1::Pose>) -> Result<Pose> {
    let Some(p) = p else { return Ok(Pose::identity()) };
    let t = p.translation.unwrap_or_default();
    let q = p.rotation.unwrap_or(v1::Quaternion { x: 0.0, y: 0.0, z: 0.0, w: 1.0 });
    Ok(se3::pose_from_parts(field, [t.x, t.y, t.z], [q.x, q.y, q.z, q.w])?)
}

/// A pose as a message.
pub fn pose_to(t: &Pose) -> v1::Pose {
    let [x, y, z, w] = se3::quaternion_xyzw(t);
    v1::Pose { translation: Some(vector_to(&t.translation.vector)), rotation: Some(v1::Quaternion { x, y, z, w }) }
}

/// A vector as a message.
pub fn vector_to(v: &Vector3<f64>) -> v1::Vector3 {
    v1::Vector3 { x: v.x, y: v.y, z: v.z }
}

/// A vector with finite coordinates.
///
/// # Errors
/// `OUT_OF_RANGE` naming the field.
pub fn vector(field: &'static str, v: &v1::Vector3) -> Result<Vector3<f64>> {
    let out = Vector3::new(v.x, v.y, v.z);
    match out.iter().find(|c| !c.is_finite()) {
        Some(&value) => Err(percept_geometry::GeometryError::OutOfRange { field, value, requirement: "finite" }.into()),
        None => Ok(out),
    }
}

/// A point of the plane with finite coordinates.
///
/// # Errors
/// `OUT_OF_RANGE` naming the field.
pub fn point2(field: &'static str, v: &v1::Vector2) -> Result<Point2<f64>> {
    vector(field, &v1::Vector3 { x: v.x, y: v.y, z: 0.0 }).map(|v| Point2::new(v.x, v.y))
}

/// A covariance as a message.
pub fn covariance_to(c: &Covariance6) -> v1::Covariance6 {
    v1::Covariance6 { values: c.transpose().as_slice().to_vec() }
}

/// A covariance: 36 finite values, symmetric, with a non-negative diagonal.
///
/// # Errors
/// `SIZE_MISMATCH`, `OUT_OF_RANGE`, `COVARIANCE_NOT_SYMMETRIC`.
pub fn covariance(field: &'static str, c: &v1::Covariance6) -> Result<Covariance6> {
    use percept_geometry::GeometryError as G;
    if c.values.len() != 36 {
        return Err(G::ShapeMismatch { field, expected: 36, actual: c.values.len() }.into());
    }
    if let Some(&value) = c.values.iter().find(|v| !v.is_finite()) {
        return Err(G::OutOfRange { field, value, requirement: "finite" }.into());
    }
    let m = Covariance6::from_row_slice(&c.values);
    if let Some(value) = m.diagonal().iter().copied().find(|v| *v < 0.0) {
        return Err(G::OutOfRange { field, value, requirement: "non-negative on the diagonal" }.into());
    }
    if (m - m.transpose()).amax() > 1e-6 * m.amax().max(1e-12) {
        return Err(Error::invalid(
            reason::COVARIANCE_NOT_SYMMETRIC,
            field,
            format!("{field} is not symmetric; send the full row-major 6 x 6 matrix"),
        ));
    }
    Ok(m)
}

/// An oriented box as a message.
pub fn box_to(b: &OrientedBox3) -> v1::OrientedBox {
    v1::OrientedBox { t_frame_box: Some(pose_to(&b.t_frame_box)), size_m: Some(vector_to(&b.size)) }
}

/// An oriented box with sizes that are not negative.
///
/// # Errors
/// As for poses; `OUT_OF_RANGE` for a size.
pub fn oriented_box(field: &'static str, b: &v1::OrientedBox) -> Result<OrientedBox3> {
    let size = vector(field, &super::required("size_m", b.size_m).map_err(|e| e.within(field))?)?;
    if let Some(&value) = size.iter().find(|s| **s < 0.0) {
        return Err(percept_geometry::GeometryError::OutOfRange { field, value, requirement: "non-negative" }.into());
    }
    Ok(OrientedBox3 { t_frame_box: pose(field, b.t_frame_box.as_ref())?, size })
}

/// A plane as a message.
pub fn plane_to(p: &Plane) -> v1::Plane {
    v1::Plane { normal: Some(vector_to(&p.normal)), offset_m: p.offset }
}

fn f32s(field: &'static str, data: &Bytes, expected: usize) -> Result<Vec<f32>> {
    if expected.checked_mul(4) != Some(data.len()) {
        return Err(percept_geometry::GeometryError::ShapeMismatch { field, expected, actual: data.len() / 4 }.into());
    }
    Ok(data.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect())
}

/// A cloud; every channel holds `num_points` entries. Non-finite positions stay: they mean no return.
///
/// # Errors
/// `SIZE_MISMATCH` naming the channel, `CLOUD_TOO_LARGE`.
pub fn cloud(c: &v1::PointCloud, limits: &Limits) -> Result<PointCloud> {
    let n = c.num_points as usize;
    if n > limits.max_cloud_points {
        return Err(Error::exhausted(
            reason::CLOUD_TOO_LARGE,
            "num_points",
            format!("num_points is {n}, the limit is {}; downsample or split the cloud", limits.max_cloud_points),
        ));
    }
    let channel = |field, data: &Option<Bytes>| data.as_ref().map(|d| f32s(field, d, n)).transpose();
    let colors = match &c.colours {
        Some(d) if d.len() != n * 3 => {
            let mismatch =
                percept_geometry::GeometryError::ShapeMismatch { field: "colours", expected: n * 3, actual: d.len() };
            return Err(mismatch.into());
        }
        Some(d) => Some(d.chunks_exact(3).map(|p| [p[0], p[1], p[2]]).collect()),
        None => None,
    };
    Ok(PointCloud {
        positions: triples("positions", &c.positions, n, Point3::new)?,
        colors,
        intensities: channel("intensities", &c.intensities)?,
        normals: match &c.normals {
            Some(d) => Some(triples("normals", d, n, Vector3::new)?),
            None => None,
        },
        time_offsets_s: channel("time_offsets_s", &c.time_offsets_s)?,
    })
}

/// Three coordinates an entry, in one pass.
pub(crate) fn triples<T>(field: &'static str, data: &Bytes, n: usize, make: fn(f32, f32, f32) -> T) -> Result<Vec<T>> {
    if n.checked_mul(12) != Some(data.len()) {
        let (expected, actual) = (n * 3, data.len() / 4);
        return Err(percept_geometry::GeometryError::ShapeMismatch { field, expected, actual }.into());
    }
    let coordinate = |b: &[u8], i: usize| f32::from_le_bytes([b[i], b[i + 1], b[i + 2], b[i + 3]]);
    Ok(data.chunks_exact(12).map(|b| make(coordinate(b, 0), coordinate(b, 4), coordinate(b, 8))).collect())
}

/// Three float32 an entry, little-endian.
pub(crate) fn triple_bytes<T>(values: &[T], parts: impl Fn(&T) -> [f32; 3]) -> Bytes {
    let mut out = vec![0; values.len() * 12];
    for (out, v) in out.chunks_exact_mut(12).zip(values) {
        let [x, y, z] = parts(v).map(f32::to_le_bytes);
        out[0..4].copy_from_slice(&x);
        out[4..8].copy_from_slice(&y);
        out[8..12].copy_from_slice(&z);
    }
    out.into()
}

fn f32_bytes(values: impl Iterator<Item = f32>) -> Bytes {
    let mut out = Vec::with_capacity(values.size_hint().0 * 4);
    values.for_each(|v| out.extend_from_slice(&v.to_le_bytes()));
    out.into()
}

/// A cloud as a message.
pub fn cloud_to(c: &PointCloud) -> v1::PointCloud {
    v1::PointCloud {
        num_points: c.len() as u32,
        positions: triple_bytes(&c.positions, |p| [p.x, p.y, p.z]),
        colours: c.colors.as_ref().map(|c| c.as_flattened().to_vec().into()),
        intensities: c.intensities.as_ref().map(|v| f32_bytes(v.iter().copied())),
        normals: c.normals.as_ref().map(|v| triple_bytes(v, |n| [n.x, n.y, n.z])),
        time_offsets_s: c.time_offsets_s.as_ref().map(|v| f32_bytes(v.iter().copied())),
    }
}

/// Points in one part of a cloud; a part stays under gRPC's default limit of 4 MiB with every channel.
const PART_POINTS: usize = 1 << 16;

/// A cloud in parts, in order; at least one.
pub fn cloud_parts(c: &PointCloud) -> Vec<v1::PointCloud> {
    let part = |start: usize| {
        let indices: Vec<usize> = (start..(start + PART_POINTS).min(c.len())).collect();
        cloud_to(&c.select(&indices))
    };
    (0..c.len().max(1)).step_by(PART_POINTS).map(part).collect()
}

/// Parts of a cloud as one. A channel that only some parts have comes out too short, and is refused by [`cloud()`].
pub fn joined(parts: &[v1::PointCloud]) -> v1::PointCloud {
    let channel = |of: fn(&v1::PointCloud) -> Option<&Bytes>| -> Option<Bytes> {
        let parts: Vec<&[u8]> = parts.iter().filter_map(|c| of(c).map(|b| &b[..])).collect();
        (!parts.is_empty()).then(|| parts.concat().into())
    };
    v1::PointCloud {
        num_points: parts.iter().fold(0, |n, c| n.saturating_add(c.num_points)),
        positions: channel(|c| Some(&c.positions)).unwrap_or_default(),
        colours: channel(|c| c.colours.as_ref()),
        intensities: channel(|c| c.intensities.as_ref()),
        normals: channel(|c| c.normals.as_ref()),
        time_offsets_s: channel(|c| c.time_offsets_s.as_ref()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cloud_survives_the_round_trip() {
        let cloud_in = PointCloud {
            positions: vec![Point3::new(1.0, 2.0, 3.0), Point3::new(-1.0, f32::MAX, 0.5)],
            colors: Some(vec![[1, 2, 3], [4, 5, 6]]),
            intensities: Some(vec![0.5, 1.5]),
            normals: Some(vec![Vector3::x(), Vector3::z()]),
            time_offsets_s: Some(vec![0.0, -0.1]),
        };
        assert_eq!(cloud(&cloud_to(&cloud_in), &Limits::default()).unwrap(), cloud_in);
    }

    #[test]
    fn lying_clouds_are_refused_before_memory_is_taken() {
        let lie = v1::PointCloud { num_points: u32::MAX, ..Default::default() };
        assert_eq!(cloud(&lie, &Limits::default()).unwrap_err().reason, "CLOUD_TOO_LARGE");
        let lie = v1::PointCloud { num_points: 3, positions: vec![0; 35].into(), ..Default::default() };
        let e = cloud(&lie, &Limits::default()).unwrap_err();
        assert_eq!((e.reason, e.field.as_str()), ("SIZE_MISMATCH", "positions"));
    }

    #[test]
    fn covariances_are_checked() {
        let fine = covariance_to(&Covariance6::identity());
        assert!(covariance("covariance", &fine).is_ok());
        let mut skewed = fine.clone();
        skewed.values[1] = 0.5;
        assert_eq!(covariance("covariance", &skewed).unwrap_err().reason, "COVARIANCE_NOT_SYMMETRIC");
        assert!(covariance("covariance", &v1::Covariance6 { values: vec![0.0; 35] }).is_err());
    }
}
