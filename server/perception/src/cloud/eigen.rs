//! Eigenvalues and eigenvectors of symmetric 3 x 3 matrices, in closed form.

use nalgebra::{Matrix3, Vector3};

/// Eigen decomposition of a symmetric matrix, eigenvalues ascending.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SymmetricEigen3 {
    /// Eigenvalues, smallest first.
    pub values: [f64; 3],
    /// Unit eigenvectors in the order of `values`; a right-handed frame. Signs are arbitrary but fixed.
    pub vectors: [Vector3<f64>; 3],
}

/// Decomposes a symmetric matrix; only the upper triangle is read. Non-finite input gives non-finite output.
///
/// The best separated eigenvalue comes from the trigonometric solution of the characteristic polynomial
/// (Smith, "Eigenvalues of a symmetric 3 x 3 matrix", 1961), its vector from the largest cross product of
/// rows; the other two from the 2 x 2 problem left in the plane across it, which keeps close and zero
/// eigenvalues accurate (after Eberly, "A robust eigensolver for 3 x 3 symmetric matrices", 2014).
pub fn symmetric_eigen3(m: &Matrix3<f64>) -> SymmetricEigen3 {
    let scale = [m.m11, m.m12, m.m13, m.m22, m.m23, m.m33].iter().fold(0.0f64, |s, v| s.max(v.abs()));
    if scale <= f64::MIN_POSITIVE {
        return SymmetricEigen3 { values: [0.0; 3], vectors: [Vector3::x(), Vector3::y(), Vector3::z()] };
    }
    let [xx, xy, xz, yy, yz, zz] = [m.m11, m.m12, m.m13, m.m22, m.m23, m.m33].map(|v| v * (1.0 / scale));
    let a = Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz);
    let mean = (xx + yy + zz) * (1.0 / 3.0);
    let b = a - Matrix3::from_diagonal_element(mean);
    let off = xy * xy + xz * xz + yz * yz;
    let p = ((b.m11 * b.m11 + b.m22 * b.m22 + b.m33 * b.m33 + 2.0 * off) * (1.0 / 6.0)).sqrt();
    if p <= 1e-15 {
        // A multiple of the identity: every frame is a frame of eigenvectors.
        return SymmetricEigen3 { values: [mean * scale; 3], vectors: [Vector3::x(), Vector3::y(), Vector3::z()] };
    }
    let r = (b.determinant() / (2.0 * p * p * p)).clamp(-1.0, 1.0);
    let angle = r.acos() * (1.0 / 3.0);
    // With r >= 0 the largest eigenvalue stands apart, otherwise the smallest.
    let apart = if r >= 0.0 { angle.cos() } else { (angle + 2.0 * std::f64::consts::FRAC_PI_3).cos() };
    let axis = null_vector(&(b - Matrix3::from_diagonal_element(2.0 * p * apart)));
    let lambda = axis.dot(&(a * axis));
    let ((low, low_axis), (high, high_axis)) = plane_pair(&a, &axis);
    let (values, vectors) = if r >= 0.0 {
        ([low, high, lambda], [low_axis, high_axis, low_axis.cross(&high_axis)])
    } else {
        ([lambda, low, high], [low_axis.cross(&high_axis), low_axis, high_axis])
    };
    SymmetricEigen3 { values: values.map(|v| v * scale), vectors }
}

/// The direction that a symmetric matrix of rank two sends to zero.
fn null_vector(m: &Matrix3<f64>) -> Vector3<f64> {
    // It is symmetric: columns are rows.
    let rows: [Vector3<f64>; 3] = std::array::from_fn(|i| m.column(i).into_owned());
    let crosses = [rows[0].cross(&rows[1]), rows[1].cross(&rows[2]), rows[2].cross(&rows[0])];
    let (mut best, mut most) = (crosses[0], crosses[0].norm_squared());
    for c in &crosses[1..] {
        let square = c.norm_squared();
        (best, most) = if square > most { (*c, square) } else { (best, most) };
    }
    best * (1.0 / most.sqrt())
}

type Pair = (f64, Vector3<f64>);

/// The two eigenpairs across `axis`, smaller first.
fn plane_pair(a: &Matrix3<f64>, axis: &Vector3<f64>) -> (Pair, Pair) {
    let u = across(axis);
    let v = axis.cross(&u);
    let (au, av) = (a * u, a * v);
    let (uu, uv, vv) = (u.dot(&au), u.dot(&av), v.dot(&av));
    // One Jacobi rotation (Golub and Van Loan, section 8.5.2) diagonalises the 2 x 2 matrix.
    let (c, s, t) = if uv == 0.0 {
        (1.0, 0.0, 0.0)
    } else {
        let tau = (vv - uu) / (2.0 * uv);
        // Where the square of tau is beyond all numbers, t is nothing.
        let t = tau.signum() / (tau.abs() + (1.0 + tau * tau).sqrt());
        let c = 1.0 / (1.0 + t * t).sqrt();
        (c, t * c, t)
    };
    let (first, second) = ((uu - t * uv, u * c - v * s), (vv + t * uv, u * s + v * c));
    if first.0 <= second.0 { (first, second) } else { (second, first) }
}

/// Some unit vector across a unit vector.
fn across(n: &Vector3<f64>) -> Vector3<f64> {
    let v = if n.x.abs() > n.y.abs() { Vector3::new(-n.z, 0.0, n.x) } else { Vector3::new(0.0, n.z, -n.y) };
    v * (1.0 / v.norm())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn check(m: Matrix3<f64>) -> Result<(), TestCaseError> {
        let ours = symmetric_eigen3(&m);
        let mut theirs: Vec<f64> = m.symmetric_eigen().eigenvalues.iter().copied().collect();
        theirs.sort_by(f64::total_cmp);
        let scale = m.norm().max(1e-300);
        for (a, b) in ours.values.iter().zip(&theirs) {
            prop_assert!((a - b).abs() <= 1e-12 * scale, "{:?} against {:?}", ours.values, theirs);
        }
        for (value, vector) in ours.values.iter().zip(&ours.vectors) {
            prop_assert!((vector.norm() - 1.0).abs() < 1e-10);
            prop_assert!((m * vector - vector * *value).norm() <= 1e-7 * scale);
        }
        prop_assert!((Matrix3::from_columns(&ours.vectors).determinant() - 1.0).abs() < 1e-7);
        Ok(())
    }

    proptest! {
        #[test]
        fn agrees_with_nalgebra(v in prop::array::uniform6(-5.0..5.0f64), exponent in -12..12i32) {
            let s = 10f64.powi(exponent);
            check(Matrix3::new(v[0], v[1], v[2], v[1], v[3], v[4], v[2], v[4], v[5]) * s)?;
        }

        #[test]
        fn agrees_with_nalgebra_on_flat_and_thin_scatter(
            axis in prop::array::uniform3(-3.0..3.0f64), first in 0.0..1.0f64, thin in prop_oneof![Just(0.0), Just(1e-9), Just(1e-4)],
        ) {
            let r = nalgebra::Rotation3::new(Vector3::from(axis));
            for values in [[thin, first, 1.0], [thin, thin, 1.0], [thin, 1.0, 1.0], [first, first, first]] {
                check(r.matrix() * Matrix3::from_diagonal(&Vector3::from(values)) * r.matrix().transpose())?;
            }
        }
    }
}
