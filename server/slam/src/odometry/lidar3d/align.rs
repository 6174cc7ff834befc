//! A thinned sweep against the map of Gaussians: point to plane, point to distribution where there is
//! no plane, coarse map first.
//!
//! Source: Vizzo et al., "KISS-ICP: in defense of point-to-point ICP", 2023 (adaptive threshold, robust
//! kernel, local map); Koide et al., "Voxelized GICP for fast and accurate 3D point cloud registration",
//! 2021 (one Gaussian a voxel). We narrow the kernel from the expected error to the surfaces' noise while
//! iterating, and leave degenerate directions to the prediction (Zhang, Kaess, Singh 2016).

use super::levels::Levels;
use super::meeting::{Meeting, Weak};
use super::sweep::{Motion, Sweep};
use super::voxels::Shape;
use crate::inertial::PoseFactor;
use crate::motion_noise::HANDS;
use crate::odometry::{Found, OdometryKind, OdometryNoise, Prediction, Registration};
use crate::tracking::LostReason;
use nalgebra::{Matrix3, Matrix6, Point3, SMatrix, SVector, Vector3, Vector6};
use percept_geometry::{Pose, se3};
use percept_perception::registration::{Degeneracy, NormalEquations, RobustKernel};
use rayon::prelude::*;

/// Groups of points a task: fixed, so that the number of threads changes nothing.
const GROUPS: usize = 8;
/// Neighbouring points err alike (voxels share a plane): so many count as one measurement. Halved 11.8 and 8.8, doubled
/// 11.6 and 11.9 ([`super`]).
const POINTS_PER_MEASUREMENT: f64 = 10.0;
/// Least share of a direction in the points' sensitivity. Halved 11.7 and 9.9, doubled 11.8 and 9.9 ([`super`]); a
/// quarter of what [`WEAK`](super::meeting) is, where corridors begin.
const DEGENERATE: f64 = 0.004;
/// A wall whose voxels are tilted by noise seems to fix motion along it: so many times what noise alone brings. Halved
/// 11.7 and 9.9, doubled 11.9 and 9.9 ([`super`]), with 0.27 instead of 0.19 degrees told on the second: more axes are
/// open then.
const TILTED: f64 = 4.0;
/// The velocity during a sweep may differ from what was expected by what [`HANDS`] do, a share of which is learned
/// ([`agility`]), and by so much at least, m/s and rad/s. `evaluate lidar-sim spinning seconds=30`: halved 3.5, doubled
/// 3.7 mm (3.6).
const LEAST_CHANGE: (f64, f64) = (0.02, 0.01);
/// Where nothing tells a velocity it comes back to rest, as hands and bumps do: its standard deviation in the long run,
/// m/s and rad/s. What moves faster is thought to go on moving as fast. `evaluate lidar-sim spinning seconds=30`:
/// halved 3.5, doubled 3.6 mm (3.6).
const REST: (f64, f64) = (0.5, 1.2);

type Matrix12 = SMatrix<f64, 12, 12>;
type Vector12 = SVector<f64, 12>;

pub(crate) struct Problem<'a> {
    /// Thinned sweep.
    pub(crate) sweep: &'a Sweep,
    pub(crate) map: &'a Levels,
    pub(crate) prediction: &'a Prediction,
    /// Expected velocity of base during the sweep, m/s and rad/s.
    pub(crate) velocity: Vector6<f64>,
    /// How fast velocities change here, as a share of what hands do.
    pub(crate) agility: f64,
    /// Expected error of the prediction at the points, metres.
    pub(crate) expected_error: f64,
    pub(crate) max_iterations: usize,
    pub(crate) min_overlap: f64,
    pub(crate) min_inlier_ratio: f64,
}

impl Problem<'_> {
    /// Seconds in which the velocity may have changed.
    pub(crate) fn elapsed(&self) -> f64 {
        self.prediction.elapsed_s.max(self.sweep.instants().duration())
    }
}

/// Where base was at the stamp, and how it moved while the points were taken.
#[derive(Debug, Clone)]
pub(crate) struct State {
    pub(crate) t_odom_base: Pose,
    pub(crate) velocity: Vector6<f64>,
}

/// The equations of both: of the pose alone, and with the velocity.
struct Equations {
    pose: NormalEquations,
    /// Mean variance of the planes' tilts, rad^2.
    tilt: f64,
    all: Told,
    /// Of the planes that face an open direction.
    facing: Told,
    /// Of each direction that was weak, what planes tell that face it, 1/m^2.
    weak: Vector6<f64>,
}

impl Equations {
    /// Which directions are open, if of those that are told weakly only what planes tell counts that face them. Planes that
    /// face elsewhere tell a little each, by normals that are off: all by the same where rings graze walls, and then along with
    /// the robot. Source: Tuna et al., "X-ICP", 2022 (contributions by their alignment with the direction).
    fn well_told(&self, degeneracy: Degeneracy, weak: &Weak, threshold: f64) -> Degeneracy {
        let all = self.pose.hessian().fixed_view::<3, 3>(0, 0).trace();
        let mut eigenvalues = degeneracy.eigenvalues;
        for (value, told) in eigenvalues.iter_mut().zip(&self.weak).take(weak.len()) {
            *value = value.min(told / all);
        }
        degeneracy.with_eigenvalues(eigenvalues, threshold)
    }
}

/// Places the sweep: the pose, and the motion during the sweep.
pub(crate) fn align(problem: &Problem<'_>) -> Result<(Registration, State), LostReason> {
    align_and_tell(problem).map(|(found, state, _)| (found, state))
}

/// The same, and what the sweep told of the pose by itself.
pub(crate) fn align_and_tell(problem: &Problem<'_>) -> Result<(Registration, State, PoseFactor), LostReason> {
    let prior = prior(problem).ok_or(LostReason::Degenerate)?;
    let (centroid, spread) = extent(&problem.sweep.at_stamp(&problem.velocity));
    let mut state = State { t_odom_base: problem.prediction.t_odom_base, velocity: problem.velocity };
    let mut iterations = 0;
    let mut last = None;
    let (mut open, mut weak) = (None, Weak::default());
    let size = problem.map.size();
    // Coarse voxels while the error may exceed a fine one; then fine ones, narrowing.
    let finest = 0.08 * size;
    let stages = [
        (true, 4, (0.5 * problem.expected_error).max(0.5 * size), 0.5 * size, 8),
        (false, 1, (0.5 * problem.expected_error).clamp(finest, 0.5 * size), finest, problem.max_iterations),
    ];
    for (coarse, stride, start, end, rounds) in stages {
        let mut scale = start;
        for _ in 0..rounds {
            let e = equations(problem, coarse, stride, &state, scale, (open.as_ref(), &weak));
            let needed = problem.min_overlap * (problem.sweep.len() / stride) as f64;
            if (e.pose.num_residuals as f64) < needed.max(30.0) {
                return Err(LostReason::TooFewCorrespondences);
            }
            let threshold = DEGENERATE + TILTED * e.tilt;
            let degeneracy = Degeneracy::of(&e.pose, &centroid, spread, threshold);
            let now_weak = Weak::of(&degeneracy);
            let is_looked_at = now_weak.len() <= weak.len();
            let degeneracy = e.well_told(degeneracy, &weak, threshold);
            weak = now_weak;
            let expected = expected(problem, &prior, &state);
            let share = stride as f64 / POINTS_PER_MEASUREMENT;
            let told = match problem.prediction.inertial {
                Some(_) => told_beside_inertia(&e, &degeneracy, share),
                None => told(&e, &degeneracy, share),
            };
            open = problem.prediction.inertial.as_ref().map(|_| degeneracy.open_translations());
            let (step, information) = solve(&told, &expected).ok_or(LostReason::Degenerate)?;
            let (moved, faster) = (step.fixed_rows::<6>(0).into_owned(), step.fixed_rows::<6>(6).into_owned());
            state.t_odom_base *= se3::exp(&moved);
            state.velocity += faster;
            iterations += 1;
            last = Some((e.pose, degeneracy, information, told.after(&step), expected));
            let at_points = |v: &Vector6<f64>| v.fixed_rows::<3>(0).norm() + spread * v.fixed_rows::<3>(3).norm();
            let duration = problem.sweep.instants().duration();
            let change = at_points(&moved) + 0.5 * duration * at_points(&faster);
            if change < 0.1 * scale.min(0.02 * size) && scale <= end && is_looked_at {
                break;
            }
            scale = (scale * 0.6).max(end);
        }
    }
    let Some((e, degeneracy, information, told, expected)) = last else { return Err(LostReason::TooFewPoints) };
    let found = judge(problem, &state, &e, &degeneracy, &information, iterations)?;
    let seen = told.of_pose(&state, &expected).ok_or(LostReason::Degenerate)?;
    Ok((found, state, seen))
}

/// How far the velocity of a sweep was from what was expected `elapsed` seconds before, as a share of what hands do.
pub(crate) fn agility(elapsed: f64, change: &Vector6<f64>) -> f64 {
    let share = |k: usize, (rate, least): (f64, f64)| change.fixed_rows::<3>(k).norm() / (rate * elapsed + least);
    share(0, (HANDS.0, LEAST_CHANGE.0)).max(share(3, (HANDS.1, LEAST_CHANGE.1)))
}

/// Information of the prediction and of the expected velocity.
fn prior(problem: &Problem<'_>) -> Option<Matrix12> {
    if let Some(inertial) = &problem.prediction.inertial {
        return inertial.covariance.try_inverse();
    }
    let elapsed = problem.elapsed();
    let information = |(rate, least): (f64, f64)| 1.0 / (problem.agility * (rate * elapsed + least)).powi(2);
    let moving = information((HANDS.0, LEAST_CHANGE.0));
    let turning = information((HANDS.1, LEAST_CHANGE.1));
    let mut out = Matrix12::zeros();
    out.fixed_view_mut::<6, 6>(0, 0).copy_from(&problem.prediction.covariance.try_inverse()?);
    for k in 0..3 {
        (out[(6 + k, 6 + k)], out[(9 + k, 9 + k)]) = (moving, turning);
    }
    Some(out)
}

/// Information and gradient of how far the state is from what was expected, of its velocity, and of how far that is from
/// the step that it makes: what the points of one sweep hardly tell, its poses tell over the sweeps.
/// Source: Dellenbach et al., "CT-ICP", 2022 (location consistency); here between a sweep's velocity and its pose.
fn expected(problem: &Problem<'_>, prior: &Matrix12, state: &State) -> (Matrix12, Vector12) {
    let mut off = Vector12::zeros();
    off.fixed_rows_mut::<6>(0).copy_from(&se3::log(&problem.prediction.t_odom_base.inv_mul(&state.t_odom_base)));
    off.fixed_rows_mut::<6>(6).copy_from(&(state.velocity - problem.velocity));
    let (mut h, mut g) = (*prior, prior * off);
    if problem.prediction.inertial.is_some() {
        // The velocity is what is left of a motion that was felt, and its errors are part of the prior.
        return (h, g);
    }
    for (from, sigma) in [(0, REST.0), (3, REST.1)] {
        let fast2 = problem.velocity.fixed_rows::<3>(from).norm_squared();
        let information = 1.0 / (sigma * sigma + fast2);
        for k in from..from + 3 {
            h[(6 + k, 6 + k)] += information;
            g[6 + k] += information * state.velocity[k];
        }
    }
    let (dt, is_sweep) = (problem.prediction.elapsed_s, problem.sweep.instants().duration() > 0.0);
    let Some(before) = problem.prediction.t_odom_before.filter(|_| is_sweep && dt > 1e-3) else { return (h, g) };
    let misfit = state.velocity - se3::log(&before.inv_mul(&state.t_odom_base)) / dt;
    let at_once = OdometryNoise::of(OdometryKind::Lidar3d).at_once();
    // The step's velocity is that of its middle, the sweep's that of the sweep's.
    let apart = (problem.sweep.instants().middle() + 0.5 * dt).abs();
    for k in 0..6 {
        let (rate, least, step) = match k {
            0..3 => (HANDS.0, LEAST_CHANGE.0, at_once.0),
            _ => (HANDS.1, LEAST_CHANGE.1, at_once.1),
        };
        let information = 1.0 / (problem.agility * rate * apart + least + step / dt).powi(2);
        h[(k, k)] += information / (dt * dt);
        h[(k, 6 + k)] -= information / dt;
        h[(6 + k, k)] -= information / dt;
        h[(6 + k, 6 + k)] += information;
        g[k] -= information * misfit[k] / dt;
        g[6 + k] += information * misfit[k];
    }
    (h, g)
}

/// Sums over the sweep, group by group: a point taken `t` seconds after the stamp moves with the velocity `t` times as
/// it does with the pose. Source: Dellenbach et al., "CT-ICP", 2022 (a sweep's begin and end are both estimated); we
/// take pose and velocity, and let the sweeps be discontinuous.
fn equations(
    problem: &Problem<'_>,
    coarse: bool,
    stride: usize,
    state: &State,
    scale: f64,
    (open, weak): (Option<&Matrix3<f64>>, &Weak),
) -> Equations {
    let sweep = problem.sweep;
    let motions = sweep.instants().motions(&state.velocity);
    let t = Motion::of(&state.t_odom_base);
    let kernel = RobustKernel::GemanMcClure(3.0 * scale);
    let clock = problem.map.clock();
    let of_group = |g: usize| {
        let (mut e, mut facing, mut tilt) = (NormalEquations::default(), NormalEquations::default(), 0.0);
        let mut told = Vector6::zeros();
        let (first, points) = sweep.group(g);
        for p in points.iter().skip(first.next_multiple_of(stride) - first).step_by(stride) {
            let p = motions[g].apply(p);
            let moved = Point3::from(t.rotation * p.coords + t.translation);
            let voxel = if coarse { problem.map.coarse(&moved) } else { problem.map.at(&moved) };
            let Some(voxel) = voxel else { continue };
            let stale = voxel.stale(&clock);
            let met = Meeting { voxel, r: &t.rotation, p: &p.coords, moved: &moved, kernel: &kernel, scale, stale };
            met.add_to(&mut e);
            met.tell(weak, &mut told);
            tilt += voxel.tilt;
            if open.is_some_and(|open| met.faces(open)) {
                met.add_to(&mut facing);
            }
        }
        (e, facing, tilt, told)
    };
    let parts: Vec<(NormalEquations, NormalEquations, f64, Vector6<f64>)> =
        (0..motions.len()).into_par_iter().with_min_len(GROUPS).map(of_group).collect();
    let mut out = Equations {
        pose: NormalEquations::default(),
        tilt: 0.0,
        all: Told::nothing(),
        facing: Told::nothing(),
        weak: Vector6::zeros(),
    };
    for ((part, facing, tilt, told), &time) in parts.iter().zip(sweep.instants().times()) {
        out.pose.merge(part);
        out.tilt += tilt;
        out.weak += told;
        out.all.add(part, time);
        if facing.num_residuals > 0 {
            out.facing.add(facing, time);
        }
    }
    // A scatter adds three residuals: the mean is a little too small, which is the safe side of nothing much.
    out.tilt /= out.pose.num_residuals.max(1) as f64;
    out
}

/// What points tell of pose and velocity.
struct Told {
    information: Matrix12,
    gradient: Vector12,
}

/// What the points tell, without the directions that they leave open.
fn told(e: &Equations, degeneracy: &Degeneracy, share: f64) -> Told {
    e.all.each(|h| degeneracy.keep_good(h) * share, |g| degeneracy.keep_good_gradient(g) * share)
}

/// The same for one whom inertia carries on where the scene is open. What walls seem to tell of the way along them is left
/// out altogether: it comes back from a map that was made where the prediction was, time and again, and would pass for
/// knowledge. What few planes tell that face the open direction, as the end of a corridor does, is kept.
fn told_beside_inertia(e: &Equations, degeneracy: &Degeneracy, share: f64) -> Told {
    if degeneracy.num_directions == 0 {
        return e.all.each(|h| h * share, |g| g * share);
    }
    let (fixed, open) = degeneracy.parts();
    let part = |told: &Told, p: &Matrix6<f64>| told.each(|h| p.transpose() * h * p * share, |g| p.tr_mul(g) * share);
    let (most, rest) = (part(&e.all, &fixed), part(&e.facing, &open));
    Told { information: most.information + rest.information, gradient: most.gradient + rest.gradient }
}

impl Told {
    fn nothing() -> Self {
        Self { information: Matrix12::zeros(), gradient: Vector12::zeros() }
    }

    /// Adds what points tell that were taken `time` seconds after the stamp.
    fn add(&mut self, points: &NormalEquations, time: f64) {
        let (h, g) = (points.hessian(), points.gradient());
        for (i, factor) in [1.0, time].into_iter().enumerate() {
            for (j, other) in [1.0, time].into_iter().enumerate() {
                let mut block = self.information.fixed_view_mut::<6, 6>(6 * i, 6 * j);
                block += h * (factor * other);
            }
            let mut block = self.gradient.fixed_rows_mut::<6>(6 * i);
            block += g * factor;
        }
    }

    /// The same with its blocks of pose and velocity changed alike.
    fn each(&self, h: impl Fn(&Matrix6<f64>) -> Matrix6<f64>, g: impl Fn(&Vector6<f64>) -> Vector6<f64>) -> Self {
        let mut out = Self::nothing();
        for i in [0, 6] {
            for j in [0, 6] {
                let block = h(&self.information.fixed_view::<6, 6>(i, j).into_owned());
                out.information.fixed_view_mut::<6, 6>(i, j).copy_from(&block);
            }
            out.gradient.fixed_rows_mut::<6>(i).copy_from(&g(&self.gradient.fixed_rows::<6>(i).into_owned()));
        }
        out
    }

    /// The same around the state after a step.
    fn after(self, step: &Vector12) -> Self {
        Self { gradient: self.gradient + self.information * step, ..self }
    }

    /// Of the pose alone, whatever the velocity, of which only what was expected is known besides.
    fn of_pose(&self, state: &State, (h, g): &(Matrix12, Vector12)) -> Option<PoseFactor> {
        let block = |m: &Matrix12, i: usize, j: usize| m.fixed_view::<6, 6>(i, j).into_owned();
        let (hp, hpv) = (block(&self.information, 0, 0), block(&self.information, 0, 6));
        let velocity = (block(&self.information, 6, 6) + block(h, 6, 6)).cholesky()?;
        let pulled = self.gradient.fixed_rows::<6>(6) + g.fixed_rows::<6>(6);
        let information = hp - hpv * velocity.solve(&hpv.transpose());
        let gradient = self.gradient.fixed_rows::<6>(0) - hpv * velocity.solve(&pulled);
        let information = (information + information.transpose()) * 0.5;
        Some(PoseFactor { t_odom_found: state.t_odom_base, information, gradient })
    }
}

fn solve(told: &Told, expected: &(Matrix12, Vector12)) -> Option<(Vector12, Matrix12)> {
    let (h, g) = (expected.0 + told.information, expected.1 + told.gradient);
    let step = -h.cholesky()?.solve(&g);
    step.iter().all(|x| x.is_finite()).then_some((step, h))
}

fn judge(
    problem: &Problem<'_>,
    state: &State,
    e: &NormalEquations,
    degeneracy: &Degeneracy,
    information: &Matrix12,
    iterations: usize,
) -> Result<Registration, LostReason> {
    let (overlap, close) = fit(problem, state);
    if close < problem.min_inlier_ratio * overlap {
        return Err(LostReason::ResidualTooLarge);
    }
    if degeneracy.num_directions >= 5 {
        return Err(LostReason::Degenerate);
    }
    let covariance = information.cholesky().ok_or(LostReason::Degenerate)?.inverse();
    let covariance: Matrix6<f64> = covariance.fixed_view::<6, 6>(0, 0).into_owned();
    Ok(Registration {
        t_odom_base: state.t_odom_base,
        covariance: (covariance + covariance.transpose()) * 0.5,
        inlier_ratio: close,
        rmse_m: e.rmse(),
        iterations,
        degenerate_axes: degeneracy.axes,
        told: None,
        found: Found::PoseAlone,
    })
}

/// Shares of the points that meet a plane, and that lie within a sixth of a voxel of it.
fn fit(problem: &Problem<'_>, state: &State) -> (f64, f64) {
    let (mut met, mut close, mut all) = (0.0, 0.0, 0.0);
    for p in problem.sweep.at_stamp(&state.velocity).iter().step_by(4) {
        all += 1.0;
        let p = state.t_odom_base * p.cast::<f64>();
        if let Some(v) = problem.map.at(&p) {
            met += 1.0;
            let near = match v.shape {
                Shape::Plane(normal, variance) => {
                    normal.dot(&(p - v.mean)).abs() < problem.map.size() / 6.0 + 2.0 * variance.sqrt()
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
