//! The pinhole camera and its distortion: project, unproject.

use crate::GeometryError;
use nalgebra::{Point2, Point3};
use serde::{Deserialize, Serialize};

/// Lens distortion as ROS and OpenCV name it.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub enum Distortion {
    /// Rectified images.
    #[default]
    None,
    /// k1, k2, p1, p2, k3 (OpenCV's five-parameter model; Brown 1966).
    PlumbBob([f64; 5]),
    /// k1, k2, p1, p2, k3, k4, k5, k6 (OpenCV's rational model).
    Rational([f64; 8]),
    /// k1, k2, k3, k4 (Kannala and Brandt 2006; OpenCV's fisheye).
    Fisheye([f64; 4]),
}

/// Pinhole intrinsics, pixels; the centre of the top-left pixel is (0, 0).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct CameraIntrinsics {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Focal length x, pixels.
    pub fx: f64,
    /// Focal length y, pixels.
    pub fy: f64,
    /// Principal point x, pixels.
    pub cx: f64,
    /// Principal point y, pixels.
    pub cy: f64,
    /// Lens distortion.
    pub distortion: Distortion,
}

impl CameraIntrinsics {
    /// A rectified pinhole.
    pub fn pinhole(width: usize, height: usize, fx: f64, fy: f64, cx: f64, cy: f64) -> Self {
        Self { width, height, fx, fy, cx, cy, distortion: Distortion::None }
    }

    /// PrimeSense's defaults at 640x480: 525, 525, 319.5, 239.5.
    pub fn primesense() -> Self {
        Self::pinhole(640, 480, 525.0, 525.0, 319.5, 239.5)
    }

    /// Checks sizes, finiteness and focal lengths.
    ///
    /// # Errors
    /// `OutOfRange` naming the field.
    pub fn validate(&self) -> Result<(), GeometryError> {
        for (field, value) in [("fx", self.fx), ("fy", self.fy)] {
            if !(value.is_finite() && value > 0.0) {
                return Err(GeometryError::OutOfRange { field, value, requirement: "positive and finite" });
            }
        }
        for (field, value) in [("cx", self.cx), ("cy", self.cy)] {
            if !value.is_finite() {
                return Err(GeometryError::OutOfRange { field, value, requirement: "finite" });
            }
        }
        for (field, value) in [("width_px", self.width), ("height_px", self.height)] {
            if value == 0 || value > 16384 {
                return Err(GeometryError::OutOfRange {
                    field,
                    value: value as f64,
                    requirement: "between 1 and 16384",
                });
            }
        }
        let coefficients: &[f64] = match &self.distortion {
            Distortion::None => &[],
            Distortion::PlumbBob(k) => k,
            Distortion::Rational(k) => k,
            Distortion::Fisheye(k) => k,
        };
        match coefficients.iter().find(|k| !k.is_finite()) {
            Some(&value) => Err(GeometryError::OutOfRange { field: "distortion", value, requirement: "finite" }),
            None => Ok(()),
        }
    }

    /// Pixel of a point in the optical frame (m); none behind the camera. May lie outside the image.
    pub fn project(&self, p: &Point3<f64>) -> Option<Point2<f64>> {
        if p.z <= 1e-9 {
            return None;
        }
        let (x, y) = self.distort(p.x / p.z, p.y / p.z);
        Some(Point2::new(self.fx * x + self.cx, self.fy * y + self.cy))
    }

    /// The point on the ray of pixel (u, v) at depth 1 along z: multiply by the depth.
    pub fn ray(&self, u: f64, v: f64) -> Point3<f64> {
        let (xd, yd) = ((u - self.cx) / self.fx, (v - self.cy) / self.fy);
        let (x, y) = self.undistort(xd, yd);
        Point3::new(x, y, 1.0)
    }

    /// Intrinsics of the image shrunk by an integer factor with box averaging or by picking the
    /// pixels `factor * i`: pass `centred = true` for averaging.
    pub fn shrunk(&self, factor: usize, centred: bool) -> Self {
        let f = factor as f64;
        let shift = if centred { (f - 1.0) / 2.0 } else { 0.0 };
        Self {
            width: self.width / factor,
            height: self.height / factor,
            fx: self.fx / f,
            fy: self.fy / f,
            cx: (self.cx - shift) / f,
            cy: (self.cy - shift) / f,
            distortion: self.distortion,
        }
    }

    fn distort(&self, x: f64, y: f64) -> (f64, f64) {
        match self.distortion {
            Distortion::None => (x, y),
            Distortion::PlumbBob([k1, k2, p1, p2, k3]) => brown(x, y, [k1, k2, k3, 0.0, 0.0, 0.0], p1, p2),
            Distortion::Rational([k1, k2, p1, p2, k3, k4, k5, k6]) => brown(x, y, [k1, k2, k3, k4, k5, k6], p1, p2),
            Distortion::Fisheye([k1, k2, k3, k4]) => {
                let r = x.hypot(y);
                if r < 1e-12 {
                    return (x, y);
                }
                let a = r.atan();
                let a2 = a * a;
                let d = a * (1.0 + a2 * (k1 + a2 * (k2 + a2 * (k3 + a2 * k4))));
                (x * d / r, y * d / r)
            }
        }
    }

    /// Fixed-point inversion of `distort`; 20 rounds reach 1e-10 for lenses of usual strength.
    fn undistort(&self, xd: f64, yd: f64) -> (f64, f64) {
        match self.distortion {
            Distortion::None => (xd, yd),
            Distortion::Fisheye([k1, k2, k3, k4]) => {
                let d = xd.hypot(yd);
                if d < 1e-12 {
                    return (xd, yd);
                }
                let mut a = d;
                for _ in 0..20 {
                    let a2 = a * a;
                    let f = a * (1.0 + a2 * (k1 + a2 * (k2 + a2 * (k3 + a2 * k4)))) - d;
                    let df = 1.0 + a2 * (3.0 * k1 + a2 * (5.0 * k2 + a2 * (7.0 * k3 + a2 * 9.0 * k4)));
                    a -= f / df;
                }
                let s = a.tan() / d;
                (xd * s, yd * s)
            }
            _ => {
                let (mut x, mut y) = (xd, yd);
                for _ in 0..20 {
                    let (ex, ey) = self.distort(x, y);
                    x -= ex - xd;
                    y -= ey - yd;
                }
                (x, y)
            }
        }
    }
}

/// Brown's radial (rational) and tangential model. OpenCV's `cv::projectPoints`.
fn brown(x: f64, y: f64, k: [f64; 6], p1: f64, p2: f64) -> (f64, f64) {
    let r2 = x * x + y * y;
    let radial = (1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[2]))) / (1.0 + r2 * (k[3] + r2 * (k[4] + r2 * k[5])));
    (x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x), y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn cameras() -> Vec<CameraIntrinsics> {
        let base = CameraIntrinsics::primesense();
        vec![
            base,
            CameraIntrinsics { distortion: Distortion::PlumbBob([0.1, -0.05, 0.001, -0.001, 0.01]), ..base },
            CameraIntrinsics {
                distortion: Distortion::Rational([0.1, -0.05, 0.001, -0.001, 0.01, 0.05, 0.0, 0.0]),
                ..base
            },
            CameraIntrinsics { distortion: Distortion::Fisheye([0.02, -0.01, 0.001, 0.0]), ..base },
        ]
    }

    proptest! {
        #[test]
        fn projecting_an_unprojected_pixel_gives_it_back(u in 0.0..639.0f64, v in 0.0..479.0f64, z in 0.2..10.0f64) {
            for camera in cameras() {
                let p = camera.ray(u, v);
                let q = camera.project(&Point3::from(p.coords * z)).unwrap();
                prop_assert!((q - Point2::new(u, v)).norm() < 1e-4, "{camera:?} {q}");
            }
        }
    }

    #[test]
    fn bad_intrinsics_are_named() {
        let bad = CameraIntrinsics { fx: 0.0, ..CameraIntrinsics::primesense() };
        assert!(matches!(bad.validate(), Err(GeometryError::OutOfRange { field: "fx", .. })));
    }
}
