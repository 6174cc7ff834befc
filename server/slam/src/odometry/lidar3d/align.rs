//! A thinned sweep against the map of Gaussians: point to plane, point to distribution where there is
//! no plane, coarse map first.
//!
//! Source: Vizzo et al., "KISS-ICP: in defense of point-to-point ICP", 2023 (adaptive threshold, robust
//! kernel, local map); Koide et al., "Voxelized GICP for fast and accurate 3D point cloud registration",
//! 2021 (one Gaussian a voxel). We narrow the kernel from the expected error to the surfaces' noise while
//! iterating, and leave degenerate directions to the prediction (Zhang, Kaess, Singh 2016).

use super::voxels::{GaussianMap, Shape};
use crate::odometry::{Match, Prediction};
use crate::tracking::LostReason;
use nalgebra::{Matrix3, Matrix6, Point3, Vector3, Vector6};
use percept_geometry::{Pose, se3};
use percept_perception::registration::factors::{point_to_plane, point_to_point};
use percept_perception::registration::{Degeneracy, NormalEquations, RobustKernel, accumulate};

/// Points a task: fixed, so that the number of threads changes nothing.
const CHUNK: usize = 1024;
/// Neighbouring points err alike (voxels share a plane): so many count as one measurement.
const POINTS_PER_MEASUREMENT: f64 = 10.0;
/// Least share of a direction in the points' sensitivity.
const DEGENERATE: f64 = 0.004;

pub(crate) struct Problem<'a> {
    /// Thinned sweep in base.
    pub(crate) points: &'a [Point3<f32>],
    pub(crate) fine: &'a GaussianMap,
    pub(crate) coarse: &'a GaussianMap,
    pub(crate) prediction: &'a Prediction,
    /// Expected error of the prediction at the points, metres.
    pub(crate) expected_error: f64,
    pub(crate) max_iterations: usize,
    pub(crate) min_overlap: f64,
    pub(crate) min_inlier_ratio: f64,
}

pub(crate) fn align(problem: &Problem<'_>) -> Result<Match, LostReason> {
    let Some(prior) = problem.prediction.covariance.try_inverse() else { return Err(LostReason::Degenerate) };
    let (centroid, spread) = extent(problem.points);
    let mut t = problem.prediction.t_odom_base;
    let mut iterations = 0;
    let mut last = None;
    let size = problem.fine.size();
    // Coarse voxels while the error may exceed a fine one; then fine ones, narrowing.
    let finest = 0.08 * size;
    let stages = [
        (problem.coarse, 4, (0.5 * problem.expected_error).max(0.5 * size), 0.5 * size, 8),
        (problem.fine, 1, (0.5 * problem.expected_error).clamp(finest, 0.5 * size), finest, problem.max_iterations),
    ];
    for (map, stride, start, end, rounds) in stages {
        let mut scale = start;
        for _ in 0..rounds {
            let e = equations(problem, map, stride, &t, scale);
            let needed = problem.min_overlap * (problem.points.len() / stride) as f64;
            if (e.num_residuals as f64) < needed.max(30.0) {
                return Err(LostReason::TooFewCorrespondences);
            }
            let degeneracy = Degeneracy::of(&e, &centroid, spread, DEGENERATE);
            let pull = se3::log(&(problem.prediction.t_odom_base.inverse() * t));
            let (step, information) = solve(&e, &degeneracy, &prior, &pull, stride).ok_or(LostReason::Degenerate)?;
            t *= se3::exp(&step);
            iterations += 1;
            last = Some((e, degeneracy, information));
            let moved = step.fixed_rows::<3>(0).norm() + spread * step.fixed_rows::<3>(3).norm();
            if moved < 0.1 * scale.min(0.02 * size) && scale <= end {
                break;
            }
            scale = (scale * 0.6).max(end);
        }
    }
    let Some((e, degeneracy, information)) = last else { return Err(LostReason::TooFewPoints) };
    judge(problem, &t, &e, &degeneracy, &information, iterations)
}

fn equations(problem: &Problem<'_>, map: &GaussianMap, stride: usize, t: &Pose, scale: f64) -> NormalEquations {
    let r = *t.rotation.to_rotation_matrix().matrix();
    let kernel = RobustKernel::GemanMcClure(3.0 * scale);
    accumulate(problem.points.len() / stride, CHUNK, |i, e| {
        let p = problem.points[i * stride].cast::<f64>();
        let moved = Point3::from(r * p.coords + t.translation.vector);
        let Some(voxel) = map.at(&moved) else { return };
        match voxel.shape {
            Shape::Plane(normal, variance) => {
                let (residual, j) = point_to_plane::residual(&r, &p.coords, &moved.coords, &voxel.mean.coords, &normal);
                e.add(&j, residual, kernel.weight(residual) / (variance + 0.25 * scale * scale));
            }
            Shape::Scatter(information) => add_scatter(e, &r, &p.coords, &moved, &voxel.mean, &information, scale),
            Shape::Unknown => {}
        }
    })
}

/// Offsets from the mean count by their axes' own information; cross terms are left out.
fn add_scatter(
    e: &mut NormalEquations,
    r: &Matrix3<f64>,
    p: &Vector3<f64>,
    moved: &Point3<f64>,
    mean: &Point3<f64>,
    information: &Matrix3<f64>,
    scale: f64,
) {
    let d = moved - mean;
    let distance2 = d.dot(&(information * d));
    let weight = 0.25 / (1.0 + distance2).powi(2);
    let rows = point_to_point::residuals(r, p, &moved.coords, &mean.coords);
    for (i, (residual, j)) in rows.into_iter().enumerate() {
        e.add(&j, residual, weight / (1.0 / information[(i, i)] + 0.25 * scale * scale));
    }
}

fn solve(
    e: &NormalEquations,
    degeneracy: &Degeneracy,
    prior: &Matrix6<f64>,
    pull: &Vector6<f64>,
    stride: usize,
) -> Option<(Vector6<f64>, Matrix6<f64>)> {
    let share = stride as f64 / POINTS_PER_MEASUREMENT;
    let h = degeneracy.keep_good(&e.hessian()) * share;
    let g = degeneracy.keep_good_gradient(&e.gradient()) * share;
    let information = h + prior;
    let step = -information.cholesky()?.solve(&(g + prior * pull));
    step.iter().all(|x| x.is_finite()).then_some((step, information))
}

fn judge(
    problem: &Problem<'_>,
    t: &Pose,
    e: &NormalEquations,
    degeneracy: &Degeneracy,
    information: &Matrix6<f64>,
    iterations: usize,
) -> Result<Match, LostReason> {
    let (overlap, close) = fit(problem, t);
    if close < problem.min_inlier_ratio * overlap {
        return Err(LostReason::ResidualTooLarge);
    }
    if degeneracy.num_directions >= 5 {
        return Err(LostReason::Degenerate);
    }
    Ok(Match {
        t_odom_base: *t,
        covariance: information.try_inverse().ok_or(LostReason::Degenerate)?,
        inlier_ratio: close,
        rmse_m: e.rmse(),
        iterations,
        degenerate_axes: degeneracy.axes,
    })
}

/// Shares of the points that meet a plane, and that lie within a sixth of a voxel of it.
fn fit(problem: &Problem<'_>, t: &Pose) -> (f64, f64) {
    let (mut met, mut close, mut all) = (0.0, 0.0, 0.0);
    for p in problem.points.iter().step_by(4) {
        all += 1.0;
        let p = t * p.cast::<f64>();
        if let Some(v) = problem.fine.at(&p) {
            met += 1.0;
            let near = match v.shape {
                Shape::Plane(normal, variance) => {
                    normal.dot(&(p - v.mean)).abs() < problem.fine.size() / 6.0 + 2.0 * variance.sqrt()
                }
                _ => true,
            };
            close += f64::from(u8::from(near));
        }
    }
    (met / f64::max(all, 1.0), close / f64::max(all, 1.0))
}

/// Mean of the points, and root mean square distance from it.
fn extent(points: &[Point3<f32>]) -> (Vector3<f64>, f64) {
    let (mut sum, mut squares) = (Vector3::zeros(), 0.0);
    for p in points {
        let p = p.coords.cast::<f64>();
        sum += p;
        squares += p.norm_squared();
    }
    let n = points.len().max(1) as f64;
    let centroid = sum / n;
    (centroid, (squares / n - centroid.norm_squared()).max(0.0).sqrt())
}
