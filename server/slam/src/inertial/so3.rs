//! Derivatives on the rotation group.
//!
//! Source: Sola, Deray, Atchuthan, "A micro Lie theory for state estimation in robotics", 2018, eq. 143 and 144.

use nalgebra::{Matrix3, Vector3};
use percept_geometry::se3::skew;

/// Right Jacobian: `Exp(w + d) == Exp(w) Exp(J d)` for small d.
pub(super) fn right_jacobian(w: &Vector3<f64>) -> Matrix3<f64> {
    let (angle2, k) = (w.norm_squared(), skew(w));
    let (a, b) = if angle2 < 1e-10 {
        (0.5 - angle2 / 24.0, 1.0 / 6.0 - angle2 / 120.0)
    } else {
        let angle = angle2.sqrt();
        ((1.0 - angle.cos()) / angle2, (angle - angle.sin()) / (angle2 * angle))
    };
    Matrix3::identity() - k * a + k * k * b
}

/// Its inverse: `Log(Exp(w) Exp(d)) == w + J d` for small d and angles below pi.
pub(super) fn right_jacobian_inverse(w: &Vector3<f64>) -> Matrix3<f64> {
    let (angle2, k) = (w.norm_squared(), skew(w));
    let b = if angle2 < 1e-8 {
        1.0 / 12.0 + angle2 / 720.0
    } else {
        let half = 0.5 * angle2.sqrt();
        (1.0 - half * half.cos() / half.sin()) / angle2
    };
    Matrix3::identity() + k * 0.5 + k * k * b
}
