//! Scenes in closed form, as depth images and scans see them.

use crate::scans::spatial;
use nalgebra::{Point3, Rotation3, UnitQuaternion, Vector3};
use percept_geometry::{CameraIntrinsics, DepthImage, KeyframeScan, Pose, RgbImage};
use percept_mapping::MeshData;
use std::collections::BTreeMap;

/// Something that beams meet.
#[derive(Clone, Copy)]
pub(crate) enum Shape {
    /// Centre, radius.
    Sphere([f64; 3], f64),
    /// Smallest and largest corner, seen from outside.
    Solid([f64; 3], [f64; 3]),
    /// The same, seen from inside.
    Room([f64; 3], [f64; 3]),
}

impl Shape {
    /// How far along a unit direction a beam meets it.
    fn meet(&self, from: &Point3<f64>, d: &Vector3<f64>) -> Option<f64> {
        match self {
            Self::Sphere(center, radius) => {
                let off = from - Point3::from(*center);
                let (b, c) = (off.dot(d), off.norm_squared() - radius * radius);
                let root = b * b - c;
                (root > 0.0).then(|| -b - root.sqrt()).filter(|t| *t > 0.0)
            }
            Self::Solid(min, max) => {
                let (near, far) = slabs(from, d, min, max);
                (near < far && near > 0.0).then_some(near)
            }
            Self::Room(min, max) => Some(slabs(from, d, min, max).1),
        }
    }

    /// Distance of a point from its surface.
    pub(crate) fn distance(&self, p: &Point3<f64>) -> f64 {
        match self {
            Self::Sphere(center, radius) => ((p - Point3::from(*center)).norm() - radius).abs(),
            Self::Solid(min, max) | Self::Room(min, max) => {
                let (min, max) = (Vector3::from(*min), Vector3::from(*max));
                let q = (p.coords - 0.5 * (min + max)).abs() - 0.5 * (max - min);
                (q.sup(&Vector3::zeros()).norm() + q.max().min(0.0)).abs()
            }
        }
    }
}

fn slabs(from: &Point3<f64>, d: &Vector3<f64>, min: &[f64; 3], max: &[f64; 3]) -> (f64, f64) {
    (0..3).fold((f64::NEG_INFINITY, f64::INFINITY), |range, i| {
        let along = if d[i].abs() < 1e-12 { 1e-12 } else { d[i] };
        let (a, b) = ((min[i] - from[i]) / along, (max[i] - from[i]) / along);
        (range.0.max(a.min(b)), range.1.min(a.max(b)))
    })
}

fn first(shapes: &[Shape], from: &Point3<f64>, d: &Vector3<f64>) -> Option<f64> {
    shapes.iter().filter_map(|s| s.meet(from, d)).min_by(f64::total_cmp)
}

pub(crate) fn camera() -> CameraIntrinsics {
    CameraIntrinsics::pinhole(160, 120, 140.0, 140.0, 79.5, 59.5)
}

/// A camera at `eye` that looks at `target`.
pub(crate) fn looking(eye: [f64; 3], target: [f64; 3]) -> Pose {
    let (eye, target) = (Vector3::from(eye), Vector3::from(target));
    let z = (target - eye).normalize();
    let up = if z.z.abs() > 0.9 { Vector3::x() } else { Vector3::z() };
    let x = z.cross(&up).normalize();
    let rotation = Rotation3::from_basis_unchecked(&[x, z.cross(&x), z]);
    Pose::from_parts(eye.into(), UnitQuaternion::from_rotation_matrix(&rotation))
}

/// Depths along the optical axis, and a colour that grows with the column.
pub(crate) fn images(shapes: &[Shape], t_scene_camera: &Pose) -> (DepthImage, RgbImage) {
    let camera = camera();
    let from = Point3::from(t_scene_camera.translation.vector);
    let (mut depths, mut colors) = (vec![], vec![]);
    for (v, u) in (0..camera.height).flat_map(|v| (0..camera.width).map(move |u| (v, u))) {
        let ray = camera.ray(u as f64, v as f64).coords;
        let d = t_scene_camera.rotation * ray.normalize();
        depths.push(first(shapes, &from, &d).map_or(0.0, |t| (t / ray.norm()) as f32));
        colors.extend([200, 100, 50]);
    }
    let depth = DepthImage::new(camera.width, camera.height, depths).unwrap();
    (depth, RgbImage::new(camera.width, camera.height, colors).unwrap())
}

/// What a sensor at `t_scene_base` sees all around, between two elevations: a beam each `step` radians.
pub(crate) fn scan(shapes: &[Shape], t_scene_base: &Pose, elevations: (f64, f64), step: f64) -> KeyframeScan {
    let from = Point3::from(t_scene_base.translation.vector);
    let mut hits = vec![];
    let rows = ((elevations.1 - elevations.0) / step) as i32;
    for row in 0..=rows {
        let elevation = elevations.0 + f64::from(row) * step;
        // As far apart along each ring.
        let columns = (std::f64::consts::TAU * elevation.cos() / step).ceil().max(1.0) as i32;
        for column in 0..columns {
            let azimuth = std::f64::consts::TAU * f64::from(column) / f64::from(columns);
            let d = Vector3::new(elevation.cos() * azimuth.cos(), elevation.cos() * azimuth.sin(), elevation.sin());
            if let Some(t) = first(shapes, &from, &(t_scene_base.rotation * d)) {
                hits.push(Point3::from(d * t).cast());
            }
        }
    }
    let colors = vec![[200, 100, 50]; hits.len()];
    let mut scan = spatial(0.0, hits);
    scan.hits.colors = Some(colors);
    scan
}

/// Mean and largest distance of a mesh's vertices from the nearest of some shapes, metres.
pub(crate) fn errors(mesh: &MeshData, shapes: &[Shape]) -> (f64, f64) {
    let of = |p: &Point3<f32>| shapes.iter().map(|s| s.distance(&p.cast())).fold(f64::INFINITY, f64::min);
    let all: Vec<f64> = mesh.positions.iter().map(of).collect();
    (all.iter().sum::<f64>() / all.len() as f64, all.iter().copied().fold(0.0, f64::max))
}

/// Edges that are not in two triangles, one each way; and the Euler characteristic.
pub(crate) fn topology(mesh: &MeshData) -> (usize, i64) {
    let mut sides: BTreeMap<(u32, u32), (u32, u32)> = BTreeMap::new();
    for [a, b, c] in &mesh.triangles {
        for (a, b) in [(a, b), (b, c), (c, a)] {
            let side = sides.entry((*a.min(b), *a.max(b))).or_default();
            if a < b { side.0 += 1 } else { side.1 += 1 }
        }
    }
    let open = sides.values().filter(|s| **s != (1, 1)).count();
    (open, mesh.positions.len() as i64 - sides.len() as i64 + mesh.triangles.len() as i64)
}
