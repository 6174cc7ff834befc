//! Poses in the plane and in space as the pose graph sees them: composition, small steps, errors with derivatives.

use super::Edge;
use super::minorant::Minorant;
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
    /// Leading numbers of a step that shift the pose. While all others are held, errors are linear in them.
    const SHIFTS: usize;
    /// Whether poses turn about z alone.
    const IS_PLANAR: bool;
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
    /// What bounds an edge's chi2 from below and meets it at these poses; none if that is not known.
    fn minorant(_edge: &Edge<Self, D>, _from: &Self, _to: &Self) -> Option<Minorant> {
        None
    }
    /// Information of a planar edge in space (as of [`Pose`]), where it may turn about every axis; none if it may anyway.
    fn lifted_information(_information: &SMatrix<f64, D, D>) -> Option<Matrix6<f64>> {
        None
    }
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
    const SHIFTS: usize = 2;
    const IS_PLANAR: bool = true;

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

    fn minorant(edge: &Edge<Self, 3>, from: &Self, to: &Self) -> Option<Minorant> {
        let information = &edge.information;
        let (shifts, turn) = (least_of_shifts(information), information[(2, 2)]);
        // So much of it is that of a length and an angle alone, which do not mix.
        let mixes = information[(0, 2)] != 0.0 || information[(1, 2)] != 0.0;
        let scale = Vector3::new(shifts, shifts, turn).map(|i| 1.0 / i.sqrt());
        let scaled = || Matrix3::from_fn(|r, c| information[(r, c)] * scale[r] * scale[c]);
        let share = if mixes { scaled().symmetric_eigenvalues().min() } else { 1.0 };
        if share.is_nan() || share.min(shifts).min(turn) <= 0.0 {
            return None;
        }
        let (shifts, turn) = (shifts * share, turn * share);
        let error = Self::error(&edge.t_from_to, from, to);
        let rest = information * error - error.component_mul(&Vector3::new(shifts, shifts, turn));
        // The tangent of the rest moves the angle that is best. The square of an angle lies above the multiple of 1 - cos
        // that touches it.
        let best = -rest[2] / turn;
        let angle = (error[2] - best).abs();
        let slope = if angle < 1e-6 { 1.0 } else { angle / angle.sin() };
        if angle.max(best.abs()) >= std::f64::consts::PI {
            return None;
        }
        let about_z = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, 0.0)) * (turn * slope * 0.5);
        let turns = Self { x: 0.0, y: 0.0, yaw: best }.rotation() * about_z;
        Some(Minorant::of(
            (edge.t_from_to.rotation(), edge.t_from_to.position()),
            &turns,
            shifts,
            &Vector3::new(rest.x, rest.y, 0.0),
        ))
    }

    fn lifted_information(information: &SMatrix<f64, 3, 3>) -> Option<Matrix6<f64>> {
        // x, y and the quaternion's z, half the angle.
        const AXES: [usize; 3] = [0, 1, 5];
        let mut lifted = Matrix6::zeros();
        for (r, c) in (0..3).flat_map(|r| (0..3).map(move |c| (r, c))) {
            let halves = f64::from(1 << (u8::from(r == 2) + u8::from(c == 2)));
            lifted[(AXES[r], AXES[c])] = information[(r, c)] * halves;
        }
        let turn = information[(2, 2)] * 2.0;
        lifted.view_mut((2, 2), (3, 3)).set_diagonal(&Vector3::new(least_of_shifts(information), turn, turn));
        Some(lifted)
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

/// Least information of a planar error's shifts in any direction.
fn least_of_shifts(information: &Matrix3<f64>) -> f64 {
    let (xx, xy, yy) = (information[(0, 0)], information[(0, 1)], information[(1, 1)]);
    (xx + yy) * 0.5 - ((xx - yy) * 0.5).hypot(xy)
}

/// The least eigenvalue; most matrices of information are diagonal.
fn least_eigenvalue(m: &Matrix3<f64>) -> f64 {
    let is_diagonal = m[(0, 1)] == 0.0 && m[(0, 2)] == 0.0 && m[(1, 2)] == 0.0;
    if is_diagonal { m.diagonal().min() } else { m.symmetric_eigenvalues().min() }
}

/// The quaternion with a positive real part: of the two that turn alike, the one that g2o's error uses.
fn positive(q: &UnitQuaternion<f64>) -> Quaternion<f64> {
    let q = q.into_inner();
    if q.w < 0.0 { -q } else { q }
}

impl Manifold<6> for Pose {
    const SHIFTS: usize = 3;
    const IS_PLANAR: bool = false;

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

    fn minorant(edge: &Edge<Self, 6>, from: &Self, to: &Self) -> Option<Minorant> {
        let information = &edge.information;
        if information.fixed_view::<3, 3>(0, 3).amax() > 0.0 {
            return None;
        }
        // Squares of a quaternion's vector part are linear in the rotation.
        let turns = information.fixed_view::<3, 3>(3, 3);
        let turns = (Matrix3::identity() * (turns.trace() * 0.5) - turns) * 0.25;
        let shifts = information.fixed_view::<3, 3>(0, 0).into_owned();
        let least = least_eigenvalue(&shifts);
        let off = Self::error(&edge.t_from_to, from, to).fixed_rows::<3>(0).into_owned();
        Some(Minorant::of(
            (edge.t_from_to.rotation(), edge.t_from_to.position()),
            &turns,
            least,
            &(shifts * off - off * least),
        ))
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
