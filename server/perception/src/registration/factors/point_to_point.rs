//! Difference of a moved source point and its target point.
//!
//! Source: Besl and McKay, "A method for registration of 3-D shapes", 1992.

use nalgebra::{Matrix3, Vector3};

/// The three residuals (m, along the target frame's axes) with their Jacobian rows at rotation `r` of
/// `t_target_source`. `source` is in the source frame, `moved` and `target` in the target frame.
#[inline]
pub fn residuals(
    r: &Matrix3<f64>,
    source: &Vector3<f64>,
    moved: &Vector3<f64>,
    target: &Vector3<f64>,
) -> [(f64, [f64; 6]); 3] {
    let e = moved - target;
    // d(R (p + v + w x p)) = R v - R skew(p) w: row i is [R_i, p x R_i].
    std::array::from_fn(|i| {
        let row = Vector3::new(r[(i, 0)], r[(i, 1)], r[(i, 2)]);
        let m = source.cross(&row);
        (e[i], [row.x, row.y, row.z, m.x, m.y, m.z])
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Point3, Vector6};
    use percept_geometry::se3;

    #[test]
    fn jacobian_matches_the_numeric_derivative() {
        let t = se3::exp(&Vector6::new(0.3, -0.5, 1.0, 0.4, 0.2, -0.7));
        let (p, q) = (Vector3::new(1.0, 2.0, -0.5), Vector3::new(0.2, 1.5, 0.3));
        let value = |xi: &Vector6<f64>| {
            let t = t * se3::exp(xi);
            let r = *t.rotation.to_rotation_matrix().matrix();
            residuals(&r, &p, &(t * Point3::from(p)).coords, &q)
        };
        let at_zero = value(&Vector6::zeros());
        for i in 0..6 {
            let mut d = Vector6::zeros();
            d[i] = 1e-6;
            let (plus, minus) = (value(&d), value(&-d));
            for k in 0..3 {
                let numeric = (plus[k].0 - minus[k].0) / 2e-6;
                assert!((numeric - at_zero[k].1[i]).abs() < 1e-8, "residual {k}, axis {i}");
            }
        }
    }
}
