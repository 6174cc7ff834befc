//! A frame against a rendered view: projective point-to-plane, coarse to fine.
//!
//! Source: Newcombe et al., "KinectFusion: real-time dense surface mapping and tracking", 2011, section
//! 3.5. We weight by the depth's noise, use Tukey's kernel, and leave degenerate directions to the
//! prediction (Zhang, Kaess, Singh 2016).

use super::frame::{Frame, Rigid32, Vertex, pixel};
use super::noise::sigma;
use super::photometric::Photometric;
use super::surfels::View;
use crate::odometry::{Found, Registration};
use crate::tracking::LostReason;
use nalgebra::{Matrix3, Matrix6, Vector3, Vector6};
use percept_geometry::{CameraIntrinsics, Covariance6, Pose, se3};
use percept_perception::registration::{Degeneracy, NormalEquations, accumulate};

/// Pixels a task: fixed, so that the number of threads changes nothing.
const CHUNK: usize = 4096;
/// Neighbouring pixels err alike (smoothing, calibration): so many count as one measurement. ATE of `evaluate rgbd
/// rgbd-7scenes-a`: halved 22.4, doubled 22.6 mm (22.6).
const PIXELS_PER_MEASUREMENT: f64 = 100.0;
/// Least mean squared sensitivity of a direction; noise of normals alone gives about 0.003. Twice that; ATE of
/// `evaluate rgbd` is 22.6 mm halved, doubled and as it is.
const DEGENERATE: f64 = 0.006;
/// The same of textured points: what lies within a few pixels shares blur, shine and edge. ATE of `evaluate rgbd
/// rgbd-7scenes-a`: halved 25.6, doubled 22.7 mm (22.6).
const POINTS_PER_MEASUREMENT: f64 = PIXELS_PER_MEASUREMENT;

/// One level: every `stride`-th row and column, correspondences up to `gate` metres.
pub(crate) struct Level {
    pub(crate) stride: usize,
    pub(crate) gate: f32,
    pub(crate) iterations: usize,
}

/// For a prediction that may be off by some centimetres and degrees.
pub(crate) const LEVELS: [Level; 3] = [
    Level { stride: 4, gate: 0.20, iterations: 12 },
    Level { stride: 2, gate: 0.08, iterations: 8 },
    Level { stride: 1, gate: 0.05, iterations: 6 },
];

/// What a frame must show to be placed.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Requirements {
    pub(crate) min_overlap: f64,
    pub(crate) min_inlier_ratio: f64,
    pub(crate) max_correction: (f64, f64),
}

pub(crate) struct Problem<'a> {
    pub(crate) frame: &'a Frame,
    pub(crate) view: &'a View,
    pub(crate) camera: &'a CameraIntrinsics,
    /// Where in the view's frame the search starts and the prediction is.
    pub(crate) start: Pose,
    /// Brightness, if model and frame have some.
    pub(crate) photometric: Option<Photometric<'a>>,
    /// Prediction of the camera's pose in odom, at which the view was rendered, and its covariance in
    /// the camera frame.
    pub(crate) covariance: Covariance6,
    /// Turns the camera's axes into base's, for the report.
    pub(crate) r_base_camera: Matrix3<f64>,
    pub(crate) requirements: Requirements,
    /// Coarse to fine.
    pub(crate) levels: &'a [Level],
    /// Pixels of the prepared image that one of the frame's stands for.
    pub(crate) pixels_each: f64,
}

/// Places the frame: `t_odom_base` of the result is the camera's pose in odom, covariance in the camera.
pub(crate) fn align(problem: &Problem<'_>) -> Result<Registration, LostReason> {
    let Some(prior) = problem.covariance.try_inverse() else { return Err(LostReason::Degenerate) };
    let mut t_view_camera = problem.start;
    let (mut scale, mut light_scale) = (3.0, 3.0);
    let mut iterations = 0;
    let mut last = None;
    for level in problem.levels {
        let told = told_by_both(problem, level, &t_view_camera);
        for _ in 0..level.iterations {
            let e = equations(problem, level, &t_view_camera, scale);
            let found = e.num_residuals;
            let needed = problem.requirements.min_overlap * sampled(problem.frame, level.stride);
            if (found as f64) < needed.max(100.0) {
                return Err(LostReason::TooFewCorrespondences);
            }
            let degeneracy = degeneracy(problem, &e, &told);
            let pull = se3::log(&(problem.start.inverse() * t_view_camera));
            let light = problem
                .photometric
                .as_ref()
                .map(|p| p.equations(problem.frame, problem.camera, &t_view_camera, level.stride, light_scale));
            let (step, information) =
                solve(&e, light.as_ref(), &degeneracy, &prior, &pull, (level.stride, problem.pixels_each))
                    .ok_or(LostReason::Degenerate)?;
            light_scale = light.map_or(3.0, |l| (l.rmse() * 2.0).clamp(1.0, 3.0));
            t_view_camera *= se3::exp(&step);
            iterations += 1;
            // Tukey's cut-off follows the residuals, from what the noise model says to three times that;
            // twice their root mean square, since the kernel has cut their tails already.
            scale = (e.rmse() * 2.0).clamp(1.0, 3.0);
            last = Some((e, degeneracy, information));
            let small = 2e-4 * level.stride as f64;
            if step.fixed_rows::<3>(0).norm() < small && step.fixed_rows::<3>(3).norm() < small {
                break;
            }
        }
    }
    let Some((e, degeneracy, information)) = last else { return Err(LostReason::TooFewPoints) };
    judge(problem, &t_view_camera, &e, &degeneracy, &information, iterations)
}

/// What frame and model tell together, in the same units: the information of residuals of which one half of each product is of the
/// frame's normals and the other of the model's.
///
/// Noise of normals makes a bare wall look as if it told where along it the camera is, whatever the noise is; that of the frame
/// has nothing to do with that of the model, and goes out of such products (as in instrumental variables, Söderström and Stoica,
/// "Instrumental variable methods for system identification", 1983).
fn told_by_both(problem: &Problem<'_>, level: &Level, t_view_camera: &Pose) -> NormalEquations {
    let (t, stride) = (Rigid32::from(t_view_camera), level.stride.max(LEVELS[0].stride));
    let (width, height) = (problem.frame.width / stride, problem.frame.height / stride);
    accumulate(width * height, CHUNK, |i, e| {
        let (u, v) = (i % width * stride, i / width * stride);
        let vertex = &problem.frame.vertices[v * problem.frame.width + u];
        let Some((model, noise)) = partner(problem, &t, vertex, level.gate) else { return };
        let of = |n: Vector3<f32>| {
            let m = vertex.p.cross(&n);
            Vector6::new(n.x, n.y, n.z, m.x, m.y, m.z).map(f64::from)
        };
        let (a, b) = (of(vertex.n / noise), of(t.r.tr_mul(&model.n) / noise));
        // a b' + b a' is half of what their sum tells less what their difference does.
        e.add(&(a + b).into(), 0.0, 0.25);
        e.add(&(a - b).into(), 0.0, -0.25);
    })
}

/// What depth leaves open: by the residuals, and by what is left of them without the noise of normals.
fn degeneracy(problem: &Problem<'_>, e: &NormalEquations, told: &NormalEquations) -> Degeneracy {
    let by_all = Degeneracy::of(e, &problem.frame.centroid, problem.frame.spread, DEGENERATE);
    let told = told.hessian();
    let all = told.fixed_view::<3, 3>(0, 0).trace();
    if all <= 0.0 {
        return by_all;
    }
    let by_both = |k: usize| by_all.direction(k).dot(&(told * by_all.direction(k))) / all;
    let eigenvalues = Vector6::from_fn(|k, _| by_all.eigenvalues[k].min(by_both(k)).max(0.0));
    by_all.with_eigenvalues(eigenvalues, DEGENERATE)
}

/// Adds up the level's residuals, in units of their noise.
fn equations(problem: &Problem<'_>, level: &Level, t_view_camera: &Pose, scale: f64) -> NormalEquations {
    let t = Rigid32::from(t_view_camera);
    let (width, height) = (problem.frame.width / level.stride, problem.frame.height / level.stride);
    let cut = (4.685 * scale) as f32;
    accumulate(width * height, CHUNK, |i, e| {
        let (u, v) = (i % width * level.stride, i / width * level.stride);
        let vertex = &problem.frame.vertices[v * problem.frame.width + u];
        if vertex.p.z > 0.0 {
            add(problem, &t, vertex, level.gate, cut, e);
        }
    })
}

/// What of the model lies where a point of the frame is seen, and the point's noise, metres; none if they are not of one surface.
#[inline]
fn partner<'a>(problem: &'a Problem<'_>, t: &Rigid32, v: &Vertex, gate: f32) -> Option<(&'a Vertex, f32)> {
    let moved = t.apply(&v.p);
    let model = &problem.view.vertices[pixel(problem.camera, &moved)?];
    if v.p.z <= 0.0 || model.p.z <= 0.0 {
        return None;
    }
    let (d, noise) = (moved - model.p, sigma(v.p.z));
    let gate = gate + 2.0 * noise;
    (d.norm_squared() <= gate * gate && (t.r * v.n).dot(&model.n) >= 0.7).then_some((model, noise))
}

#[inline]
fn add(problem: &Problem<'_>, t: &Rigid32, v: &Vertex, gate: f32, cut: f32, e: &mut NormalEquations) {
    let Some((model, noise)) = partner(problem, t, v, gate) else { return };
    let d = t.apply(&v.p) - model.p;
    let residual = model.n.dot(&d) / noise;
    let x = residual / cut;
    let kernel = if x.abs() < 1.0 { (1.0 - x * x) * (1.0 - x * x) } else { 0.0 };
    // n . R (v + w x p): see registration::factors::point_to_plane, here in single precision.
    let n = t.r.tr_mul(&model.n) / noise;
    let m = v.p.cross(&n);
    let j = [n.x, n.y, n.z, m.x, m.y, m.z].map(f64::from);
    e.add(&j, f64::from(residual), f64::from(kernel));
}

fn sampled(frame: &Frame, stride: usize) -> f64 {
    frame.num_valid as f64 / (stride * stride) as f64
}

/// The step and the information of measurement and prediction together.
fn solve(
    e: &NormalEquations,
    light: Option<&NormalEquations>,
    degeneracy: &Degeneracy,
    prior: &Matrix6<f64>,
    pull: &Vector6<f64>,
    (stride, pixels_each): (usize, f64),
) -> Option<(Vector6<f64>, Matrix6<f64>)> {
    let share = (stride * stride) as f64 * pixels_each / PIXELS_PER_MEASUREMENT;
    let variance = (e.cost / e.weight.max(1.0)).max(0.25);
    let h = degeneracy.keep_good(&e.hessian()) * (share / variance);
    let g = degeneracy.keep_good_gradient(&e.gradient()) * (share / variance);
    let (mut information, mut gradient) = (h + prior, g + prior * pull);
    if let Some(light) = light {
        let share =
            stride as f64 * pixels_each / POINTS_PER_MEASUREMENT / (light.cost / light.weight.max(1.0)).max(0.25);
        information += light.hessian() * share;
        gradient += light.gradient() * share;
    }
    let step = -information.cholesky()?.solve(&gradient);
    step.iter().all(|x| x.is_finite()).then_some((step, information))
}

fn judge(
    problem: &Problem<'_>,
    t_view_camera: &Pose,
    e: &NormalEquations,
    degeneracy: &Degeneracy,
    information: &Matrix6<f64>,
    iterations: usize,
) -> Result<Registration, LostReason> {
    let r = &problem.requirements;
    // Of the points that met the model, the share that Tukey's kernel kept, about three quarters for a fit.
    let inlier_ratio = e.weight / e.num_residuals.max(1) as f64;
    if inlier_ratio < r.min_inlier_ratio {
        return Err(LostReason::ResidualTooLarge);
    }
    if degeneracy.num_directions >= 5 && problem.photometric.is_none() {
        return Err(LostReason::Degenerate);
    }
    let correction = problem.start.inverse() * t_view_camera;
    let moved = (correction.translation.vector.norm(), correction.rotation.angle());
    if moved.0 > r.max_correction.0 || moved.1 > r.max_correction.1 {
        return Err(LostReason::MotionTooLarge);
    }
    let covariance = information.try_inverse().ok_or(LostReason::Degenerate)?;
    let noise = f64::from(sigma(problem.frame.mean_range as f32));
    Ok(Registration {
        t_odom_base: problem.view.t_odom_view * t_view_camera,
        covariance,
        inlier_ratio: e.num_residuals as f64 / problem.frame.num_valid.max(1) as f64,
        rmse_m: e.rmse() * noise,
        iterations,
        degenerate_axes: open_axes(problem, degeneracy, &covariance),
        told: None,
        found: Found::PoseAlone,
    })
}

/// Axes that depth leaves open and brightness does not fix either: the prediction was hardly sharpened there.
fn open_axes(problem: &Problem<'_>, degeneracy: &Degeneracy, covariance: &Covariance6) -> [bool; 6] {
    let turned = |c: &Covariance6| {
        let mut r = Matrix6::zeros();
        r.fixed_view_mut::<3, 3>(0, 0).copy_from(&problem.r_base_camera);
        r.fixed_view_mut::<3, 3>(3, 3).copy_from(&problem.r_base_camera);
        (r * c * r.transpose()).diagonal()
    };
    let (before, after) = (turned(&problem.covariance), turned(covariance));
    let open = degeneracy.axes_in(&problem.r_base_camera);
    std::array::from_fn(|k| open[k] && (problem.photometric.is_none() || after[k] > 0.25 * before[k]))
}
