//! What a point tells that met a voxel of the map.

use super::voxels::{Gaussian, Shape};
use nalgebra::{Matrix3, Point3, Vector3, Vector6};
use percept_perception::registration::factors::point_to_plane;
use percept_perception::registration::{Degeneracy, NormalEquations, RobustKernel};

/// Below this share a direction is told weakly: only what planes tell counts that face it. Four times what is degenerate; in a
/// corridor walls' false normals bring 0.008, seldom 0.016; with 0.03 recordings gave the same.
const WEAK: f64 = 0.016;
/// A plane faces a direction if its normal is within 60 degrees of it. Halved 11.6, doubled (never) 605 millimetres
/// (`evaluate handheld`).
const FACING: f64 = 0.5;

/// Directions of the pose that all points together tell weakly, the weakest first.
#[derive(Default)]
pub(super) struct Weak(Vec<Vector6<f64>>);

impl Weak {
    pub(super) fn len(&self) -> usize {
        self.0.len()
    }

    pub(super) fn of(degeneracy: &Degeneracy) -> Self {
        Self((0..6).take_while(|&k| degeneracy.eigenvalues[k] < WEAK).map(|k| degeneracy.direction(k)).collect())
    }
}

/// A point and the voxel that it met.
pub(super) struct Meeting<'a> {
    pub(super) voxel: &'a Gaussian,
    /// Rotation of t_odom_base, and the point in base and in odom.
    pub(super) r: &'a Matrix3<f64>,
    pub(super) p: &'a Vector3<f64>,
    pub(super) moved: &'a Point3<f64>,
    pub(super) kernel: &'a RobustKernel,
    pub(super) scale: f64,
    /// Variance of where the voxel is now, m^2.
    pub(super) stale: f64,
}

impl Meeting<'_> {
    /// Offset from the voxel's mean along a unit vector, its Jacobian, and the inverse of its variance.
    fn along(&self, axis: &Vector3<f64>, variance: f64) -> (f64, [f64; 6], f64) {
        let mean = &self.voxel.mean.coords;
        let (residual, jacobian) = point_to_plane::residual(self.r, self.p, &self.moved.coords, mean, axis);
        (residual, jacobian, 1.0 / (variance + self.stale + 0.25 * self.scale * self.scale))
    }

    pub(super) fn add_to(&self, e: &mut NormalEquations) {
        match &self.voxel.shape {
            Shape::Plane(normal, variance) => {
                let (residual, jacobian, information) = self.along(normal, *variance);
                e.add(&jacobian, residual, self.kernel.weight(residual) * information);
            }
            Shape::Scatter(axes, variances) => self.add_scatter(e, axes, variances),
            Shape::Unknown => {}
        }
    }

    /// Offsets from the mean along the axes of the points' scatter count as offsets from planes do.
    fn add_scatter(&self, e: &mut NormalEquations, axes: &Matrix3<f64>, variances: &Vector3<f64>) {
        let d = axes.tr_mul(&(self.moved - self.voxel.mean));
        let distance2: f64 = (0..3).map(|k| d[k] * d[k] / variances[k]).sum();
        let weight = 0.25 / (1.0 + distance2).powi(2);
        for k in 0..3 {
            let (residual, jacobian, information) = self.along(&axes.column(k).into_owned(), variances[k]);
            e.add(&jacobian, residual, weight * information);
        }
    }

    /// Adds what a plane tells of each weak direction that it faces: which its point would go within 60 degrees of the normal.
    pub(super) fn tell(&self, weak: &Weak, sums: &mut Vector6<f64>) {
        let Shape::Plane(normal, variance) = &self.voxel.shape else { return };
        if weak.0.is_empty() {
            return;
        }
        let (residual, jacobian, information) = self.along(normal, *variance);
        let weight = self.kernel.weight(residual) * information;
        for (sum, v) in sums.iter_mut().zip(&weak.0) {
            let along: f64 = jacobian.iter().zip(v.iter()).map(|(j, v)| j * v).sum();
            let way = v.fixed_rows::<3>(0) + v.fixed_rows::<3>(3).cross(self.p);
            if along * along > FACING * FACING * way.norm_squared() {
                *sum += weight * along * along;
            }
        }
    }

    /// Whether a plane looks along a translation that is open: no noise tilts a wall so far.
    pub(super) fn faces(&self, open: &Matrix3<f64>) -> bool {
        matches!(self.voxel.shape, Shape::Plane(normal, _) if (open * self.r.tr_mul(&normal)).norm() > FACING)
    }
}
