//! A camera's pose among known points.

use super::p3p;
use super::ransac::{Problem, search};
use super::triangulate::jacobian;
use super::{MultiviewError, RansacParams, finite, same_length};
use nalgebra::{Matrix2x6, Matrix6, Point2, Point3, Vector3, Vector6};
use percept_geometry::{CameraIntrinsics, Covariance6, Pose, se3};

/// Where a camera is among known points.
#[derive(Debug, Clone, PartialEq)]
pub struct PnpEstimate {
    /// Camera (optical frame) in the world.
    pub t_world_camera: Pose,
    /// 6x6, order x, y, z, rotation x, y, z, right perturbation in the camera, for pixels off by the inliers' own error.
    pub covariance: Covariance6,
    /// Correspondences that fit, ascending.
    pub inliers: Vec<usize>,
    /// Root mean square of the inliers' reprojection errors, pixels.
    pub rmse_px: f64,
    /// Samples that were drawn.
    pub iterations: usize,
}

/// Three give up to four models; a fourth decides, a fifth has to agree.
const MIN_INLIERS: usize = 5;

/// Estimates the pose from world points and their pixels: three-point samples, scored by the reprojection error, refined
/// on their inliers by Gauss-Newton with Huber's weights.
///
/// # Errors
/// `Input` for parameters, intrinsics or lengths; `TooFew` below five finite pairs; `NoModel` if nothing fits five, or
/// these leave the pose open (all in a line).
pub fn solve_pnp(
    points: &[Point3<f64>],
    pixels: &[Point2<f64>],
    camera: &CameraIntrinsics,
    params: &RansacParams,
) -> Result<PnpEstimate, MultiviewError> {
    params.validate()?;
    camera.validate()?;
    same_length("pixels", points.len(), pixels.len())?;
    let is_finite = |p: &Point3<f64>| p.iter().all(|v| v.is_finite());
    let usable: Vec<usize> = (0..points.len()).filter(|&i| is_finite(&points[i]) && finite(&pixels[i])).collect();
    if usable.len() < MIN_INLIERS {
        return Err(MultiviewError::TooFew { got: usable.len(), needed: MIN_INLIERS });
    }
    let problem = Perspective {
        pairs: usable.iter().map(|&i| (points[i], pixels[i])).collect(),
        rays: usable.iter().map(|&i| camera.ray(pixels[i].x, pixels[i].y).coords.normalize()).collect(),
        camera,
        threshold: params.threshold_px,
    };
    let nothing = MultiviewError::NoModel { got: usable.len(), needed: MIN_INLIERS };
    let found = search(&problem, params).filter(|f| f.inliers.len() >= MIN_INLIERS).ok_or_else(|| nothing.clone())?;
    let (t_camera_world, information) = problem.gauss_newton(&found.model, &found.inliers, 5).ok_or(nothing)?;
    let squares: f64 = found.inliers.iter().map(|&i| problem.error2(&t_camera_world, i)).sum();
    let (n, threshold2) = (found.inliers.len() as f64, params.threshold_px * params.threshold_px);
    let variance = (squares * threshold2 / (2.0 * n - 6.0)).max(1e-12);
    let singular = MultiviewError::NoModel { got: usable.len(), needed: MIN_INLIERS };
    Ok(PnpEstimate {
        t_world_camera: t_camera_world.inverse(),
        covariance: information.try_inverse().ok_or(singular)? * variance,
        rmse_px: (squares / n).sqrt() * params.threshold_px,
        inliers: found.inliers.iter().map(|&i| usable[i]).collect(),
        iterations: found.iterations,
    })
}

struct Perspective<'a> {
    pairs: Vec<(Point3<f64>, Point2<f64>)>,
    rays: Vec<Vector3<f64>>,
    camera: &'a CameraIntrinsics,
    threshold: f64,
}

impl Perspective<'_> {
    /// `t_camera_world` refined on some pairs, and the information (by pixels off by 1) about the camera's pose, right
    /// perturbation of `t_world_camera`.
    fn gauss_newton(&self, start: &Pose, among: &[usize], rounds: usize) -> Option<(Pose, Matrix6<f64>)> {
        let mut t = *start;
        let mut information = Matrix6::zeros();
        for _ in 0..rounds {
            let (mut h, mut g) = (Matrix6::zeros(), Vector6::zeros());
            for &i in among {
                let (point, pixel) = &self.pairs[i];
                let p = t * point;
                let Some(seen) = self.camera.project(&p) else { continue };
                let error = seen - pixel;
                // t_world_camera exp(xi) moves the point in the camera by exp(-xi).
                let by_point = jacobian(self.camera, &p);
                let mut j = Matrix2x6::zeros();
                j.fixed_columns_mut::<3>(0).copy_from(&-by_point);
                j.fixed_columns_mut::<3>(3).copy_from(&(by_point * p.coords.cross_matrix()));
                let weight = (self.threshold * 0.5 / error.norm().max(1e-9)).min(1.0);
                h += j.transpose() * j * weight;
                g += j.transpose() * error * weight;
            }
            information = h;
            let step = h.cholesky()?.solve(&g);
            t = se3::exp(&step) * t;
            if !step.iter().all(|v| v.is_finite()) {
                return None;
            }
            if step.norm() < 1e-10 {
                break;
            }
        }
        Some((t, information))
    }
}

impl Problem for Perspective<'_> {
    /// `t_camera_world`.
    type Model = Pose;
    const SAMPLE: usize = 4;

    fn len(&self) -> usize {
        self.pairs.len()
    }

    fn solve(&self, sample: &[usize], out: &mut Vec<Pose>) {
        let points = [0, 1, 2].map(|k| self.pairs[sample[k]].0);
        let rays = [0, 1, 2].map(|k| self.rays[sample[k]]);
        p3p::poses(&points, &rays, out);
        // The fourth point tells which of them it is.
        let best =
            (0..out.len()).min_by(|&a, &b| self.error2(&out[a], sample[3]).total_cmp(&self.error2(&out[b], sample[3])));
        if let Some(best) = best {
            out.swap(0, best);
            out.truncate(1);
        }
    }

    #[inline]
    fn error2(&self, t_camera_world: &Pose, i: usize) -> f64 {
        let (point, pixel) = &self.pairs[i];
        match self.camera.project(&(t_camera_world * point)) {
            Some(seen) => (seen - pixel).norm_squared() / (self.threshold * self.threshold),
            None => f64::INFINITY,
        }
    }

    fn refine(&self, model: &Pose, inliers: &[usize]) -> Option<Pose> {
        self.gauss_newton(model, inliers, 3).map(|(t, _)| t)
    }
}
