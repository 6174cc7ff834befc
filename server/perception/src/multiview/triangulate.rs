//! A point seen by several cameras.

use super::{MultiviewError, finite, same_length};
use nalgebra::{Matrix2x3, Matrix3, Point2, Point3, Vector3};
use percept_geometry::{CameraIntrinsics, Pose};

/// A point from its pixels.
#[derive(Debug, Clone, PartialEq)]
pub struct TriangulatedPoint {
    /// World frame, in the unit of the poses.
    pub position: Point3<f64>,
    /// Of the position, for pixels that are off by one pixel (standard deviation, independent).
    pub covariance: Matrix3<f64>,
    /// Largest angle between two of the rays, radians. Below a degree or so the depth is hardly known.
    pub parallax_rad: f64,
    /// Root mean square of the reprojection errors, pixels.
    pub rmse_px: f64,
    /// Whether it lies in front of every camera.
    pub in_front: bool,
}

/// Triangulates one point from its pixel in each view: the point nearest to all rays, then Gauss-Newton on the
/// reprojection error. `t_world_camera[i]` is camera i in the world.
///
/// Source: Hartley and Sturm, "Triangulation", 1997.
///
/// # Errors
/// `Input` for lengths or intrinsics, `TooFew` below two finite pixels, `NoModel` if all rays are parallel.
pub fn triangulate(
    pixels: &[Point2<f64>],
    cameras: &[CameraIntrinsics],
    t_world_camera: &[Pose],
) -> Result<TriangulatedPoint, MultiviewError> {
    same_length("cameras", pixels.len(), cameras.len())?;
    same_length("t_world_camera", pixels.len(), t_world_camera.len())?;
    cameras.iter().try_for_each(CameraIntrinsics::validate)?;
    let views: Vec<View> = (0..pixels.len())
        .filter(|&i| finite(&pixels[i]))
        .map(|i| View { pixel: pixels[i], camera: cameras[i], t_camera_world: t_world_camera[i].inverse() })
        .collect();
    if views.len() < 2 {
        return Err(MultiviewError::TooFew { got: views.len(), needed: 2 });
    }
    let rays: Vec<(Point3<f64>, Vector3<f64>)> = views.iter().map(View::ray).collect();
    let start = nearest_to_rays(&rays).ok_or(MultiviewError::NoModel { got: views.len(), needed: 2 })?;
    let (position, information) = refine(start, &views);
    let covariance = information.try_inverse().ok_or(MultiviewError::NoModel { got: views.len(), needed: 2 })?;
    let mut parallax_rad: f64 = 0.0;
    for (i, (center_a, _)) in rays.iter().enumerate() {
        for (center_b, _) in &rays[i + 1..] {
            parallax_rad = parallax_rad.max((position - center_a).angle(&(position - center_b)));
        }
    }
    let errors = views.iter().filter_map(|v| v.error(&position));
    let squares: f64 = errors.map(|e| e.norm_squared()).sum();
    Ok(TriangulatedPoint {
        in_front: views.iter().all(|v| (v.t_camera_world * position).z > 0.0),
        rmse_px: (squares / views.len() as f64).sqrt(),
        position,
        covariance,
        parallax_rad,
    })
}

struct View {
    pixel: Point2<f64>,
    camera: CameraIntrinsics,
    t_camera_world: Pose,
}

impl View {
    /// Centre of the camera and direction of the pixel's ray, world frame.
    fn ray(&self) -> (Point3<f64>, Vector3<f64>) {
        let t_world_camera = self.t_camera_world.inverse();
        let direction = t_world_camera * self.camera.ray(self.pixel.x, self.pixel.y).coords.normalize();
        (Point3::from(t_world_camera.translation.vector), direction)
    }

    fn error(&self, p: &Point3<f64>) -> Option<nalgebra::Vector2<f64>> {
        Some(self.camera.project(&(self.t_camera_world * p))? - self.pixel)
    }
}

fn nearest_to_rays(rays: &[(Point3<f64>, Vector3<f64>)]) -> Option<Point3<f64>> {
    let (mut a, mut b) = (Matrix3::zeros(), Vector3::zeros());
    for (center, d) in rays {
        let across = Matrix3::identity() - d * d.transpose();
        a += across;
        b += across * center.coords;
    }
    // The smallest eigenvalue is n (1 - cos^2) for nearly parallel rays.
    let smallest = a.symmetric_eigenvalues().min();
    if smallest < 1e-12 {
        return None;
    }
    a.cholesky().map(|c| c.solve(&b).into())
}

/// The refined point and the information that the pixels give about it.
fn refine(start: Point3<f64>, views: &[View]) -> (Point3<f64>, Matrix3<f64>) {
    let mut point = start;
    let mut information = Matrix3::zeros();
    for _ in 0..5 {
        let (mut h, mut g) = (Matrix3::zeros(), Vector3::zeros());
        for view in views {
            let Some(error) = view.error(&point) else { continue };
            let j = jacobian(&view.camera, &(view.t_camera_world * point))
                * view.t_camera_world.rotation.to_rotation_matrix().matrix();
            h += j.transpose() * j;
            g += j.transpose() * error;
        }
        information = h;
        let Some(step) = h.cholesky().map(|c| c.solve(&g)) else { break };
        if !step.iter().all(|v| v.is_finite()) {
            break;
        }
        point -= step;
        if step.norm() < 1e-10 * (1.0 + point.coords.norm()) {
            break;
        }
    }
    (point, information)
}

/// Of the pixel by the point in the optical frame; the lens's distortion is left out, which bends it little.
pub(super) fn jacobian(camera: &CameraIntrinsics, p: &Point3<f64>) -> Matrix2x3<f64> {
    let w = 1.0 / p.z;
    Matrix2x3::new(camera.fx * w, 0.0, -camera.fx * p.x * w * w, 0.0, camera.fy * w, -camera.fy * p.y * w * w)
}
