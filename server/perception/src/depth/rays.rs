//! The rays of a camera's pixels, computed once.

use percept_geometry::{CameraIntrinsics, Distortion, GeometryError};

/// Where the ray of every pixel meets the plane at depth 1: multiply by the depth.
///
/// Without distortion x depends on the column and y on the row alone, and only those are kept.
#[derive(Debug, Clone, PartialEq)]
pub struct RayTable {
    width: usize,
    height: usize,
    separable: bool,
    xs: Vec<f32>,
    ys: Vec<f32>,
}

impl RayTable {
    /// Computes the rays of all pixels.
    ///
    /// # Errors
    /// What [`CameraIntrinsics::validate`] finds.
    pub fn new(intrinsics: &CameraIntrinsics) -> Result<Self, GeometryError> {
        intrinsics.validate()?;
        let (width, height) = (intrinsics.width, intrinsics.height);
        let separable = intrinsics.distortion == Distortion::None;
        let (xs, ys) = if separable {
            (
                (0..width).map(|u| intrinsics.ray(u as f64, 0.0).x as f32).collect(),
                (0..height).map(|v| intrinsics.ray(0.0, v as f64).y as f32).collect(),
            )
        } else {
            let pixels = (0..height).flat_map(|v| (0..width).map(move |u| (u, v)));
            pixels
                .map(|(u, v)| {
                    let ray = intrinsics.ray(u as f64, v as f64);
                    (ray.x as f32, ray.y as f32)
                })
                .unzip()
        };
        Ok(Self { width, height, separable, xs, ys })
    }

    /// Columns.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// x and y at depth 1 of the pixel in column `u`, row `v`. Not finite where the lens model cannot be
    /// inverted.
    #[inline]
    pub fn ray(&self, u: usize, v: usize) -> (f32, f32) {
        if self.separable {
            (self.xs[u], self.ys[v])
        } else {
            let i = v * self.width + u;
            (self.xs[i], self.ys[i])
        }
    }
}

impl RayTable {
    /// Whether x depends on the column and y on the row alone.
    pub(super) fn is_separable(&self) -> bool {
        self.separable
    }

    /// x and y at depth 1 of the pixels of row `v`; `scratch` is used where they are not stored so.
    #[inline]
    pub(super) fn row<'a>(&'a self, v: usize, scratch: &'a mut Vec<f32>) -> (&'a [f32], &'a [f32]) {
        if self.separable {
            scratch.clear();
            scratch.resize(self.width, self.ys[v]);
            (&self.xs, scratch)
        } else {
            let row = v * self.width..(v + 1) * self.width;
            (&self.xs[row.clone()], &self.ys[row])
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rays_project_back_to_their_pixels_through_every_lens() {
        for distortion in [
            Distortion::None,
            Distortion::PlumbBob([-0.28, 0.07, 1e-4, -2e-4, 0.0]),
            Distortion::Fisheye([-0.02, 0.01, -0.004, 0.001]),
        ] {
            let camera = CameraIntrinsics { distortion, ..CameraIntrinsics::pinhole(64, 48, 52.0, 53.0, 31.2, 24.1) };
            let table = RayTable::new(&camera).unwrap();
            for (u, v) in [(0, 0), (63, 47), (10, 40), (32, 24)] {
                let (x, y) = table.ray(u, v);
                let p = nalgebra::Point3::new(f64::from(x) * 2.0, f64::from(y) * 2.0, 2.0);
                let q = camera.project(&p).unwrap();
                assert!((q.x - u as f64).abs() < 1e-3 && (q.y - v as f64).abs() < 1e-3, "{distortion:?} {u} {v} {q}");
            }
        }
    }
}
