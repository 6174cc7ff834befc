//! Brightness of the model against the frame's: what fixes motion along smooth surfaces.
//!
//! Source: Steinbruecker, Sturm, Cremers, "Real-time visual odometry from dense RGB-D images", 2011, and
//! Whelan et al., "ElasticFusion", 2015, section III.B. We take the model's points, not pixels, into the
//! live image, whose gradient is sharp, and use those alone that have texture around them.

use super::frame::{Frame, Rigid32, pixel};
use super::intensity::Intensity;
use super::noise::sigma;
use crate::color_camera::ColorCamera;
use nalgebra::Vector3;
use percept_geometry::{CameraIntrinsics, Pose};
use percept_perception::registration::{NormalEquations, accumulate};

/// Points a task: fixed, so that the number of threads changes nothing.
const CHUNK: usize = 2048;
/// Brightness of one place differs so much between views by noise, blur and shine (1 is a factor of e). ATE of
/// `evaluate rgbd rgbd-7scenes-a 2`: halved 22.4, doubled 22.3 mm (22.3).
pub(crate) const NOISE: f32 = 0.06;
/// Less change than this to the next pixel is noise. ATE of `evaluate rgbd rgbd-7scenes-a 2`: halved 21.7, doubled 23.8
/// mm (22.3).
pub(crate) const MIN_CONTRAST: f32 = 0.03;

/// Fewer textured points say too little. ATE of `evaluate rgbd rgbd-7scenes-a 2` is 22.3 mm halved, doubled and as it
/// is.
pub(crate) const MIN_POINTS: usize = 200;

/// A textured point of the model in the view's frame.
#[derive(Debug, Clone, Copy)]
pub(crate) struct TexturedPoint {
    pub(crate) p: Vector3<f32>,
    pub(crate) intensity: f32,
}

/// What brightness is compared with.
pub(crate) struct Photometric<'a> {
    pub(crate) intensity: &'a Intensity,
    pub(crate) color: ColorCamera,
    pub(crate) points: &'a [TexturedPoint],
}

impl Photometric<'_> {
    /// Adds up the residuals of every `stride`-th point, in units of their noise, as a right perturbation
    /// of `t_view_camera`.
    pub(crate) fn equations(
        &self,
        frame: &Frame,
        camera: &CameraIntrinsics,
        t_view_camera: &Pose,
        stride: usize,
        scale: f64,
    ) -> NormalEquations {
        let t_camera_view = Rigid32::from(&t_view_camera.inverse());
        let cut = (4.685 * scale) as f32;
        accumulate(self.points.len() / stride, CHUNK, |i, e| {
            let point = &self.points[i * stride];
            let q = t_camera_view.apply(&point.p);
            if q.z > 0.1 && is_there(frame, camera, &q) {
                self.add(point.intensity, &q, cut, e);
            }
        })
    }

    /// How the brightness of the points in sight goes with the image's, -1 to 1, whatever the exposure: near 0 where the image
    /// shows another place, however alike its surfaces are. None if too few are in sight.
    pub(crate) fn correlation(&self, frame: &Frame, camera: &CameraIntrinsics, t_view_camera: &Pose) -> Option<f64> {
        let t_camera_view = Rigid32::from(&t_view_camera.inverse());
        let seen = self.points.iter().filter_map(|point| {
            let q = t_camera_view.apply(&point.p);
            let (u, v) = self.color.project(&q);
            let s = (q.z > 0.1 && is_there(frame, camera, &q)).then(|| self.intensity.sample(u, v))??;
            Some((f64::from(point.intensity), f64::from(s.value)))
        });
        let (mut n, mut sum, mut squares) = (0usize, (0.0, 0.0), (0.0, 0.0, 0.0));
        for (a, b) in seen {
            n += 1;
            sum = (sum.0 + a, sum.1 + b);
            squares = (squares.0 + a * a, squares.1 + a * b, squares.2 + b * b);
        }
        let count = n as f64;
        let variances = (squares.0 - sum.0 * sum.0 / count, squares.2 - sum.1 * sum.1 / count);
        let both = squares.1 - sum.0 * sum.1 / count;
        let scale = (variances.0 * variances.1).sqrt();
        (n >= MIN_POINTS && scale > 0.0).then(|| both / scale)
    }

    #[inline]
    fn add(&self, expected: f32, q: &Vector3<f32>, cut: f32, e: &mut NormalEquations) {
        let (u, v) = self.color.project(q);
        let Some(s) = self.intensity.sample(u, v) else { return };
        let residual = (s.value - expected) / NOISE;
        let x = residual / cut;
        let kernel = if x.abs() < 1.0 { (1.0 - x * x) * (1.0 - x * x) } else { 0.0 };
        let w = 1.0 / q.z;
        let (gx, gy) = (s.du * self.color.fx * w / NOISE, s.dv * self.color.fy * w / NOISE);
        let gz = -(gx * (q.x + self.color.bx / self.color.fx) + gy * q.y) * w;
        // q = t_camera_view p moves by -(v + w x q), so the residual by -(g . v + (q x g) . w).
        let g = Vector3::new(-gx, -gy, -gz);
        let m = q.cross(&g);
        e.add(&[g.x, g.y, g.z, m.x, m.y, m.z].map(f64::from), f64::from(residual), f64::from(kernel));
    }
}

/// Whether the frame, where it has depth, sees the point: nothing nearer, nothing behind it, nothing that moves.
#[inline]
fn is_there(frame: &Frame, camera: &CameraIntrinsics, q: &Vector3<f32>) -> bool {
    pixel(camera, q).is_none_or(|i| {
        let z = frame.vertices[i].p.z;
        z == 0.0 || (z - q.z).abs() < 0.03 + 4.0 * sigma(q.z)
    })
}
