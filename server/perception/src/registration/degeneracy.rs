//! Which directions of a pose the residuals do not fix, and the covariance that follows.
//!
//! Source: Zhang, Kaess, Singh, "On degeneracy of optimization-based state estimation problems", 2016:
//! the eigenvalues of the information tell which directions to leave to the prediction. We leave them
//! gradually, scale
//! turn about the points' centroid, so that a narrow view does not mix turning with shifting, scale
//! rotations by the points' spread, so that the eigenvalues compare, and divide by the trace of the
//! translations' block, so that the threshold depends neither on the number of points nor on the
//! weights' unit.

use super::NormalEquations;
use nalgebra::{Matrix3, Matrix6, SymmetricEigen, Vector3, Vector6};

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
    /// In columns, in the eigenvalues' order: directions in scaled coordinates at the centroid, orthonormal.
    directions: Matrix6<f64>,
    /// From scaled coordinates at the centroid to metric ones of the source frame, and back.
    to_metric: Matrix6<f64>,
    to_scaled: Matrix6<f64>,
    good: Matrix6<f64>,
    /// Projector on the degenerate directions, in scaled coordinates at the centroid.
    bad: Matrix6<f64>,
    /// The same in metric coordinates of the source frame.
    bad_metric: Matrix6<f64>,
}

impl Degeneracy {
    /// Analyses normal equations. `centroid` and `spread_m` (root mean square distance from it) describe
    /// the points in the source frame; directions with an eigenvalue below `threshold` are degenerate.
    pub fn of(equations: &NormalEquations, centroid: &Vector3<f64>, spread_m: f64, threshold: f64) -> Self {
        // Metric perturbations at the frame's origin are s times scaled ones at the centroid.
        let s = shift(centroid) * scaling(1.0 / spread_m.max(1e-6));
        let hessian = equations.hessian();
        let h = s.transpose() * hessian * s / hessian.fixed_view::<3, 3>(0, 0).trace();
        let back = scaling(spread_m.max(1e-6)) * shift(&-centroid);
        let mut out = Self {
            eigenvalues: Vector6::zeros(),
            axes: [true; 6],
            num_directions: 6,
            directions: Matrix6::identity(),
            to_metric: s,
            to_scaled: back,
            good: Matrix6::zeros(),
            bad: Matrix6::identity(),
            bad_metric: Matrix6::identity(),
        };
        if !h.iter().all(|x| x.is_finite()) || equations.num_residuals == 0 {
            return out;
        }
        let eigen = SymmetricEigen::new(h);
        let mut order = [0, 1, 2, 3, 4, 5];
        order.sort_by(|&a, &b| eigen.eigenvalues[a].total_cmp(&eigen.eigenvalues[b]));
        for (k, &from) in order.iter().enumerate() {
            out.directions.set_column(k, &eigen.eigenvectors.column(from));
        }
        out.with_eigenvalues(Vector6::from_fn(|i, _| eigen.eigenvalues[order[i]].max(0.0)), threshold)
    }

    /// The same directions with other eigenvalues, in the same order, which need not ascend: where less than all residuals
    /// count for some.
    pub fn with_eigenvalues(mut self, eigenvalues: Vector6<f64>, threshold: f64) -> Self {
        (self.eigenvalues, self.num_directions) = (eigenvalues, 0);
        (self.good, self.bad) = (Matrix6::zeros(), Matrix6::zeros());
        for k in 0..6 {
            let v = self.directions.column(k).into_owned();
            // Below the threshold the information fades with the square, rather than ending at it: a pose
            // must not jump when a direction passes by.
            let share = (eigenvalues[k] / threshold.max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
            self.good += v * v.transpose() * share;
            if share < 1.0 {
                self.num_directions += 1;
                self.bad += v * v.transpose();
            }
        }
        self.axes = self.axes_in(&Matrix3::identity());
        // Back from scaled to metric coordinates: P' H P keeps the information of good directions only.
        self.bad_metric = self.to_metric * self.bad * self.to_scaled;
        self.good = self.to_metric * self.good * self.to_scaled;
        self
    }

    /// The direction of an eigenvalue as a perturbation of the source frame, metres and radians, that moves the points by
    /// a metre, about.
    pub fn direction(&self, k: usize) -> Vector6<f64> {
        self.to_metric * self.directions.column(k)
    }

    /// The axes that lie more than half in degenerate directions, in a frame turned by `r_frame_source`.
    pub fn axes_in(&self, r_frame_source: &Matrix3<f64>) -> [bool; 6] {
        let block = |k: usize| {
            let b = self.bad.fixed_view::<3, 3>(k, k);
            (r_frame_source * b * r_frame_source.transpose()).diagonal()
        };
        let (t, r) = (block(0), block(3));
        [t.x, t.y, t.z, r.x, r.y, r.z].map(|share| share > 0.5)
    }

    /// How much of each translation, in axes of the source frame, lies in degenerate directions: a projector if they hold
    /// no turning.
    pub fn open_translations(&self) -> Matrix3<f64> {
        self.bad.fixed_view::<3, 3>(0, 0).into_owned()
    }

    /// A perturbation's share in directions that are not degenerate, and its share in those that are. They add up to it.
    pub fn parts(&self) -> (Matrix6<f64>, Matrix6<f64>) {
        (Matrix6::identity() - self.bad_metric, self.bad_metric)
    }

    /// Information `h` with what it claims about degenerate directions faded out.
    pub fn keep_good(&self, h: &Matrix6<f64>) -> Matrix6<f64> {
        if self.num_directions == 0 { *h } else { self.good.transpose() * h * self.good }
    }

    /// The gradient that belongs to [`Degeneracy::keep_good`].
    pub fn keep_good_gradient(&self, gradient: &Vector6<f64>) -> Vector6<f64> {
        // The information is faded from both sides, so the gradient is faded twice.
        let fade = self.good.transpose();
        if self.num_directions == 0 { *gradient } else { fade * (fade * gradient) }
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
        // The same, seen from a frame whose y looks at the wall.
        let turned = Matrix3::new(0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, -1.0);
        assert_eq!(d.axes_in(&turned), [true, false, true, false, true, false]);
        // Turning about the wall's middle is seen, and turning about the sensor is that and a shift.
        let h = Matrix6::identity();
        let along = |v: Vector6<f64>| v.dot(&(d.keep_good(&h) * v));
        assert!(along(Vector6::new(0.0, -0.2, 0.0, 0.0, 0.0, 0.1)) > 1e-3);
        assert!(along(Vector6::new(0.0, 1.0, 1.0, 0.1, 0.0, 0.0)) < 1e-9);
    }

    #[test]
    fn a_corridor_leaves_its_length_open() {
        let d = Degeneracy::of(&planes(&[Vector3::y(), -Vector3::y(), -Vector3::z()]), &Vector3::zeros(), 2.0, 0.01);
        assert_eq!(d.axes, [true, false, false, false, false, false]);
    }

    #[test]
    fn a_direction_that_counts_for_less_is_open_like_one_that_nothing_tells() {
        let walls = planes(&[Vector3::x(), Vector3::y(), Vector3::y(), Vector3::z(), Vector3::z()]);
        let d = Degeneracy::of(&walls, &Vector3::from_element(0.7), 2.0, 0.01);
        let along =
            |d: &Degeneracy, k: usize| d.direction(k).dot(&(d.keep_good(&Matrix6::identity()) * d.direction(k)));
        assert_eq!(d.num_directions, 0);
        let less =
            d.clone().with_eigenvalues(Vector6::from_fn(|i, _| if i == 0 { 0.0 } else { d.eigenvalues[i] }), 0.01);
        assert_eq!(less.num_directions, 1);
        assert!(along(&less, 0) < 1e-9 && (along(&less, 1) - along(&d, 1)).abs() < 1e-9);
    }

    #[test]
    fn parts_split_what_is_fixed_from_what_is_open() {
        let centroid = Vector3::new(0.5, 0.2, 0.0);
        let h = planes(&[Vector3::y(), -Vector3::y(), -Vector3::z()]);
        let d = Degeneracy::of(&h, &centroid, 2.0, 0.01);
        let (fixed, open) = d.parts();
        assert!((fixed + open - Matrix6::identity()).norm() < 1e-12);
        let along = Vector6::new(1.0, 0.0, 0.0, 0.0, 0.0, 0.0);
        assert!((open * along - along).norm() < 1e-9 && (fixed * along).norm() < 1e-9);
        assert!((d.open_translations() - Matrix3::from_diagonal(&Vector3::x())).norm() < 1e-9);
        // Nothing is lost of what the planes tell.
        let hessian = h.hessian();
        assert!((fixed.transpose() * hessian * fixed - hessian).norm() < 1e-9 * hessian.norm());
    }

    #[test]
    fn a_corner_of_three_planes_fixes_everything() {
        let d = Degeneracy::of(
            &planes(&[Vector3::x(), Vector3::y(), Vector3::z()]),
            &Vector3::from_element(0.7),
            2.0,
            0.01,
        );
        assert_eq!((d.axes, d.num_directions), ([false; 6], 0));
        assert_eq!(Degeneracy::of(&NormalEquations::default(), &Vector3::zeros(), 1.0, 0.01).num_directions, 6);
    }
}
