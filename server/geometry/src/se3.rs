//! Rigid transforms: exponential, logarithm, adjoint, interpolation, and covariances carried along.
//!
//! Tangent vectors are ordered translation first, `[v, w]`, and perturb on the right:
//! `t * exp(xi)`. Covariances are 6x6 in the same order (x, y, z, rotation x, y, z), expressed in the
//! frame of the perturbation, the child frame b of `t_a_b`, unless a docstring names another.
//! Source: Sola, Deray, Atchuthan, "A micro Lie theory for state estimation in robotics", 2018.

use crate::GeometryError;
use nalgebra::{Isometry3, Matrix3, Matrix6, Quaternion, Translation3, UnitQuaternion, Vector3, Vector6};

/// A rigid transform; name it `t_a_b`: it maps coordinates in b to coordinates in a.
pub type Pose = Isometry3<f64>;

/// 6x6 covariance, order x, y, z, rotation x, y, z (m^2, m rad, rad^2).
pub type Covariance6 = Matrix6<f64>;

/// The skew-symmetric matrix of `w`: `skew(w) * v == w x v`.
pub fn skew(w: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::new(0.0, -w.z, w.y, w.z, 0.0, -w.x, -w.y, w.x, 0.0)
}

/// Left Jacobian of SO(3) at `w`. Eq. 145 of the source.
fn left_jacobian(w: &Vector3<f64>) -> Matrix3<f64> {
    let angle2 = w.norm_squared();
    let k = skew(w);
    let (a, b) = if angle2 < 1e-10 {
        (0.5 - angle2 / 24.0, 1.0 / 6.0 - angle2 / 120.0)
    } else {
        let angle = angle2.sqrt();
        ((1.0 - angle.cos()) / angle2, (angle - angle.sin()) / (angle2 * angle))
    };
    Matrix3::identity() + k * a + k * k * b
}

/// Inverse of the left Jacobian of SO(3) at `w`. Eq. 146 of the source.
fn left_jacobian_inverse(w: &Vector3<f64>) -> Matrix3<f64> {
    let angle2 = w.norm_squared();
    let k = skew(w);
    let b = if angle2 < 1e-8 {
        1.0 / 12.0 + angle2 / 720.0
    } else {
        let angle = angle2.sqrt();
        let half = 0.5 * angle;
        (1.0 - half * half.cos() / half.sin()) / angle2
    };
    Matrix3::identity() - k * 0.5 + k * k * b
}

/// Exponential map, `[v, w]` (m, rad) to a transform. Eq. 172 of the source.
pub fn exp(xi: &Vector6<f64>) -> Pose {
    let v = Vector3::new(xi[0], xi[1], xi[2]);
    let w = Vector3::new(xi[3], xi[4], xi[5]);
    Isometry3::from_parts(Translation3::from(left_jacobian(&w) * v), UnitQuaternion::from_scaled_axis(w))
}

/// Logarithm, a transform to `[v, w]` with `|w|` in [0, pi]. Eq. 173 of the source.
pub fn log(t: &Pose) -> Vector6<f64> {
    let w = t.rotation.scaled_axis();
    let v = left_jacobian_inverse(&w) * t.translation.vector;
    Vector6::new(v.x, v.y, v.z, w.x, w.y, w.z)
}

/// Adjoint: `t * exp(xi) == exp(adjoint(t) * xi) * t`. Eq. 175 of the source.
pub fn adjoint(t: &Pose) -> Matrix6<f64> {
    let r = *t.rotation.to_rotation_matrix().matrix();
    let mut out = Matrix6::zeros();
    out.fixed_view_mut::<3, 3>(0, 0).copy_from(&r);
    out.fixed_view_mut::<3, 3>(3, 3).copy_from(&r);
    out.fixed_view_mut::<3, 3>(0, 3).copy_from(&(skew(&t.translation.vector) * r));
    out
}

/// The pose a share `s` of the way along the geodesic from `a` (s = 0) to `b` (s = 1); extrapolates.
pub fn interpolate(a: &Pose, b: &Pose, s: f64) -> Pose {
    a * exp(&(log(&(a.inverse() * b)) * s))
}

/// Covariance of `t_a_c = t_a_b * t_b_c` for independent right perturbations of both.
pub fn compose_covariance(cov_a_b: &Covariance6, t_b_c: &Pose, cov_b_c: &Covariance6) -> Covariance6 {
    let ad = adjoint(&t_b_c.inverse());
    ad * cov_a_b * ad.transpose() + cov_b_c
}

/// A pose from translation (m) and quaternion x, y, z, w as they came from outside.
///
/// # Errors
/// `OutOfRange` for a non-finite number, `NotUnitQuaternion` if the norm is off by more than 1e-3.
pub fn pose_from_parts(field: &'static str, translation: [f64; 3], xyzw: [f64; 4]) -> Result<Pose, GeometryError> {
    for value in translation.into_iter().chain(xyzw) {
        if !value.is_finite() {
            return Err(GeometryError::OutOfRange { field, value, requirement: "finite" });
        }
    }
    let q = Quaternion::new(xyzw[3], xyzw[0], xyzw[1], xyzw[2]);
    let norm = q.norm();
    if (norm - 1.0).abs() > 1e-3 {
        return Err(GeometryError::NotUnitQuaternion { field, norm });
    }
    // A quaternion that is unit already is kept bit for bit, so that poses survive a round trip.
    let rotation =
        if (norm - 1.0).abs() < 1e-12 { UnitQuaternion::new_unchecked(q) } else { UnitQuaternion::from_quaternion(q) };
    Ok(Isometry3::from_parts(Translation3::new(translation[0], translation[1], translation[2]), rotation))
}

/// Quaternion of a pose as x, y, z, w.
pub fn quaternion_xyzw(t: &Pose) -> [f64; 4] {
    let q = t.rotation.quaternion();
    [q.i, q.j, q.k, q.w]
}

/// A planar pose (m, rad) as a rigid transform with z = roll = pitch = 0.
pub fn from_xy_yaw(x: f64, y: f64, yaw: f64) -> Pose {
    Isometry3::from_parts(Translation3::new(x, y, 0.0), UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw))
}

/// Heading of the x axis in the parent's xy plane, (-pi, pi].
pub fn yaw(t: &Pose) -> f64 {
    let x = t.rotation * Vector3::x();
    x.y.atan2(x.x)
}

/// `angle` brought into (-pi, pi].
pub fn wrap_angle(angle: f64) -> f64 {
    let a = angle.rem_euclid(std::f64::consts::TAU);
    if a > std::f64::consts::PI { a - std::f64::consts::TAU } else { a }
}

/// Rotation block made orthonormal (nearest rotation by SVD), for poses read from text files.
///
/// # Errors
/// `OutOfRange` if an entry is not finite or the block is more than 0.1 away from a rotation.
pub fn pose_from_matrix(field: &'static str, m: &nalgebra::Matrix4<f64>) -> Result<Pose, GeometryError> {
    if let Some(value) = m.iter().copied().find(|v| !v.is_finite()) {
        return Err(GeometryError::OutOfRange { field, value, requirement: "finite" });
    }
    let r: Matrix3<f64> = m.fixed_view::<3, 3>(0, 0).into_owned();
    let svd = r.svd(true, true);
    let (Some(u), Some(v_t)) = (svd.u, svd.v_t) else {
        return Err(GeometryError::OutOfRange { field, value: f64::NAN, requirement: "a rotation matrix" });
    };
    let nearest = u * v_t;
    let off = (nearest - r).norm();
    if nearest.determinant() < 0.0 || off > 0.1 {
        return Err(GeometryError::OutOfRange { field, value: off, requirement: "within 0.1 of a rotation matrix" });
    }
    let rotation = UnitQuaternion::from_rotation_matrix(&nalgebra::Rotation3::from_matrix_unchecked(nearest));
    Ok(Isometry3::from_parts(Translation3::new(m[(0, 3)], m[(1, 3)], m[(2, 3)]), rotation))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn tangent() -> impl Strategy<Value = Vector6<f64>> {
        prop::array::uniform6(-1.5..1.5f64).prop_map(|a| Vector6::from_row_slice(&a))
    }

    proptest! {
        #[test]
        fn log_inverts_exp(xi in tangent()) {
            prop_assert!((log(&exp(&xi)) - xi).norm() < 1e-9);
        }

        #[test]
        fn exp_of_a_multiple_is_a_repeated_product(xi in tangent()) {
            let once = exp(&(xi / 3.0));
            prop_assert!(log(&((once * once * once).inverse() * exp(&xi))).norm() < 1e-9);
        }

        #[test]
        fn adjoint_moves_a_perturbation_to_the_left(a in tangent(), xi in tangent()) {
            let t = exp(&a);
            let left = exp(&(adjoint(&t) * xi)) * t;
            prop_assert!(log(&(left.inverse() * (t * exp(&xi)))).norm() < 1e-8);
        }

        #[test]
        fn interpolation_ends_where_it_should(a in tangent(), b in tangent()) {
            let (a, b) = (exp(&a), exp(&b));
            prop_assert!(log(&(interpolate(&a, &b, 0.0).inverse() * a)).norm() < 1e-8);
            prop_assert!(log(&(interpolate(&a, &b, 1.0).inverse() * b)).norm() < 1e-8);
        }

        #[test]
        fn wrapped_angles_keep_their_direction(angle in -50.0..50.0f64) {
            let w = wrap_angle(angle);
            prop_assert!(w > -std::f64::consts::PI && w <= std::f64::consts::PI);
            prop_assert!((w.sin() - angle.sin()).abs() < 1e-9 && (w.cos() - angle.cos()).abs() < 1e-9);
        }
    }

    #[test]
    fn composed_covariance_matches_sampling_to_first_order() {
        let (a, b) = (Vector6::new(1.0, 2.0, 0.5, 0.3, -0.2, 0.7), Vector6::new(-0.5, 1.0, 0.0, 0.1, 0.4, -0.3));
        let (t_a_b, t_b_c) = (exp(&a), exp(&b));
        let cov = Covariance6::from_diagonal(&Vector6::new(4.0, 1.0, 2.0, 0.1, 0.2, 0.3)) * 1e-8;
        let analytic = compose_covariance(&cov, &t_b_c, &Covariance6::zeros());
        // Propagate each column of the square root through the exact composition.
        let root = cov.map(f64::sqrt);
        let mut numeric = Covariance6::zeros();
        for i in 0..6 {
            let delta = log(&((t_a_b * t_b_c).inverse() * (t_a_b * exp(&root.column(i).into_owned()) * t_b_c)));
            numeric += delta * delta.transpose();
        }
        assert!((analytic - numeric).norm() / analytic.norm() < 1e-3);
    }

    #[test]
    fn quaternions_off_by_more_than_a_thousandth_are_refused() {
        assert!(pose_from_parts("pose", [0.0; 3], [0.0, 0.0, 0.0, 1.0009]).is_ok());
        assert!(matches!(
            pose_from_parts("pose", [0.0; 3], [0.0, 0.0, 0.0, 1.002]),
            Err(GeometryError::NotUnitQuaternion { .. })
        ));
        assert!(pose_from_parts("pose", [f64::NAN, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]).is_err());
        assert!(pose_from_parts("pose", [0.0; 3], [0.0; 4]).is_err());
    }
}
