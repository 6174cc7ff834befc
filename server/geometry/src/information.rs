//! Information matrices: inverse covariances, symmetric and with no direction that counts less than nothing.

use nalgebra::{Const, DMatrix, SMatrix};

/// What rounding to six digits may make of an eigenvalue that is zero, as a share of the largest element.
const ROUNDED: f64 = 1e-5;

/// Whether a symmetric matrix weighs no error with less than nothing: positive semi-definite, but for what rounding to
/// six digits does. False if an element is not finite.
pub fn is_information<const D: usize>(matrix: &SMatrix<f64, D, D>) -> bool {
    let scale = matrix.amax();
    if scale == 0.0 {
        return true;
    }
    scale.is_finite() && (matrix / scale + SMatrix::identity() * ROUNDED).cholesky().is_some()
}

/// The nearest matrix (in the Frobenius norm) that is positive semi-definite: negative eigenvalues become zero.
///
/// Source: Higham, "Computing a nearest symmetric positive semidefinite matrix", 1988. The matrix has to be symmetric and
/// finite.
pub fn nearest_information<const D: usize>(matrix: &SMatrix<f64, D, D>) -> SMatrix<f64, D, D> {
    let eigen = DMatrix::from_iterator(D, D, matrix.iter().copied()).symmetric_eigen();
    let weights = DMatrix::from_diagonal(&eigen.eigenvalues.map(|value| value.max(0.0)));
    let nearest = &eigen.eigenvectors * weights * eigen.eigenvectors.transpose();
    let nearest = nearest.fixed_resize::<D, D>(0.0);
    (nearest + nearest.transpose()) * 0.5
}

/// A symmetric matrix from its upper triangle, row by row: `D (D + 1) / 2` numbers. Those that are missing are zero.
pub fn from_upper_triangle<const D: usize>(upper: &[f64]) -> SMatrix<f64, D, D> {
    let mut matrix = SMatrix::zeros_generic(Const::<D>, Const::<D>);
    let places = (0..D).flat_map(|row| (row..D).map(move |column| (row, column)));
    for ((row, column), &value) in places.zip(upper) {
        (matrix[(row, column)], matrix[(column, row)]) = (value, value);
    }
    matrix
}

/// The upper triangle of a matrix, row by row.
pub fn upper_triangle<const D: usize>(matrix: &SMatrix<f64, D, D>) -> impl Iterator<Item = f64> + '_ {
    (0..D).flat_map(move |row| (row..D).map(move |column| matrix[(row, column)]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix3, Vector3};
    use proptest::prelude::*;

    #[test]
    fn rounding_is_forgiven_and_negative_weights_are_not() {
        assert!(is_information(&Matrix3::<f64>::zeros()));
        assert!(is_information(&Matrix3::from_diagonal(&Vector3::new(1e6, 1.0, 0.0))));
        // Of rank one, rounded to six digits.
        assert!(is_information(&from_upper_triangle::<3>(&[0.111111, 0.333333, 0.0, 1.0, 0.0, 0.0])));
        assert!(!is_information(&from_upper_triangle::<3>(&[1.0, 2.0, 0.0, 1.0, 0.0, 1.0])));
        assert!(!is_information(&Matrix3::from_diagonal(&Vector3::new(1.0, -0.1, 1.0))));
        assert!(!is_information(&Matrix3::from_diagonal(&Vector3::new(f64::NAN, 1.0, 1.0))));
    }

    proptest! {
        #[test]
        fn the_nearest_one_weighs_nothing_negatively_and_is_nearer_than_others(
            upper in prop::array::uniform6(-9.0..9.0f64), other in prop::array::uniform9(-3.0..3.0f64),
        ) {
            let matrix = from_upper_triangle::<3>(&upper);
            let nearest = nearest_information(&matrix);
            prop_assert!(is_information(&nearest));
            let root = Matrix3::from_row_slice(&other);
            prop_assert!((matrix - nearest).norm() <= (matrix - root * root.transpose()).norm() + 1e-9);
            prop_assert!(!is_information(&matrix) || (matrix - nearest).norm() < 1e-3);
            prop_assert_eq!(upper_triangle(&matrix).collect::<Vec<_>>(), upper);
        }
    }
}
