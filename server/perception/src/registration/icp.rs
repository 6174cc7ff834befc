//! Iterative closest point of two clouds that are nearly aligned.

use super::factors::{point_to_plane, point_to_point};
use super::{Degeneracy, NormalEquations, RobustKernel, accumulate};
use crate::search::KdTree;
use nalgebra::{Point3, Vector3};
use percept_geometry::{Covariance6, Pose, cloud, se3};
use serde::{Deserialize, Serialize};

/// Points a task: fixed, so that the number of threads changes nothing.
const CHUNK: usize = 1024;

/// Parameters of [`align_point_to_plane`] and [`align_point_to_point`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct IcpParams {
    /// Points farther apart do not correspond, metres, above 0. A few times the expected misalignment.
    pub max_distance_m: f64,
    /// Most iterations, 1 to 1000.
    pub max_iterations: usize,
    /// Converged once a step is shorter, metres, above 0.
    pub translation_tolerance_m: f64,
    /// Converged once a step turns less, radians, above 0.
    pub rotation_tolerance_rad: f64,
    /// How much a residual counts.
    pub kernel: RobustKernel,
    /// A direction with a smaller share of the residuals' sensitivity is degenerate, 0 to 0.3.
    pub degeneracy_threshold: f64,
}

impl Default for IcpParams {
    fn default() -> Self {
        Self {
            max_distance_m: 0.02,
            max_iterations: 50,
            translation_tolerance_m: 1e-5,
            rotation_tolerance_rad: 1e-5,
            kernel: RobustKernel::None,
            degeneracy_threshold: 0.002,
        }
    }
}

/// Why two clouds cannot be aligned at all.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RegistrationError {
    /// A parameter is out of its bounds.
    #[error("{field}: {value} is not {requirement}; {remedy}")]
    BadParam {
        /// Field name.
        field: &'static str,
        /// The value as given.
        value: f64,
        /// What it has to be.
        requirement: &'static str,
        /// What to do instead.
        remedy: &'static str,
    },
    /// A cloud has too few finite points.
    #[error("{field}: {num_points} finite points are fewer than {needed}")]
    TooFewPoints {
        /// Which cloud.
        field: &'static str,
        /// Finite points that it has.
        num_points: usize,
        /// Points that are needed.
        needed: usize,
    },
    /// There is not one normal a target point.
    #[error("target_normals: expected {expected}, got {actual}")]
    NormalsMismatch {
        /// Target points.
        expected: usize,
        /// Normals given.
        actual: usize,
    },
}

impl IcpParams {
    /// Checks every field.
    ///
    /// # Errors
    /// `BadParam` with field, value and remedy.
    pub fn validate(&self) -> Result<(), RegistrationError> {
        let bad =
            |field, value, requirement, remedy| Err(RegistrationError::BadParam { field, value, requirement, remedy });
        let positive = [
            ("max_distance_m", self.max_distance_m),
            ("translation_tolerance_m", self.translation_tolerance_m),
            ("rotation_tolerance_rad", self.rotation_tolerance_rad),
        ];
        for (field, value) in positive {
            if !(value.is_finite() && value > 0.0) {
                return bad(field, value, "positive and finite", "leave it out for the default");
            }
        }
        if !(1..=1000).contains(&self.max_iterations) {
            return bad("max_iterations", self.max_iterations as f64, "within 1 to 1000", "use 50");
        }
        if !(0.0..=0.3).contains(&self.degeneracy_threshold) {
            return bad("degeneracy_threshold", self.degeneracy_threshold, "within 0 to 0.3", "use 0.002");
        }
        Ok(())
    }
}

/// Where two clouds meet.
#[derive(Debug, Clone, PartialEq)]
pub struct IcpResult {
    /// Source to target.
    pub t_target_source: Pose,
    /// 6x6, right perturbation in the source frame; scaled by the residuals' variance. Directions that the
    /// clouds leave open have a variance of 1e6.
    pub covariance: Covariance6,
    /// Whether the last step was below the tolerances.
    pub converged: bool,
    /// Iterations done.
    pub iterations: usize,
    /// Share of the finite source points with a target point within `max_distance_m`, 0 to 1.
    pub inlier_ratio: f64,
    /// Root mean square distance of those from their target points (point to point), metres.
    pub inlier_rmse_m: f64,
    /// Axes of the source frame (x, y, z, rotation x, y, z) that the clouds leave open.
    pub degenerate_axes: [bool; 6],
}

/// Aligns by distances from the target's tangent planes: converges faster and slides along surfaces.
///
/// `source` (N) and `target` (M) in their own frames, metres; non-finite points are left out, as are
/// target points with a zero normal. `start` is a first guess of `t_target_source`.
/// Source: Chen and Medioni 1992; Rusinkiewicz and Levoy, "Efficient variants of the ICP algorithm", 2001.
///
/// # Errors
/// `BadParam`, `TooFewPoints`, `NormalsMismatch`. Not converging is an answer.
pub fn align_point_to_plane(
    source: &[Point3<f32>],
    target: &[Point3<f32>],
    target_normals: &[Vector3<f32>],
    start: &Pose,
    params: &IcpParams,
) -> Result<IcpResult, RegistrationError> {
    if target.len() != target_normals.len() {
        return Err(RegistrationError::NormalsMismatch { expected: target.len(), actual: target_normals.len() });
    }
    align(source, target, Some(target_normals), start, params)
}

/// Aligns by distances between points: needs no normals. See [`align_point_to_plane`].
///
/// Source: Besl and McKay 1992.
///
/// # Errors
/// `BadParam`, `TooFewPoints`.
pub fn align_point_to_point(
    source: &[Point3<f32>],
    target: &[Point3<f32>],
    start: &Pose,
    params: &IcpParams,
) -> Result<IcpResult, RegistrationError> {
    align(source, target, None, start, params)
}

fn align(
    source: &[Point3<f32>],
    target: &[Point3<f32>],
    normals: Option<&[Vector3<f32>]>,
    start: &Pose,
    params: &IcpParams,
) -> Result<IcpResult, RegistrationError> {
    params.validate()?;
    let source: Vec<Point3<f32>> = source.iter().filter(|p| cloud::is_finite(p)).copied().collect();
    let usable = |i: &usize| {
        cloud::is_finite(&target[*i])
            && normals.is_none_or(|n| n[*i].iter().all(|x| x.is_finite()) && n[*i].norm() > 0.5)
    };
    let kept: Vec<usize> = (0..target.len()).filter(usable).collect();
    for (field, num_points) in [("source", source.len()), ("target", kept.len())] {
        if num_points < 6 {
            return Err(RegistrationError::TooFewPoints { field, num_points, needed: 6 });
        }
    }
    let target: Vec<Point3<f32>> = kept.iter().map(|&i| target[i]).collect();
    let normals: Option<Vec<Vector3<f64>>> =
        normals.map(|n| kept.iter().map(|&i| n[i].cast::<f64>().normalize()).collect());
    let problem = Problem { tree: KdTree::build(&target), source, target, normals, params };
    Ok(problem.solve(start))
}

struct Problem<'a> {
    source: Vec<Point3<f32>>,
    target: Vec<Point3<f32>>,
    normals: Option<Vec<Vector3<f64>>>,
    tree: KdTree,
    params: &'a IcpParams,
}

impl Problem<'_> {
    fn solve(&self, start: &Pose) -> IcpResult {
        let (centroid, spread) = self.extent();
        let mut t = *start;
        let (mut converged, mut iterations) = (false, 0);
        while iterations < self.params.max_iterations && !converged {
            let e = self.equations(&t);
            let degeneracy = Degeneracy::of(&e, &centroid, spread, self.params.degeneracy_threshold);
            iterations += 1;
            // What the clouds leave open stays where it is: a unit pull on a tiny scale makes H invertible.
            let h = degeneracy.keep_good(&e.hessian());
            let pull = nalgebra::Matrix6::identity() * (1e-9 * h.trace().max(1e-12));
            let Some(cholesky) = (h + pull).cholesky() else { break };
            let step = -cholesky.solve(&degeneracy.keep_good_gradient(&e.gradient()));
            if e.num_residuals == 0 || !step.iter().all(|x| x.is_finite()) {
                break;
            }
            t *= se3::exp(&step);
            converged = step.fixed_rows::<3>(0).norm() < self.params.translation_tolerance_m
                && step.fixed_rows::<3>(3).norm() < self.params.rotation_tolerance_rad;
        }
        self.judge(t, converged, iterations, &centroid, spread)
    }

    fn nearest(&self, t: &Pose, i: usize) -> Option<(Point3<f64>, usize)> {
        let moved = t * self.source[i].cast::<f64>();
        let found = self.tree.nearest_within(&moved.cast::<f32>(), self.params.max_distance_m as f32)?;
        Some((moved, found.index))
    }

    fn equations(&self, t: &Pose) -> NormalEquations {
        let r = *t.rotation.to_rotation_matrix().matrix();
        accumulate(self.source.len(), CHUNK, |i, e| {
            let Some((moved, j)) = self.nearest(t, i) else { return };
            let (p, q) = (self.source[i].coords.cast(), self.target[j].coords.cast());
            match &self.normals {
                Some(normals) => {
                    let (residual, row) = point_to_plane::residual(&r, &p, &moved.coords, &q, &normals[j]);
                    e.add(&row, residual, self.params.kernel.weight(residual));
                }
                None => {
                    let weight = self.params.kernel.weight((moved.coords - q).norm());
                    for (residual, row) in point_to_point::residuals(&r, &p, &moved.coords, &q) {
                        e.add(&row, residual, weight);
                    }
                }
            }
        })
    }

    fn judge(&self, t: Pose, converged: bool, iterations: usize, centroid: &Vector3<f64>, spread: f64) -> IcpResult {
        let e = self.equations(&t);
        let degeneracy = Degeneracy::of(&e, centroid, spread, self.params.degeneracy_threshold);
        // Floats resolve 1e-7 of a few metres: a variance below that is not to be had.
        let variance = (e.cost / (e.num_residuals as f64 - 6.0).max(1.0)).max(1e-12);
        let open = nalgebra::Matrix6::identity() * 1e-6;
        let information = degeneracy.keep_good(&e.hessian()) / variance + open;
        let distances: Vec<f64> = (0..self.source.len())
            .filter_map(|i| {
                let (moved, j) = self.nearest(&t, i)?;
                Some((moved - self.target[j].cast::<f64>()).norm_squared())
            })
            .collect();
        let num = distances.len() as f64;
        IcpResult {
            t_target_source: t,
            covariance: information.try_inverse().unwrap_or_else(|| Covariance6::identity() * 1e6),
            converged,
            iterations,
            inlier_ratio: num / self.source.len() as f64,
            inlier_rmse_m: (distances.iter().sum::<f64>() / num.max(1.0)).sqrt(),
            degenerate_axes: degeneracy.axes,
        }
    }

    /// Mean of the source, and root mean square distance from it.
    fn extent(&self) -> (Vector3<f64>, f64) {
        let n = self.source.len() as f64;
        let centroid = self.source.iter().map(|p| p.coords.cast::<f64>()).sum::<Vector3<f64>>() / n;
        let squares = self.source.iter().map(|p| (p.coords.cast::<f64>() - centroid).norm_squared()).sum::<f64>();
        (centroid, (squares / n).sqrt())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector6;

    /// Three faces of a cube's inside corner, `n x n` points each, 2 m long.
    fn corner(n: usize) -> (Vec<Point3<f32>>, Vec<Vector3<f32>>) {
        let (mut points, mut normals) = (vec![], vec![]);
        for axis in 0..3 {
            for i in 0..n * n {
                let (a, b) = (2.0 * (i % n) as f32 / n as f32 + 0.05, 2.0 * (i / n) as f32 / n as f32 + 0.05);
                let mut p = [a, b, 0.0];
                p.rotate_right(axis);
                let mut normal = [0.0, 0.0, 1.0];
                normal.rotate_right(axis);
                points.push(Point3::from(p));
                normals.push(Vector3::from(normal));
            }
        }
        (points, normals)
    }

    fn moved(points: &[Point3<f32>], t_target_source: &Pose) -> Vec<Point3<f32>> {
        points.iter().map(|p| t_target_source.inverse_transform_point(&p.cast::<f64>()).cast()).collect()
    }

    #[test]
    fn both_kinds_find_a_small_motion_back() {
        let (target, normals) = corner(40);
        let truth = se3::exp(&Vector6::new(0.02, -0.01, 0.015, 0.01, -0.02, 0.015));
        let source = moved(&target, &truth);
        let params = IcpParams { max_distance_m: 0.2, ..IcpParams::default() };
        let planes = align_point_to_plane(&source, &target, &normals, &Pose::identity(), &params).unwrap();
        let points = align_point_to_point(&source, &target, &Pose::identity(), &params).unwrap();
        for found in [planes, points] {
            assert!(found.converged && found.inlier_ratio > 0.99);
            assert!(se3::log(&(truth.inverse() * found.t_target_source)).norm() < 1e-4);
            assert_eq!(found.degenerate_axes, [false; 6]);
        }
    }

    #[test]
    fn a_wall_alone_is_reported_open_along_itself() {
        let (target, normals) = corner(40);
        let (target, normals) = (&target[..1600], &normals[..1600]);
        let source = moved(target, &se3::exp(&Vector6::new(0.0, 0.0, 0.02, 0.0, 0.0, 0.0)));
        let params = IcpParams { max_distance_m: 0.2, ..IcpParams::default() };
        let found = align_point_to_plane(&source, target, normals, &Pose::identity(), &params).unwrap();
        assert_eq!(found.degenerate_axes, [true, true, false, false, false, true]);
        assert!((found.t_target_source.translation.z - 0.02).abs() < 1e-5);
        assert!(found.covariance[(0, 0)] > 1e5 && found.covariance[(2, 2)] < 1e-6);
    }

    #[test]
    fn what_cannot_be_aligned_is_named() {
        let (target, normals) = corner(10);
        let identity = Pose::identity();
        let params = IcpParams::default();
        assert!(matches!(
            align_point_to_point(&[], &target, &identity, &params),
            Err(RegistrationError::TooFewPoints { field: "source", .. })
        ));
        assert!(matches!(
            align_point_to_plane(&target, &target, &normals[1..], &identity, &params),
            Err(RegistrationError::NormalsMismatch { .. })
        ));
        let bad = IcpParams { max_distance_m: f64::NAN, ..params.clone() };
        assert!(align_point_to_point(&target, &target, &identity, &bad).is_err());
        // Far apart: no correspondence, an answer and no panic.
        let far = Pose::translation(100.0, 0.0, 0.0);
        let found = align_point_to_point(&target, &target, &far, &params).unwrap();
        assert!(!found.converged && found.inlier_ratio == 0.0);
        // All points equal.
        let same = vec![Point3::new(1.0, 1.0, 1.0); 50];
        let found = align_point_to_point(&same, &same, &identity, &params).unwrap();
        assert!(found.t_target_source.translation.vector.norm() < 1e-6);
    }
}
