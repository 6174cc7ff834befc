//! Which directions of a pose the residuals do not fix, and the covariance that follows.
//!
//! Source: Zhang, Kaess, Singh, "On degeneracy of optimization-based state estimation problems", 2016:
//! the eigenvalues of the information tell which directions to leave to the prediction. We scale
//! turn about the points' centroid, so that a narrow view does not mix turning with shifting, scale
//! rotations by the points' spread, so that the eigenvalues compare, and divide by the trace of the
//! translations' block, so that the threshold depends neither on the number of points nor on the
//! weights' unit.

use super::NormalEquations;
use nalgebra::{Matrix6, SymmetricEigen, Vector3, Vector6};

/// Eigenvalues and directions of normalised information, and which of them carry too little.
#[derive(Debug, Clone, PartialEq)]
pub struct Degeneracy {
    /// Share of the residuals' squared sensitivity to a move of one metre, ascending; three translations
    /// seen equally well have a third each.
    pub eigenvalues: Vector6<f64>,
    /// Axes (x, y, z, rotation x, y, z) that lie more than half in degenerate directions.
    pub axes: [bool; 6],
    /// Number of degenerate directions.
    pub num_directions: usize,
    good: Matrix6<f64>,
}

impl Degeneracy {
    /// Analyses normal equations. `centroid` and `spread_m` (root mean square distance from it) describe
    /// the points in the source frame; directions with an eigenvalue below `threshold` are degenerate.
    pub fn of(equations: &NormalEquations, centroid: &Vector3<f64>, spread_m: f64, threshold: f64) -> Self {
        // Metric perturbations at the frame's origin are s times scaled ones at the centroid.
        let s = shift(centroid) * scaling(1.0 / spread_m.max(1e-6));
        let hessian = equations.hessian();
        let h = s.transpose() * hessian * s / hessian.fixed_view::<3, 3>(0, 0).trace();
        if !h.iter().all(|x| x.is_finite()) || equations.num_residuals == 0 {
            return Self {
                eigenvalues: Vector6::zeros(),
                axes: [true; 6],
                num_directions: 6,
                good: Matrix6::zeros(),
            };
        }
        let eigen = SymmetricEigen::new(h);
        let mut order = [0, 1, 2, 3, 4, 5];
        order.sort_by(|&a, &b| eigen.eigenvalues[a].total_cmp(&eigen.eigenvalues[b]));
        let mut out = Self {
            eigenvalues: Vector6::from_fn(|i, _| eigen.eigenvalues[order[i]].max(0.0)),
            axes: [false; 6],
            num_directions: 0,
            good: Matrix6::zeros(),
        };
        let mut share = [0.0; 6];
        for k in order {
            let v = eigen.eigenvectors.column(k).into_owned();
            if eigen.eigenvalues[k] < threshold {
                out.num_directions += 1;
                for i in 0..6 {
                    share[i] += v[i] * v[i];
                }
            } else {
                out.good += v * v.transpose();
            }
        }
        out.axes = share.map(|x| x > 0.5);
        // Back from scaled to metric coordinates: P' H P keeps the information of good directions only.
        out.good = s * out.good * scaling(spread_m.max(1e-6)) * shift(&-centroid);
        out
    }

    /// Information `h` without what it claims about degenerate directions.
    pub fn keep_good(&self, h: &Matrix6<f64>) -> Matrix6<f64> {
        if self.num_directions == 0 { *h } else { self.good.transpose() * h * self.good }
    }

    /// The part of a gradient that belongs to directions that are not degenerate.
    pub fn keep_good_gradient(&self, gradient: &Vector6<f64>) -> Vector6<f64> {
        if self.num_directions == 0 { *gradient } else { self.good.transpose() * gradient }
    }

    /// The part of a step (m, rad) in directions that are not degenerate.
    pub fn keep_good_step(&self, step: &Vector6<f64>) -> Vector6<f64> {
        if self.num_directions == 0 { *step } else { self.good * step }
    }
}

/// Multiplies rotations by a factor.
fn scaling(factor: f64) -> Matrix6<f64> {
    Matrix6::from_diagonal(&Vector6::new(1.0, 1.0, 1.0, factor, factor, factor))
}

/// From perturbations about `centroid` to those about the origin: `v_origin = v - w x centroid`.
fn shift(centroid: &Vector3<f64>) -> Matrix6<f64> {
    let mut out = Matrix6::identity();
    out.fixed_view_mut::<3, 3>(0, 3).copy_from(&percept_geometry::se3::skew(centroid));
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::registration::factors::point_to_plane;
    use nalgebra::Matrix3;

    /// Residuals of a grid of points on planes with these normals, two metres away along each.
    fn planes(normals: &[Vector3<f64>]) -> NormalEquations {
        let mut e = NormalEquations::default();
        for n in normals {
            let a = n.cross(&Vector3::new(0.3, 0.5, 0.8)).normalize();
            let b = n.cross(&a);
            for i in -10..=10 {
                for j in -10..=10 {
                    let p = n * 2.0 + a * (0.2 * f64::from(i)) + b * (0.2 * f64::from(j));
                    let (r, jac) = point_to_plane::residual(&Matrix3::identity(), &p, &p, &p, n);
                    e.add(&jac, r, 1.0);
                }
            }
        }
        e
    }

    #[test]
    fn one_wall_leaves_two_moves_and_one_turn_open() {
        let d = Degeneracy::of(&planes(&[Vector3::x()]), &(Vector3::x() * 2.0), 1.7, 0.01);
        assert_eq!(d.axes, [false, true, true, true, false, false]);
        assert_eq!(d.num_directions, 3);
        // Turning about the wall's middle is seen, and turning about the sensor is that and a shift.
        let about_middle = Vector6::new(0.0, -0.2, 0.0, 0.0, 0.0, 0.1);
        assert!((d.keep_good_step(&about_middle) - about_middle).norm() < 1e-9);
        assert!(d.keep_good_step(&Vector6::new(0.0, 1.0, 1.0, 0.1, 0.0, 0.0)).norm() < 1e-9);
    }

    #[test]
    fn a_corridor_leaves_its_length_open() {
        let d = Degeneracy::of(&planes(&[Vector3::y(), -Vector3::y(), -Vector3::z()]), &Vector3::zeros(), 2.0, 0.01);
        assert_eq!(d.axes, [true, false, false, false, false, false]);
    }

    #[test]
    fn a_corner_of_three_planes_fixes_everything() {
        let d = Degeneracy::of(&planes(&[Vector3::x(), Vector3::y(), Vector3::z()]), &Vector3::from_element(0.7), 2.0, 0.01);
        assert_eq!((d.axes, d.num_directions), ([false; 6], 0));
        assert_eq!(Degeneracy::of(&NormalEquations::default(), &Vector3::zeros(), 1.0, 0.01).num_directions, 6);
    }
}
