//! Difference of brightness between a moved source point and the target's surface.
//!
//! Source: Park, Zhou, Koltun, "Colored point cloud registration revisited", 2017, eqs. 6 to 12.

use nalgebra::{Matrix3, Vector3};

/// Residual (brightness, 0 to 1) and Jacobian row at rotation `r` of `t_target_source`.
///
/// `source` is in the source frame, `moved` the same point in the target frame; the target point has brightness
/// `brightness_target` and changes along its tangent plane by `gradient` (1/m, across the normal).
#[inline]
pub fn residual(
    r: &Matrix3<f64>,
    source: &Vector3<f64>,
    moved: &Vector3<f64>,
    target: &Vector3<f64>,
    gradient: &Vector3<f64>,
    brightness_source: f64,
    brightness_target: f64,
) -> (f64, [f64; 6]) {
    // The gradient lies in the tangent plane, so that projecting the point on the plane changes nothing.
    let g = r.tr_mul(gradient);
    let m = source.cross(&g);
    (brightness_target + gradient.dot(&(moved - target)) - brightness_source, [g.x, g.y, g.z, m.x, m.y, m.z])
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Point3, Vector6};
    use percept_geometry::se3;

    #[test]
    fn jacobian_matches_the_numeric_derivative() {
        let t = se3::exp(&Vector6::new(0.3, -0.5, 1.0, 0.4, 0.2, -0.7));
        let (p, q, g) = (Vector3::new(1.0, 2.0, -0.5), Vector3::new(0.2, 1.5, 0.3), Vector3::new(0.4, -1.0, 2.0));
        let value = |xi: &Vector6<f64>| {
            let t = t * se3::exp(xi);
            let r = *t.rotation.to_rotation_matrix().matrix();
            residual(&r, &p, &(t * Point3::from(p)).coords, &q, &g, 0.3, 0.6)
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
