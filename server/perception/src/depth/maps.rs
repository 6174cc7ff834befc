//! Points and normals on the grid of a depth image.

use super::{RayTable, check_size, positive, size};
use nalgebra::{Point3, Vector3};
use percept_geometry::{DepthImage, GeometryError};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// `H x W` points in the optical frame, row-major; NaN where there is no return.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct VertexMap {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// `H x W`, metres.
    pub points: Vec<Point3<f32>>,
}

impl VertexMap {
    /// The point of every pixel with a return.
    ///
    /// # Errors
    /// `ShapeMismatch` if the image is not of the table's size.
    pub fn new(depth: &DepthImage, rays: &RayTable) -> Result<Self, GeometryError> {
        check_size("depth", (rays.width(), rays.height()), size(depth))?;
        let (width, height) = size(depth);
        let mut points = vec![Point3::from([f32::NAN; 3]); width * height];
        for (v, (row, depths)) in points.chunks_mut(width).zip(depth.data().chunks(width)).enumerate() {
            for (u, (point, &d)) in row.iter_mut().zip(depths).enumerate() {
                let (x, y) = rays.ray(u, v);
                if d > 0.0 && x.is_finite() && y.is_finite() {
                    *point = Point3::new(x * d, y * d, d);
                }
            }
        }
        Ok(Self { width, height, points })
    }

    /// The point at column `u`, row `v`; none without a return.
    #[inline]
    pub fn at(&self, u: usize, v: usize) -> Option<Point3<f32>> {
        let p = self.points[v * self.width + u];
        (!p.z.is_nan()).then_some(p)
    }
}

/// How normals are taken from neighbouring pixels.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct NormalMapParams {
    /// Distance to the neighbours used, pixels; more smooths noise and loses small shapes.
    pub step_px: usize,
    /// Neighbours whose depth differs by more than this part of the depth, for each pixel of the step, lie
    /// on another surface. 0.02 keeps planes seen up to 85 degrees off their normal at 525 px focal length.
    pub max_jump_fraction: f64,
    /// Normals more than this off the ray to the camera are dropped, radians.
    pub max_incidence_rad: f64,
}

impl Default for NormalMapParams {
    fn default() -> Self {
        Self { step_px: 2, max_jump_fraction: 0.02, max_incidence_rad: 1.48 }
    }
}

impl NormalMapParams {
    /// Checks the bounds.
    ///
    /// # Errors
    /// `OutOfRange` naming the field.
    pub fn validate(&self) -> Result<(), GeometryError> {
        if !(1..=64).contains(&self.step_px) {
            let value = self.step_px as f64;
            return Err(GeometryError::OutOfRange { field: "step_px", value, requirement: "between 1 and 64" });
        }
        positive("max_jump_fraction", self.max_jump_fraction)?;
        positive("max_incidence_rad", self.max_incidence_rad)
    }
}

/// `H x W` unit normals in the optical frame, facing the camera, row-major; all zero where undefined.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct NormalMap {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// `H x W`, unit length or zero.
    pub normals: Vec<Vector3<f32>>,
}

impl NormalMap {
    /// Normals by the cross product of differences along row and column: central where both neighbours lie
    /// on the pixel's surface, one-sided where one does, undefined where none does.
    ///
    /// Source: Newcombe et al., "KinectFusion", 2011, eq. 4; the test for discontinuities is ours.
    ///
    /// # Errors
    /// `OutOfRange` naming the parameter.
    pub fn new(vertices: &VertexMap, params: &NormalMapParams) -> Result<Self, GeometryError> {
        params.validate()?;
        let (width, height) = (vertices.width, vertices.height);
        let mut normals = vec![Vector3::zeros(); width * height];
        let kernel = Kernel {
            vertices,
            step: params.step_px,
            jump: params.max_jump_fraction as f32 * params.step_px as f32,
            min_cos: params.max_incidence_rad.min(std::f64::consts::FRAC_PI_2).cos() as f32,
        };
        // Rows are independent: the result does not depend on who computes them.
        normals.par_chunks_mut(width.max(1) * 16).enumerate().for_each(|(chunk, rows)| {
            for (i, normal) in rows.iter_mut().enumerate() {
                *normal = kernel.normal(i % width, chunk * 16 + i / width);
            }
        });
        Ok(Self { width, height, normals })
    }

    /// The normal at column `u`, row `v`; none where undefined.
    #[inline]
    pub fn at(&self, u: usize, v: usize) -> Option<Vector3<f32>> {
        let n = self.normals[v * self.width + u];
        (n != Vector3::zeros()).then_some(n)
    }
}

struct Kernel<'a> {
    vertices: &'a VertexMap,
    step: usize,
    jump: f32,
    min_cos: f32,
}

impl Kernel<'_> {
    #[inline]
    fn normal(&self, u: usize, v: usize) -> Vector3<f32> {
        self.try_normal(u, v).unwrap_or_else(Vector3::zeros)
    }

    #[inline]
    fn try_normal(&self, u: usize, v: usize) -> Option<Vector3<f32>> {
        let (s, w, h) = (self.step, self.vertices.width, self.vertices.height);
        let p = self.vertices.at(u, v)?;
        let left = (u >= s).then(|| self.same_surface(&p, u - s, v)).flatten();
        let right = (u + s < w).then(|| self.same_surface(&p, u + s, v)).flatten();
        let up = (v >= s).then(|| self.same_surface(&p, u, v - s)).flatten();
        let down = (v + s < h).then(|| self.same_surface(&p, u, v + s)).flatten();
        let normal = difference(&p, down, up)?.cross(&difference(&p, right, left)?);
        let facing = -normal.dot(&p.coords);
        let scale = normal.norm() * p.coords.norm();
        // At a grazing angle the differences are mostly noise.
        (facing.abs() > self.min_cos * scale).then(|| normal * (facing.signum() / normal.norm()))
    }

    #[inline]
    fn same_surface(&self, p: &Point3<f32>, u: usize, v: usize) -> Option<Point3<f32>> {
        self.vertices.at(u, v).filter(|q| (q.z - p.z).abs() <= self.jump * p.z)
    }
}

#[inline]
fn difference(p: &Point3<f32>, ahead: Option<Point3<f32>>, behind: Option<Point3<f32>>) -> Option<Vector3<f32>> {
    match (ahead, behind) {
        (Some(a), Some(b)) => Some(a - b),
        (Some(a), None) => Some(a - p),
        (None, Some(b)) => Some(p - b),
        (None, None) => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use percept_geometry::CameraIntrinsics;

    /// Depth of the nearer of two planes `n . p = d`, seen by a small camera.
    fn scene(planes: &[(Vector3<f64>, f64)]) -> (CameraIntrinsics, DepthImage) {
        let camera = CameraIntrinsics::pinhole(80, 60, 70.0, 70.0, 39.5, 29.5);
        let data = (0..80 * 60)
            .map(|i| {
                let ray = camera.ray((i % 80) as f64, (i / 80) as f64).coords;
                planes.iter().map(|(n, d)| d / n.dot(&ray)).filter(|z| *z > 0.0).fold(f64::INFINITY, f64::min) as f32
            })
            .collect();
        (camera, DepthImage::new(80, 60, data).unwrap())
    }

    fn normals_of(camera: &CameraIntrinsics, depth: &DepthImage) -> NormalMap {
        let vertices = VertexMap::new(depth, &RayTable::new(camera).unwrap()).unwrap();
        NormalMap::new(&vertices, &NormalMapParams::default()).unwrap()
    }

    #[test]
    fn normals_of_a_plane_are_its_normal_facing_the_camera_up_to_the_border() {
        let n = Vector3::new(0.3, -0.4, 1.0).normalize();
        let (camera, depth) = scene(&[(n, 2.0)]);
        let map = normals_of(&camera, &depth);
        for normal in &map.normals {
            assert!((normal.cast::<f64>() + n).norm() < 1e-4, "{normal}");
        }
    }

    #[test]
    fn normals_do_not_reach_across_a_step() {
        let (camera, mut data) = {
            let (camera, depth) = scene(&[(Vector3::z(), 3.0)]);
            (camera, depth.data().to_vec())
        };
        for row in data.chunks_mut(80) {
            row[..40].fill(1.5);
        }
        data[25 * 80 + 60] = 0.0;
        let map = normals_of(&camera, &DepthImage::new(80, 60, data).unwrap());
        assert_eq!(map.at(60, 25), None);
        for (i, normal) in map.normals.iter().enumerate().filter(|(i, _)| *i != 25 * 80 + 60) {
            assert!((normal + Vector3::z()).norm() < 1e-4, "pixel {i}: {normal}");
        }
    }

    #[test]
    fn an_empty_image_has_no_normals() {
        let depth = DepthImage::new(80, 60, vec![0.0; 4800]).unwrap();
        let (camera, _) = scene(&[]);
        assert!(normals_of(&camera, &depth).normals.iter().all(|n| *n == Vector3::zeros()));
        assert!(NormalMap::new(&VertexMap::default(), &NormalMapParams::default()).unwrap().normals.is_empty());
    }
}
