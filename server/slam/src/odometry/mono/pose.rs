//! A camera's pose among known points, from a start: Gauss-Newton with Huber's weights, outliers put aside.

use nalgebra::{Matrix2x3, Matrix2x6, Matrix6, Point3, Vector2, Vector6};
use percept_geometry::{Pose, se3};

/// 95 % bound of two squared standard normal numbers.
pub(super) const CHI2: f64 = 5.991;

/// A map point and where the image shows it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sighting {
    pub(super) point: Point3<f64>,
    pub(super) pixel: Vector2<f64>,
    /// Standard deviation, pixels.
    pub(super) sigma: f64,
}

/// A pose that fits.
#[derive(Debug, Clone)]
pub(super) struct PlacedCamera {
    pub(super) t_camera_map: Pose,
    /// Which sightings fit.
    pub(super) inliers: Vec<bool>,
    pub(super) num_inliers: usize,
    /// By sightings as good as their standard deviation; left perturbation of `t_camera_map`.
    pub(super) information: Matrix6<f64>,
    pub(super) iterations: usize,
}

/// Pixel of `p` (in the camera, z > 0) and its derivative by `p`.
#[inline]
pub(super) fn project(p: &Point3<f64>, focal: f64) -> (Vector2<f64>, Matrix2x3<f64>) {
    let iz = 1.0 / p.z;
    let (x, y) = (p.x * iz, p.y * iz);
    let f = focal * iz;
    (Vector2::new(focal * x, focal * y), Matrix2x3::new(f, 0.0, -f * x, 0.0, f, -f * y))
}

/// Derivative of the pixel by a left perturbation of `t_camera_map`.
#[inline]
pub(super) fn by_pose(by_point: &Matrix2x3<f64>, p: &Point3<f64>) -> Matrix2x6<f64> {
    let mut j = Matrix2x6::zeros();
    j.fixed_columns_mut::<3>(0).copy_from(by_point);
    j.fixed_columns_mut::<3>(3).copy_from(&(-by_point * p.coords.cross_matrix()));
    j
}

/// Squared error in standard deviations; infinite behind the camera.
#[inline]
pub(super) fn chi2(t_camera_map: &Pose, s: &Sighting, focal: f64) -> f64 {
    let p = t_camera_map * s.point;
    if p.z <= 1e-6 {
        return f64::INFINITY;
    }
    (p.coords.xy() * (focal / p.z) - s.pixel).norm_squared() / (s.sigma * s.sigma)
}

/// Four rounds, each on the sightings that fitted after the one before; none if the pose is left open.
pub(super) fn place(start: &Pose, sightings: &[Sighting], focal: f64) -> Option<PlacedCamera> {
    let mut t = *start;
    let mut inliers = vec![true; sightings.len()];
    let (mut iterations, mut information) = (0, Matrix6::zeros());
    for round in 0..4 {
        for _ in 0..8 {
            iterations += 1;
            let (h, g) = normal_equations(&t, sightings, &inliers, focal, round < 3);
            information = h;
            let step = h.cholesky()?.solve(&g);
            if !step.iter().all(|x| x.is_finite()) {
                return None;
            }
            t = se3::exp(&-step) * t;
            // Starts are products of poses found before: what a quaternion is off unit length would double with every image.
            t.rotation.renormalize();
            if step.norm() < 1e-6 {
                break;
            }
        }
        for (fits, s) in inliers.iter_mut().zip(sightings) {
            *fits = chi2(&t, s, focal) < CHI2;
        }
        if inliers.iter().filter(|&&i| i).count() < 6 {
            return None;
        }
    }
    let num_inliers = inliers.iter().filter(|&&i| i).count();
    Some(PlacedCamera { t_camera_map: t, inliers, num_inliers, information, iterations })
}

fn normal_equations(
    t: &Pose,
    sightings: &[Sighting],
    inliers: &[bool],
    focal: f64,
    robust: bool,
) -> (Matrix6<f64>, Vector6<f64>) {
    let (mut h, mut g) = (Matrix6::zeros(), Vector6::zeros());
    for (s, _) in sightings.iter().zip(inliers).filter(|(_, i)| **i) {
        let p = t * s.point;
        if p.z <= 1e-6 {
            continue;
        }
        let (pixel, by_point) = project(&p, focal);
        let error = (pixel - s.pixel) / s.sigma;
        let length = error.norm();
        let weight = if robust && length > CHI2.sqrt() { CHI2.sqrt() / length } else { 1.0 };
        let j = by_pose(&by_point, &p) / s.sigma;
        h += j.transpose() * j * weight;
        g += j.transpose() * error * weight;
    }
    (h, g)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    #[test]
    fn derivatives_agree_with_differences() {
        let t = se3::exp(&Vector6::new(0.1, -0.2, 0.3, 0.2, -0.1, 0.4));
        let (point, focal, h) = (Point3::new(0.3, -0.4, 2.0), 500.0, 1e-6);
        let at = |t: &Pose, p: &Point3<f64>| project(&(t * p), focal).0;
        let p = t * point;
        let by_point = project(&p, focal).1;
        let by_pose = by_pose(&by_point, &p);
        for k in 0..6 {
            let mut d = Vector6::zeros();
            d[k] = h;
            let numeric = (at(&(se3::exp(&d) * t), &point) - at(&(se3::exp(&-d) * t), &point)) / (2.0 * h);
            assert!((numeric - by_pose.column(k)).norm() < 1e-4 * (1.0 + numeric.norm()), "{k}");
        }
        let by_point = by_point * t.rotation.to_rotation_matrix().matrix();
        for k in 0..3 {
            let mut d = Vector3::zeros();
            d[k] = h;
            let numeric = (at(&t, &(point + d)) - at(&t, &(point - d))) / (2.0 * h);
            assert!((numeric - by_point.column(k)).norm() < 1e-4 * (1.0 + numeric.norm()), "{k}");
        }
    }

    #[test]
    fn poses_stay_rigid_however_often_one_is_predicted_from_those_before() {
        let step = se3::exp(&Vector6::new(0.01, 0.0, 0.02, 0.0, 0.01, 0.0));
        let (mut truth, mut before, mut now) = (Pose::identity(), Pose::identity(), Pose::identity());
        for _ in 0..120 {
            truth = step * truth;
            let see = |i: i32| {
                let a = f64::from(i);
                let in_camera = Point3::new((a * 1.7).sin(), (a * 2.3).cos(), 3.0 + (a * 0.9).sin());
                let pixel = project(&in_camera, 500.0).0;
                Sighting { point: truth.inverse() * in_camera, pixel, sigma: 1.0 }
            };
            let sightings: Vec<Sighting> = (0..30).map(see).collect();
            let predicted = now * before.inverse() * now;
            (before, now) = (now, place(&predicted, &sightings, 500.0).unwrap().t_camera_map);
        }
        assert!((now.rotation.norm() - 1.0).abs() < 1e-12);
        assert!((truth.inverse() * now).translation.vector.norm() < 1e-6);
    }

    #[test]
    fn the_pose_is_found_though_a_third_of_the_sightings_are_wrong() {
        let truth = se3::exp(&Vector6::new(0.1, -0.2, 0.3, 0.05, -0.1, 0.1));
        let sightings: Vec<Sighting> = (0..60)
            .map(|i| {
                let a = f64::from(i);
                let point = Point3::new((a * 1.7).sin(), (a * 2.3).cos(), 3.0 + (a * 0.9).sin());
                let wrong = if i % 3 == 0 { Vector2::new(40.0, -30.0 + a) } else { Vector2::zeros() };
                Sighting { point, pixel: project(&(truth * point), 500.0).0 + wrong, sigma: 1.0 }
            })
            .collect();
        let found = place(&Pose::identity(), &sightings, 500.0).unwrap();
        assert_eq!(found.num_inliers, 40);
        assert!(se3::log(&(found.t_camera_map * truth.inverse())).norm() < 1e-9);
    }
}
