//! A camera's pose from three points.

use super::polynomial::real_roots;
use nalgebra::{Matrix3, Point3, Rotation3, UnitQuaternion, Vector3};
use percept_geometry::Pose;

/// Every pose `t_camera_world` that puts three world points onto three unit rays of the camera; up to four.
///
/// Source: Grunert 1841 as given by Haralick et al., "Review and analysis of solutions of the three point perspective
/// pose estimation problem", 1994: a quartic in the ratio of two distances.
pub(super) fn poses(points: &[Point3<f64>; 3], rays: &[Vector3<f64>; 3], out: &mut Vec<Pose>) {
    let (a2, b2, c2) = (
        (points[1] - points[2]).norm_squared(),
        (points[0] - points[2]).norm_squared(),
        (points[0] - points[1]).norm_squared(),
    );
    let (ca, cb, cc) = (rays[1].dot(&rays[2]), rays[0].dot(&rays[2]), rays[0].dot(&rays[1]));
    let (d, s) = ((a2 - c2) / b2, (a2 + c2) / b2);
    let quartic = [
        (1.0 + d) * (1.0 + d) - 4.0 * a2 / b2 * cc * cc,
        4.0 * (-d * (1.0 + d) * cb + 2.0 * a2 / b2 * cc * cc * cb - (1.0 - s) * ca * cc),
        2.0 * (d * d - 1.0 + 2.0 * d * d * cb * cb + 2.0 * (b2 - c2) / b2 * ca * ca - 4.0 * s * ca * cb * cc
            + 2.0 * (b2 - a2) / b2 * cc * cc),
        4.0 * (d * (1.0 - d) * cb - (1.0 - s) * ca * cc + 2.0 * c2 / b2 * ca * ca * cb),
        (d - 1.0) * (d - 1.0) - 4.0 * c2 / b2 * ca * ca,
    ];
    for v in real_roots(&quartic).into_iter().filter(|v| *v > 0.0) {
        let below = 2.0 * (cc - v * ca);
        let u = ((d - 1.0) * v * v - 2.0 * d * cb * v + 1.0 + d) / below;
        let s1 = (b2 / (1.0 + v * v - 2.0 * v * cb)).sqrt();
        let distances = [s1, u * s1, v * s1];
        if !distances.iter().all(|s| s.is_finite() && *s > 0.0) {
            continue;
        }
        let seen = [0, 1, 2].map(|i| Point3::from(rays[i] * distances[i]));
        out.extend(triangle_onto(points, &seen));
    }
}

/// The rigid motion of one triangle onto another of the same shape.
fn triangle_onto(from: &[Point3<f64>; 3], to: &[Point3<f64>; 3]) -> Option<Pose> {
    let frame = |p: &[Point3<f64>; 3]| {
        let x = (p[1] - p[0]).try_normalize(1e-12)?;
        let z = x.cross(&(p[2] - p[0])).try_normalize(1e-12)?;
        Some(Matrix3::from_columns(&[x, z.cross(&x), z]))
    };
    let rotation = frame(to)? * frame(from)?.transpose();
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation));
    let middle = |p: &[Point3<f64>; 3]| (p[0].coords + p[1].coords + p[2].coords) / 3.0;
    Some(Pose::from_parts((middle(to) - rotation * middle(from)).into(), rotation))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_true_pose_is_among_the_solutions(
            rotation in [-2.0..2.0f64, -2.0..2.0, -2.0..2.0], t in [-1.0..1.0f64, -1.0..1.0, -1.0..1.0],
            seen in prop::array::uniform3([-2.0..2.0f64, -2.0..2.0, 1.0..8.0]),
        ) {
            let truth = Pose::from_parts(Vector3::from(t).into(), UnitQuaternion::from_scaled_axis(Vector3::from(rotation)));
            let seen = seen.map(Point3::from);
            let area = (seen[1] - seen[0]).cross(&(seen[2] - seen[0])).norm();
            prop_assume!(area > 0.3);
            let points = seen.map(|p| truth.inverse() * p);
            let mut found = vec![];
            poses(&points, &seen.map(|p| p.coords.normalize()), &mut found);
            let off = found.iter().map(|p| percept_geometry::se3::log(&(p.inverse() * truth)).norm()).fold(f64::INFINITY, f64::min);
            // Near the danger cylinder two solutions fall together and digits are lost.
            prop_assert!(off < 1e-2, "{} of {}", off, found.len());
        }
    }

    #[test]
    fn points_in_a_line_give_no_pose() {
        let points = [0.0, 1.0, 2.0].map(|x| Point3::new(x, 0.0, 4.0));
        let mut found = vec![];
        poses(&points, &points.map(|p| p.coords.normalize()), &mut found);
        assert!(found.is_empty());
    }
}
