//! Iterative registration of two clouds that are nearly aligned.

use super::factors::{colored, gicp};
use super::pair_block::{BLOCK, PairBlock};
use super::pairing::Known;
use super::{Degeneracy, IcpMethod, IcpParams, NormalEquations, PreparedCloud, RegistrationError, RobustKernel};
use nalgebra::{Matrix3, Matrix6, Point3, Vector3};
use percept_geometry::{Covariance6, Pose, se3};
use rayon::prelude::*;

/// Fewer pairs do not fix a pose.
const FEWEST_PAIRS: usize = 6;
/// Clouds with more points begin with every [`STRIDE`]th: while steps are long, few points say as much.
const THIN_ABOVE: usize = 2000;
const STRIDE: usize = 4;
/// Thinned clouds are left once steps are below so many tolerances.
const THIN_TOLERANCES: f64 = 5.0;

/// How registration ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum IcpOutcome {
    /// The last step was below the tolerances, and the pairs fix the whole pose.
    Converged,
    /// The last step was below the tolerances, but the pairs leave directions open: see `degenerate_axes`.
    Degenerate,
    /// Steps were still above the tolerances.
    MaxIterations,
    /// Fewer than six pairs were within the distance.
    TooFewPairs,
    /// A step led away from the clouds, or most pairs were lost.
    Diverged,
}

/// Where two clouds meet.
#[derive(Debug, Clone, PartialEq)]
pub struct IcpResult {
    /// Source to target.
    pub t_target_source: Pose,
    /// 6x6, right perturbation in the source frame; scaled by the residuals' variance. Directions that the
    /// clouds leave open have a variance of 1e6 about the source's centroid.
    pub covariance: Covariance6,
    /// How it ended.
    pub outcome: IcpOutcome,
    /// Iterations done.
    pub iterations: usize,
    /// Fitness: share of the finite source points with a partner within `max_distance_m`, 0 to 1.
    pub inlier_ratio: f64,
    /// Root mean square distance of those from their partners (points, or means of voxels), metres.
    pub inlier_rmse_m: f64,
    /// Axes of the source frame, about the source's centroid (x, y, z, rotation x, y, z), that the clouds leave open.
    pub degenerate_axes: [bool; 6],
}

impl IcpResult {
    /// Whether the whole pose was found.
    pub fn converged(&self) -> bool {
        self.outcome == IcpOutcome::Converged
    }
}

/// Lays `source` over `target` from a first guess of `t_target_source`, by the method that both were prepared for.
///
/// Gauss-Newton on pairs found anew in every step; steps turn about the source's centroid, so that distance from the
/// origin costs nothing. What the clouds leave open stays as it was in `start`. Large sources begin thinned.
///
/// # Errors
/// `BadParam`; `Missing` if the target was prepared for another method. Not converging is an answer.
pub fn align(
    source: &PreparedCloud,
    target: &PreparedCloud,
    start: &Pose,
    params: &IcpParams,
) -> Result<IcpResult, RegistrationError> {
    params.validate()?;
    check(source, target, params.method)?;
    let n = source.points.len() as f64;
    let center = source.points.iter().map(|p| p.coords.cast::<f64>()).sum::<Vector3<f64>>() / n;
    let squares = source.points.iter().map(|p| (p.coords.cast::<f64>() - center).norm_squared()).sum::<f64>();
    let problem = Problem { target, params, center, spread: (squares / n).sqrt() };
    Ok(problem.solve(source, start))
}

fn check(source: &PreparedCloud, target: &PreparedCloud, method: IcpMethod) -> Result<(), RegistrationError> {
    use IcpMethod as M;
    let missing = |cloud, channel| Err(RegistrationError::Missing { cloud, channel });
    if method == M::Vgicp && target.voxels.is_none() {
        return missing("target", "voxels");
    }
    if method != M::Vgicp && target.tree.is_none() {
        return missing("target", "search tree");
    }
    if matches!(method, M::Gicp | M::Vgicp) && source.normals.len() != source.points.len() {
        return missing("source", "normals");
    }
    if !matches!(method, M::PointToPoint | M::Vgicp) && target.normals.len() != target.points.len() {
        return missing("target", "normals");
    }
    if method == M::Colored {
        for (name, cloud) in [("source", source), ("target", target)] {
            if cloud.brightness.len() != cloud.points.len() {
                return missing(name, "colours");
            }
        }
        if target.gradients.len() != target.points.len() {
            return missing("target", "colours");
        }
    }
    Ok(())
}

struct Problem<'a> {
    target: &'a PreparedCloud,
    params: &'a IcpParams,
    /// Centroid of the source, and root mean square distance from it.
    center: Vector3<f64>,
    spread: f64,
}

/// The source, about its centroid, with what is known of each point's partner.
struct Moving {
    points: Vec<MovingPoint>,
    known: Vec<Known>,
}

#[derive(Clone, Copy)]
struct MovingPoint {
    p: Vector3<f64>,
    normal: Vector3<f32>,
    brightness: f32,
}

impl Moving {
    fn of(source: &PreparedCloud, center: &Vector3<f64>, stride: usize) -> Self {
        let point = |i: usize| MovingPoint {
            p: source.points[i].coords.cast::<f64>() - center,
            normal: source.normals.get(i).copied().unwrap_or_default(),
            brightness: source.brightness.get(i).copied().unwrap_or_default(),
        };
        let points: Vec<MovingPoint> = (0..source.points.len()).step_by(stride).map(point).collect();
        Self { known: vec![Known::NOTHING; points.len()], points }
    }
}

/// Sums over the pairs of one pose.
#[derive(Clone, Copy, Default)]
struct PairSums {
    equations: NormalEquations,
    num_pairs: usize,
    distances2: f64,
}

impl PairSums {
    fn merge(mut self, other: &Self) -> Self {
        self.equations.merge(&other.equations);
        self.num_pairs += other.num_pairs;
        self.distances2 += other.distances2;
        self
    }
}

/// Where the iterations stand. `t` takes points about the centroid to the target.
struct State {
    t: Pose,
    iterations: usize,
    outcome: IcpOutcome,
}

impl Problem<'_> {
    fn solve(&self, source: &PreparedCloud, start: &Pose) -> IcpResult {
        let t = start * nalgebra::Translation3::from(self.center);
        let mut state = State { t, iterations: 0, outcome: IcpOutcome::MaxIterations };
        if source.points.len() > THIN_ABOVE {
            let mut thinned = Moving::of(source, &self.center, STRIDE);
            self.iterate(&mut thinned, &mut state, self.params.max_iterations / 2, THIN_TOLERANCES);
        }
        let mut all = Moving::of(source, &self.center, 1);
        self.iterate(&mut all, &mut state, self.params.max_iterations, 1.0);
        self.judge(&mut all, state)
    }

    /// Steps until they are below `tolerances` tolerances, or `limit` iterations are done.
    fn iterate(&self, moving: &mut Moving, state: &mut State, limit: usize, tolerances: f64) {
        state.outcome = IcpOutcome::MaxIterations;
        let mut pairs_at_start = None;
        while state.iterations < limit {
            let sums = self.sums(moving, &state.t, self.params.tangent_weight);
            if sums.num_pairs < FEWEST_PAIRS {
                state.outcome = IcpOutcome::TooFewPairs;
                return;
            }
            state.iterations += 1;
            let fewest = *pairs_at_start.get_or_insert(sums.num_pairs) / 4;
            let degeneracy = self.degeneracy(&sums.equations);
            // What the clouds leave open stays where it is: a unit pull on a tiny scale makes H invertible.
            let h = degeneracy.keep_good(&sums.equations.hessian());
            let pull = Matrix6::identity() * (1e-9 * h.trace().max(1e-12));
            let step =
                (h + pull).cholesky().map(|c| -c.solve(&degeneracy.keep_good_gradient(&sums.equations.gradient())));
            let bound = 10.0 * (self.spread + self.params.max_distance_m);
            let usable =
                |x: &nalgebra::Vector6<f64>| x.iter().all(|v| v.is_finite()) && x.fixed_rows::<3>(0).norm() <= bound;
            let Some(step) = step.filter(usable).filter(|_| sums.num_pairs >= fewest) else {
                state.outcome = IcpOutcome::Diverged;
                return;
            };
            state.t *= se3::exp(&step);
            if step.fixed_rows::<3>(0).norm() < tolerances * self.params.translation_tolerance_m
                && step.fixed_rows::<3>(3).norm() < tolerances * self.params.rotation_tolerance_rad
            {
                state.outcome = IcpOutcome::Converged;
                return;
            }
        }
    }

    fn degeneracy(&self, equations: &NormalEquations) -> Degeneracy {
        Degeneracy::of(equations, &Vector3::zeros(), self.spread, self.params.degeneracy_threshold)
    }

    fn sums(&self, moving: &mut Moving, t: &Pose, tangent_weight: f64) -> PairSums {
        let frame = Frame { r: *t.rotation.to_rotation_matrix().matrix(), t: t.translation.vector, tangent_weight };
        let one = |(points, known): (&[MovingPoint], &mut [Known])| self.chunk(points, known, &frame);
        let parts: Vec<PairSums> =
            moving.points.par_chunks(BLOCK).zip(moving.known.par_chunks_mut(BLOCK)).map(one).collect();
        parts.iter().fold(PairSums::default(), PairSums::merge)
    }

    fn chunk(&self, points: &[MovingPoint], known: &mut [Known], frame: &Frame) -> PairSums {
        let (mut block, mut extra, mut out) = (PairBlock::default(), NormalEquations::default(), PairSums::default());
        let mut buffer = Vec::with_capacity(3);
        let max = self.params.max_distance_m;
        let kernel = self.params.kernel;
        for (point, known) in points.iter().zip(known) {
            let moved = frame.r * point.p + frame.t;
            let (difference, information, index) = match (&self.target.voxels, &self.target.tree) {
                (Some(voxels), _) => {
                    let Some(voxel) = voxels.at(&Point3::from(moved)) else { continue };
                    let difference = moved - voxel.mean;
                    if difference.norm_squared() > max * max {
                        continue;
                    }
                    let mut c = turned(&voxel.covariance, &frame.r);
                    c.iter_mut().zip(gicp::covariance(&point.normal.cast())).for_each(|(a, b)| *a += b);
                    (difference, gicp::inverse(&c), 0)
                }
                (None, Some(tree)) => {
                    let target = &self.target.points;
                    let Some(j) = known.nearest(&Point3::from(moved).cast(), target, tree, max as f32, &mut buffer)
                    else {
                        continue;
                    };
                    let Some(information) = self.information(point, j, frame) else { continue };
                    (moved - target[j].coords.cast(), information, j)
                }
                (None, None) => continue,
            };
            let e = frame.r.tr_mul(&difference);
            let weight = match kernel {
                RobustKernel::None => 1.0,
                _ => kernel.weight(mahalanobis2(&information, &e).max(0.0).sqrt()),
            };
            block.push(point.p.into(), e.into(), &information, weight);
            if self.params.method == IcpMethod::Colored {
                let (residual, row) = colored::residual(
                    &frame.r,
                    &point.p,
                    &moved,
                    &self.target.points[index].coords.cast(),
                    &self.target.gradients[index].cast(),
                    f64::from(point.brightness),
                    f64::from(self.target.brightness[index]),
                );
                extra.add(&row, residual, weight * self.params.colour_share);
            }
            out.num_pairs += 1;
            out.distances2 += difference.norm_squared();
        }
        out.equations =
            block.sum(if matches!(self.params.method, IcpMethod::PointToPlane | IcpMethod::Colored) { 1 } else { 3 });
        out.equations.merge(&extra);
        out
    }

    /// Information of the difference from target point `j`, in the source frame; none without a normal.
    #[inline]
    fn information(&self, point: &MovingPoint, j: usize, frame: &Frame) -> Option<[f64; 6]> {
        if self.params.method == IcpMethod::PointToPoint {
            return Some([1.0, 0.0, 0.0, 1.0, 0.0, 1.0]);
        }
        let n = frame.r.tr_mul(&self.target.normals[j].cast::<f64>());
        if self.params.method == IcpMethod::Gicp {
            return Some(gicp::information(&n, &point.normal.cast()));
        }
        if n == Vector3::zeros() {
            return None;
        }
        let (across, along) = match self.params.method {
            IcpMethod::Colored => (1.0 - self.params.colour_share, 0.0),
            _ => (1.0, frame.tangent_weight),
        };
        let m = n * across;
        Some([m.x * n.x + along, m.x * n.y, m.x * n.z, m.y * n.y + along, m.y * n.z, m.z * n.z + along])
    }

    fn judge(&self, all: &mut Moving, state: State) -> IcpResult {
        // Along planes nothing is measured: the pull there steadies steps and is no information.
        let sums = self.sums(all, &state.t, 0.0);
        let degeneracy = self.degeneracy(&sums.equations);
        // Floats resolve 1e-7 of a few metres: a variance below that is not to be had.
        let variance = (sums.equations.cost / (sums.equations.num_residuals as f64 - 6.0).max(1.0)).max(1e-12);
        let information = degeneracy.keep_good(&sums.equations.hessian()) / variance + Matrix6::identity() * 1e-6;
        let centered = information.try_inverse().unwrap_or_else(|| Covariance6::identity() * 1e6);
        // Turning about the centroid is turning about the origin and a shift.
        let mut shift = Matrix6::identity();
        shift.fixed_view_mut::<3, 3>(0, 3).copy_from(&se3::skew(&self.center));
        let open = degeneracy.num_directions > 0;
        IcpResult {
            t_target_source: state.t * nalgebra::Translation3::from(-self.center),
            covariance: shift * centered * shift.transpose(),
            outcome: if state.outcome == IcpOutcome::Converged && open {
                IcpOutcome::Degenerate
            } else {
                state.outcome
            },
            iterations: state.iterations,
            inlier_ratio: sums.num_pairs as f64 / all.points.len() as f64,
            inlier_rmse_m: (sums.distances2 / (sums.num_pairs as f64).max(1.0)).sqrt(),
            degenerate_axes: degeneracy.axes,
        }
    }
}

/// Where the source stands in one iteration.
struct Frame {
    r: Matrix3<f64>,
    t: Vector3<f64>,
    tangent_weight: f64,
}

/// `e' W e`.
#[inline]
fn mahalanobis2(w: &[f64; 6], e: &Vector3<f64>) -> f64 {
    w[0] * e.x * e.x
        + w[3] * e.y * e.y
        + w[5] * e.z * e.z
        + 2.0 * (w[1] * e.x * e.y + w[2] * e.x * e.z + w[4] * e.y * e.z)
}

/// `R' C R` of an upper triangle.
#[inline]
fn turned(c: &[f64; 6], r: &Matrix3<f64>) -> [f64; 6] {
    let full = Matrix3::new(c[0], c[1], c[2], c[1], c[3], c[4], c[2], c[4], c[5]);
    let out = r.tr_mul(&(full * r));
    [out.m11, out.m12, out.m13, out.m22, out.m23, out.m33]
}

#[cfg(test)]
mod tests;
