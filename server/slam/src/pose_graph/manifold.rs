//! Poses in the plane and in space as the pose graph sees them: composition, small steps, errors with derivatives.

use nalgebra::{
    Matrix3, Matrix6, Quaternion, Rotation3, SMatrix, SVector, Translation3, UnitQuaternion, Vector3, Vector6,
};
use percept_geometry::se3::{skew, wrap_angle};
use percept_geometry::{Covariance6, Pose};
use std::fmt::Debug;

/// What a pair of poses leaves unexplained of a measurement, and how that changes with small steps of both.
#[derive(Debug, Clone, Copy)]
pub struct Linearised<const D: usize> {
    /// The error.
    pub error: SVector<f64, D>,
    /// Its derivative by a step of the pose that the edge starts from.
    pub from: SMatrix<f64, D, D>,
    /// Its derivative by a step of the pose that the edge ends at.
    pub to: SMatrix<f64, D, D>,
}

/// A group of poses with `D` degrees of freedom.
pub trait Manifold<const D: usize>: Copy + PartialEq + Debug + Send + Sync + 'static {
    /// The pose of a frame in itself.
    fn identity() -> Self;
    /// `self` times `other`.
    fn compose(&self, other: &Self) -> Self;
    /// The other way round.
    fn inverse(&self) -> Self;
    /// A small step in the pose's own frame: metres, then radians.
    fn step(&self, delta: &SVector<f64, D>) -> Self;
    /// Error of a measured `t_from_to`, as g2o defines it.
    fn error(measured: &Self, from: &Self, to: &Self) -> SVector<f64, D>;
    /// Error and derivatives by [`Manifold::step`].
    fn linearise(measured: &Self, from: &Self, to: &Self) -> Linearised<D>;
    /// Its rotation in space.
    fn rotation(&self) -> Matrix3<f64>;
    /// Its position in space, metres.
    fn position(&self) -> Vector3<f64>;
    /// The pose with this rotation (about z in the plane) and this position.
    fn from_parts(rotation: &Matrix3<f64>, position: &Vector3<f64>) -> Self;
    /// Mean information of the error's turns.
    fn turn_information(information: &SMatrix<f64, D, D>) -> f64;
    /// Mean information of the error's shifts.
    fn shift_information(information: &SMatrix<f64, D, D>) -> f64;
}

/// A pose in the plane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlanarPose {
    /// Position, metres.
    pub x: f64,
    /// Position, metres.
    pub y: f64,
    /// Heading, radians, -pi to pi.
    pub yaw: f64,
}

impl Manifold<3> for PlanarPose {
    fn identity() -> Self {
        Self { x: 0.0, y: 0.0, yaw: 0.0 }
    }

    fn compose(&self, other: &Self) -> Self {
        let (s, c) = self.yaw.sin_cos();
        Self {
            x: self.x + c * other.x - s * other.y,
            y: self.y + s * other.x + c * other.y,
            yaw: wrap_angle(self.yaw + other.yaw),
        }
    }

    fn inverse(&self) -> Self {
        let (s, c) = self.yaw.sin_cos();
        Self { x: -c * self.x - s * self.y, y: s * self.x - c * self.y, yaw: -self.yaw }
    }

    fn step(&self, d: &SVector<f64, 3>) -> Self {
        self.compose(&Self { x: d[0], y: d[1], yaw: d[2] })
    }

    fn error(measured: &Self, from: &Self, to: &Self) -> SVector<f64, 3> {
        let (s, c) = from.yaw.sin_cos();
        let (dx, dy) = (to.x - from.x, to.y - from.y);
        let (mx, my) = (c * dx + s * dy - measured.x, -s * dx + c * dy - measured.y);
        let (s, c) = measured.yaw.sin_cos();
        SVector::<f64, 3>::new(c * mx + s * my, -s * mx + c * my, wrap_angle(to.yaw - from.yaw - measured.yaw))
    }

    fn linearise(measured: &Self, from: &Self, to: &Self) -> Linearised<3> {
        let (s, c) = from.yaw.sin_cos();
        let (dx, dy) = (to.x - from.x, to.y - from.y);
        // Where `to` lies in `from`.
        let (px, py) = (c * dx + s * dy, -s * dx + c * dy);
        let (ms, mc) = measured.yaw.sin_cos();
        let turned = |x: f64, y: f64| (mc * x + ms * y, -ms * x + mc * y);
        let (ex, ey) = turned(px - measured.x, py - measured.y);
        let error = SVector::<f64, 3>::new(ex, ey, wrap_angle(to.yaw - from.yaw - measured.yaw));
        // A step of `from` moves the point by -d and turns it by -yaw: +(py, -px).
        let (a, b) = turned(py, -px);
        #[rustfmt::skip]
        let by_from = SMatrix::<f64, 3, 3>::new(
            -mc, -ms, a,
            ms, -mc, b,
            0.0, 0.0, -1.0,
        );
        let (rs, rc) = (to.yaw - from.yaw).sin_cos();
        let ((c00, c10), (c01, c11)) = (turned(rc, rs), turned(-rs, rc));
        #[rustfmt::skip]
        let by_to = SMatrix::<f64, 3, 3>::new(
            c00, c01, 0.0,
            c10, c11, 0.0,
            0.0, 0.0, 1.0,
        );
        Linearised { error, from: by_from, to: by_to }
    }

    fn rotation(&self) -> Matrix3<f64> {
        let (s, c) = self.yaw.sin_cos();
        Matrix3::new(c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0)
    }

    fn position(&self) -> Vector3<f64> {
        Vector3::new(self.x, self.y, 0.0)
    }

    fn from_parts(rotation: &Matrix3<f64>, position: &Vector3<f64>) -> Self {
        Self { x: position.x, y: position.y, yaw: rotation[(1, 0)].atan2(rotation[(0, 0)]) }
    }

    fn turn_information(information: &SMatrix<f64, 3, 3>) -> f64 {
        information[(2, 2)]
    }

    fn shift_information(information: &SMatrix<f64, 3, 3>) -> f64 {
        (information[(0, 0)] + information[(1, 1)]) / 2.0
    }
}

/// The quaternion with a positive real part: of the two that turn alike, the one that g2o's error uses.
fn positive(q: &UnitQuaternion<f64>) -> Quaternion<f64> {
    let q = q.into_inner();
    if q.w < 0.0 { -q } else { q }
}

impl Manifold<6> for Pose {
    fn identity() -> Self {
        Pose::identity()
    }

    fn compose(&self, other: &Self) -> Self {
        let mut out = self * other;
        out.rotation.renormalize_fast();
        out
    }

    fn inverse(&self) -> Self {
        Pose::inverse(self)
    }

    fn step(&self, d: &SVector<f64, 6>) -> Self {
        let turn = UnitQuaternion::from_scaled_axis(Vector3::new(d[3], d[4], d[5]));
        self.compose(&Pose::from_parts(Translation3::new(d[0], d[1], d[2]), turn))
    }

    fn error(measured: &Self, from: &Self, to: &Self) -> SVector<f64, 6> {
        let off = measured.inv_mul(&from.inv_mul(to));
        let (t, q) = (off.translation.vector, positive(&off.rotation));
        SVector::<f64, 6>::from_column_slice(&[t.x, t.y, t.z, q.i, q.j, q.k])
    }

    fn linearise(measured: &Self, from: &Self, to: &Self) -> Linearised<6> {
        let moved = from.inv_mul(to);
        let off = measured.inv_mul(&moved);
        let (t, q) = (off.translation.vector, positive(&off.rotation));
        let error = SVector::<f64, 6>::from_column_slice(&[t.x, t.y, t.z, q.i, q.j, q.k]);
        let unturn = measured.rotation.inverse().to_rotation_matrix().into_inner();
        let half = |sign: f64| (Matrix3::identity() * q.w + skew(&q.vector().into_owned()) * sign) * 0.5;
        let (mut by_from, mut by_to) = (SMatrix::<f64, 6, 6>::zeros(), SMatrix::<f64, 6, 6>::zeros());
        by_to.fixed_view_mut::<3, 3>(0, 0).copy_from(&off.rotation.to_rotation_matrix().into_inner());
        by_to.fixed_view_mut::<3, 3>(3, 3).copy_from(&half(1.0));
        by_from.fixed_view_mut::<3, 3>(0, 0).copy_from(&-unturn);
        by_from.fixed_view_mut::<3, 3>(0, 3).copy_from(&(unturn * skew(&moved.translation.vector)));
        by_from.fixed_view_mut::<3, 3>(3, 3).copy_from(&(half(-1.0) * -unturn));
        Linearised { error, from: by_from, to: by_to }
    }

    fn rotation(&self) -> Matrix3<f64> {
        self.rotation.to_rotation_matrix().into_inner()
    }

    fn position(&self) -> Vector3<f64> {
        self.translation.vector
    }

    fn from_parts(rotation: &Matrix3<f64>, position: &Vector3<f64>) -> Self {
        let rotation = Rotation3::from_matrix_unchecked(*rotation);
        Self::from_parts((*position).into(), UnitQuaternion::from_rotation_matrix(&rotation))
    }

    fn turn_information(information: &SMatrix<f64, 6, 6>) -> f64 {
        (3..6).map(|k| information[(k, k)]).sum::<f64>() / 3.0
    }

    fn shift_information(information: &SMatrix<f64, 6, 6>) -> f64 {
        (0..3).map(|k| information[(k, k)]).sum::<f64>() / 3.0
    }
}

/// Information of an error as g2o has it (the vector part of a quaternion: half the angle) for a covariance in radians;
/// none if that is not positive definite.
pub(crate) fn information_of(covariance: &Covariance6) -> Option<Matrix6<f64>> {
    let halves = Matrix6::from_diagonal(&Vector6::new(1.0, 1.0, 1.0, 2.0, 2.0, 2.0));
    let inverse = halves * covariance.cholesky()?.inverse() * halves;
    Some((inverse + inverse.transpose()) * 0.5)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Largest difference of the derivatives from central differences.
    fn worst<P: Manifold<D>, const D: usize>(measured: &P, from: &P, to: &P) -> f64 {
        let l = P::linearise(measured, from, to);
        let h = 1e-6;
        let mut worst = (l.error - P::error(measured, from, to)).norm();
        for k in 0..D {
            let mut d = SVector::<f64, D>::zeros();
            d[k] = h;
            let by_from =
                (P::error(measured, &from.step(&d), to) - P::error(measured, &from.step(&-d), to)) / (2.0 * h);
            let by_to = (P::error(measured, from, &to.step(&d)) - P::error(measured, from, &to.step(&-d))) / (2.0 * h);
            worst = worst.max((by_from - l.from.column(k)).norm()).max((by_to - l.to.column(k)).norm());
        }
        worst
    }

    fn planar() -> impl Strategy<Value = PlanarPose> {
        (-9.0..9.0f64, -9.0..9.0f64, -3.1..3.1f64).prop_map(|(x, y, yaw)| PlanarPose { x, y, yaw })
    }

    fn spatial() -> impl Strategy<Value = Pose> {
        let three = || prop::array::uniform3(-3.0..3.0f64);
        (three(), three()).prop_map(|(t, w)| {
            Pose::from_parts(Vector3::from(t).into(), UnitQuaternion::from_scaled_axis(Vector3::from(w)))
        })
    }

    proptest! {
        #[test]
        fn planar_derivatives_are_those_of_small_steps(m in planar(), a in planar(), b in planar()) {
            // At the seam of the angle no derivative exists.
            prop_assume!(P3::error(&m, &a, &b)[2].abs() < 3.1);
            prop_assert!(worst(&m, &a, &b) < 1e-6);
        }

        #[test]
        fn spatial_derivatives_are_those_of_small_steps(m in spatial(), a in spatial(), b in spatial()) {
            // Where the error is half a turn its quaternion changes sides.
            let off = m.inv_mul(&a.inv_mul(&b));
            prop_assume!(off.rotation.angle() < 3.1);
            prop_assert!(worst(&m, &a, &b) < 1e-6);
        }

        #[test]
        fn a_measurement_that_is_right_leaves_no_error(a in planar(), b in planar(), c in spatial(), d in spatial()) {
            let planar = P3::error(&a.inverse().compose(&b), &a, &b);
            prop_assert!(planar.norm() < 1e-9, "{}", planar);
            prop_assert!(Pose::error(&c.inv_mul(&d), &c, &d).norm() < 1e-9);
        }
    }

    type P3 = PlanarPose;
}
