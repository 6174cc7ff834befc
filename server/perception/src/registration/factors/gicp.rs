//! Information of the difference of two points that each lie on a surface.
//!
//! Source: Segal, Haehnel, Thrun, "Generalized-ICP", 2009, section III: covariances have the eigenvalues
//! [`ACROSS`] along the normal and 1 along the surface.

use nalgebra::Vector3;

/// Variance across a surface, along it it is 1 (the value of the paper's implementation).
pub const ACROSS: f64 = 1e-3;

/// Upper triangle (xx, xy, xz, yy, yz, zz) of `(C_n + C_m)^-1`, where `C_n = I - (1 - ACROSS) n n'` for a unit
/// normal `n`, and the identity (nothing known) for a zero one. Both normals in one frame.
///
/// With `U = [n m]` the sum is `2 I - c U U'`, whose inverse is `I/2 + U (I/c - U'U/2)^-1 U' / 4` (Woodbury): no
/// 3 x 3 inverse has to be made.
#[inline]
pub fn information(n: &Vector3<f64>, m: &Vector3<f64>) -> [f64; 6] {
    let alpha = 1.0 / (1.0 - ACROSS) - 0.5;
    let d = n.dot(m);
    let scale = 0.25 / (alpha * alpha - 0.25 * d * d);
    let (same, cross) = (alpha * scale, 0.5 * d * scale);
    let entry = |i: usize, j: usize| same * (n[i] * n[j] + m[i] * m[j]) + cross * (n[i] * m[j] + m[i] * n[j]);
    [0.5 + entry(0, 0), entry(0, 1), entry(0, 2), 0.5 + entry(1, 1), entry(1, 2), 0.5 + entry(2, 2)]
}

/// Covariance (same order) of a point with unit normal `n`, or the identity for a zero one.
#[inline]
pub fn covariance(n: &Vector3<f64>) -> [f64; 6] {
    let c = 1.0 - ACROSS;
    [1.0 - c * n.x * n.x, -c * n.x * n.y, -c * n.x * n.z, 1.0 - c * n.y * n.y, -c * n.y * n.z, 1.0 - c * n.z * n.z]
}

/// The inverse of a positive definite matrix given by its upper triangle.
#[inline]
pub fn inverse(a: &[f64; 6]) -> [f64; 6] {
    let [xx, xy, xz, yy, yz, zz] = *a;
    let (cx, cy, cz) = (yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy);
    let s = 1.0 / (xx * cx + xy * cy + xz * cz);
    [cx * s, cy * s, cz * s, (xx * zz - xz * xz) * s, (xy * xz - xx * yz) * s, (xx * yy - xy * xy) * s]
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Matrix3;

    fn full(a: &[f64; 6]) -> Matrix3<f64> {
        Matrix3::new(a[0], a[1], a[2], a[1], a[3], a[4], a[2], a[4], a[5])
    }

    #[test]
    fn information_is_the_inverse_of_the_summed_covariances() {
        let unit = |x, y, z| Vector3::new(x, y, z).normalize();
        for (n, m) in [
            (unit(1.0, 2.0, -0.5), unit(-0.3, 0.5, 2.0)),
            (unit(1.0, 2.0, -0.5), unit(1.0, 2.0, -0.5)),
            (unit(1.0, 2.0, -0.5), -unit(1.0, 2.001, -0.5)),
            (Vector3::zeros(), unit(0.0, 0.1, 1.0)),
            (Vector3::zeros(), Vector3::zeros()),
        ] {
            let sum = full(&covariance(&n)) + full(&covariance(&m));
            assert!((full(&information(&n, &m)) * sum - Matrix3::identity()).abs().max() < 1e-9, "{n} {m}");
            let packed = [sum.m11, sum.m12, sum.m13, sum.m22, sum.m23, sum.m33];
            assert!((full(&inverse(&packed)) * sum - Matrix3::identity()).abs().max() < 1e-9);
        }
    }
}
