//! Distance of a moved source point from the tangent plane at its target point.
//!
//! Source: Chen and Medioni, "Object modelling by registration of multiple range images", 1992.

use nalgebra::{Matrix3, Vector3};

/// Residual (m) and Jacobian row at rotation `r` of `t_target_source`.
///
/// `source` is in the source frame, `moved` the same point in the target frame, `target` and the unit
/// `normal` are in the target frame.
#[inline]
pub fn residual(
    r: &Matrix3<f64>,
    source: &Vector3<f64>,
    moved: &Vector3<f64>,
    target: &Vector3<f64>,
    normal: &Vector3<f64>,
) -> (f64, [f64; 6]) {
    // n . R (v + w x p) = (R' n) . v + (p x R' n) . w
    let n = r.tr_mul(normal);
    let m = source.cross(&n);
    (normal.dot(&(moved - target)), [n.x, n.y, n.z, m.x, m.y, m.z])
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
        let n = Vector3::new(0.3, -0.4, 0.8).normalize();
        let value = |xi: &Vector6<f64>| {
            let t = t * se3::exp(xi);
            let r = *t.rotation.to_rotation_matrix().matrix();
            residual(&r, &p, &(t * Point3::from(p)).coords, &q, &n)
        };
        let (_, jacobian) = value(&Vector6::zeros());
        for (i, analytic) in jacobian.iter().enumerate() {
            let mut d = Vector6::zeros();
            d[i] = 1e-6;
            let numeric = (value(&d).0 - value(&-d).0) / 2e-6;
            assert!((numeric - analytic).abs() < 1e-8, "axis {i}: {numeric} {analytic}");
        }
    }
}
