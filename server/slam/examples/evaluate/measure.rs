//! Trajectory errors, relations, and a picture of a planar map.

use crate::read::Failure;
use nalgebra::{Matrix3, Point3, UnitQuaternion, Vector3, Vector6};
use percept_geometry::{Covariance6, Pose, se3};
use percept_slam::MotionPrior;

/// The transform that brings `estimate` onto `truth` with least squares of positions.
///
/// Source: Umeyama, "Least-squares estimation of transformation parameters between two point patterns", 1991.
fn align(truth: &[Pose], estimate: &[Pose]) -> Pose {
    let n = truth.len() as f64;
    let mean = |p: &[Pose]| p.iter().map(|t| t.translation.vector).sum::<Vector3<f64>>() / n;
    let (mt, me) = (mean(truth), mean(estimate));
    let mut c = Matrix3::zeros();
    for (t, e) in truth.iter().zip(estimate) {
        c += (t.translation.vector - mt) * (e.translation.vector - me).transpose();
    }
    let svd = c.svd(true, true);
    let (u, v_t) = (svd.u.unwrap_or_else(Matrix3::identity), svd.v_t.unwrap_or_else(Matrix3::identity));
    let sign = (u * v_t).determinant().signum();
    let r = u * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, sign)) * v_t;
    let rotation = UnitQuaternion::from_matrix(&r);
    Pose::from_parts((mt - rotation * me).into(), rotation)
}

pub(crate) fn report(truth: &[Pose], estimate: &[Pose]) {
    let t = align(truth, estimate);
    let errors: Vec<f64> =
        truth.iter().zip(estimate).map(|(a, b)| (a.translation.vector - (t * b).translation.vector).norm()).collect();
    let rmse = |e: &[f64]| (e.iter().map(|x| x * x).sum::<f64>() / e.len().max(1) as f64).sqrt();
    let steps: Vec<Pose> = (1..truth.len())
        .map(|i| (truth[i - 1].inverse() * truth[i]).inverse() * (estimate[i - 1].inverse() * estimate[i]))
        .collect();
    let rpe_t: Vec<f64> = steps.iter().map(|d| d.translation.vector.norm()).collect();
    let rpe_r: Vec<f64> = steps.iter().map(|d| d.rotation.angle().to_degrees()).collect();
    let path: f64 =
        truth.windows(2).map(|w| (w[1].translation.vector - w[0].translation.vector).norm()).sum();
    println!(
        "ATE rmse {:.4} m max {:.4} m  RPE {:.4} m {:.3} deg  path {path:.2} m",
        rmse(&errors),
        errors.iter().fold(0f64, |a, &b| a.max(b)),
        rmse(&rpe_t),
        rmse(&rpe_r)
    );
}

/// What wheels say, with errors that grow with the motion (10 % and 0.1 rad a radian, and a floor).
pub(crate) fn wheel_prior(t_prev_now: &Pose) -> MotionPrior {
    let (d, a) = (t_prev_now.translation.vector.norm(), t_prev_now.rotation.angle());
    let (st, sr) = (0.02 + 0.1 * d, 0.01 + 0.1 * a + 0.05 * d);
    let covariance =
        Covariance6::from_diagonal(&Vector6::new(st * st, st * st, 1e-6, 1e-6, 1e-6, sr * sr));
    MotionPrior { t_prev_now: *t_prev_now, covariance }
}

/// Mean and median errors over relations `t1 t2 dx dy dz roll pitch yaw`.
pub(crate) fn relations(rows: &[f64], stamps: &[f64], poses: &[Pose]) -> String {
    let at = |t: f64| {
        let i = stamps.partition_point(|&s| s < t - 1e-3).min(stamps.len() - 1);
        poses[i]
    };
    let (mut all, mut loops, mut angles) = (vec![], vec![], vec![]);
    for r in rows.chunks_exact(8) {
        let expected = se3::from_xy_yaw(r[2], r[3], r[7]);
        let d = expected.inverse() * (at(r[0]).inverse() * at(r[1]));
        all.push(d.translation.vector.norm());
        angles.push(d.rotation.angle().to_degrees());
        if (r[1] - r[0]).abs() > 60.0 {
            loops.push(d.translation.vector.norm());
        }
    }
    let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len().max(1) as f64;
    let (m, l, a) = (mean(&all), mean(&loops), mean(&angles));
    let n = loops.len();
    all.sort_by(f64::total_cmp);
    let median = all.get(all.len() / 2).copied().unwrap_or(0.0);
    let p90 = all.get(all.len() * 9 / 10).copied().unwrap_or(0.0);
    format!("relations mean {m:.3} m, median {median:.3}, p90 {p90:.3}, {n} loops mean {l:.3} m, {a:.2} deg")
}

/// Hits of all scans, dark on white, 0.1 m a pixel.
pub(crate) fn map_png(path: &str, scans: &[Vec<Point3<f32>>], poses: &[Pose]) -> Result<(), Failure> {
    let points: Vec<_> = scans
        .iter()
        .zip(poses)
        .flat_map(|(s, t)| s.iter().filter(|p| p.coords.norm() < 20.0).map(move |p| t * p.cast::<f64>()))
        .collect();
    let lo = points.iter().fold(Point3::new(1e9, 1e9, 0.0), |a, b| a.inf(b));
    let hi = points.iter().fold(Point3::new(-1e9, -1e9, 0.0), |a, b| a.sup(b));
    let (w, h) = (((hi.x - lo.x) * 10.0) as u32 + 1, ((hi.y - lo.y) * 10.0) as u32 + 1);
    let mut image = image::GrayImage::from_pixel(w, h, image::Luma([255]));
    for p in &points {
        let (x, y) = (((p.x - lo.x) * 10.0) as u32, h - 1 - ((p.y - lo.y) * 10.0) as u32);
        let pixel = image.get_pixel_mut(x, y);
        pixel.0[0] = pixel.0[0].saturating_sub(40);
    }
    image.save(path)?;
    println!("{path}: {w}x{h}");
    Ok(())
}
