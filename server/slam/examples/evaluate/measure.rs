//! Trajectory errors, relations, and a picture of a planar map.

use super::read::Failure;
use nalgebra::{Matrix3, Point3, UnitQuaternion, Vector3, Vector6};
use percept_geometry::{Pose, se3};
use percept_slam::motion_noise::unknown_wheels;
use percept_slam::{MotionPrior, OdometryEstimate};

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

/// The same with the scale that fits best: scale and root mean square error, metres.
pub(crate) fn ate_scaled(truth: &[Pose], estimate: &[Pose]) -> (f64, f64) {
    let t = align(truth, estimate);
    let n = truth.len() as f64;
    let mean = |p: &[Pose]| p.iter().map(|t| t.translation.vector).sum::<Vector3<f64>>() / n;
    let (mt, me) = (mean(truth), mean(estimate));
    let pairs: Vec<(Vector3<f64>, Vector3<f64>)> = truth
        .iter()
        .zip(estimate)
        .map(|(a, b)| (a.translation.vector - mt, t.rotation * (b.translation.vector - me)))
        .collect();
    let scale = pairs.iter().map(|(a, b)| a.dot(b)).sum::<f64>() / pairs.iter().map(|(_, b)| b.dot(b)).sum::<f64>();
    let errors: Vec<f64> = pairs.iter().map(|(a, b)| (a - b * scale).norm()).collect();
    (scale, rmse(&errors))
}

/// Distances of aligned positions, metres.
fn position_errors(truth: &[Pose], estimate: &[Pose]) -> Vec<f64> {
    let t = align(truth, estimate);
    truth.iter().zip(estimate).map(|(a, b)| (a.translation.vector - (t * b).translation.vector).norm()).collect()
}

fn rmse(e: &[f64]) -> f64 {
    (e.iter().map(|x| x * x).sum::<f64>() / e.len().max(1) as f64).sqrt()
}

/// Root mean square absolute trajectory error after SE(3) alignment, metres.
pub(crate) fn ate_rmse(truth: &[Pose], estimate: &[Pose]) -> f64 {
    rmse(&position_errors(truth, estimate))
}

pub(crate) fn report(truth: &[Pose], estimate: &[Pose]) {
    let errors = position_errors(truth, estimate);
    let steps: Vec<Pose> = (1..truth.len())
        .map(|i| (truth[i - 1].inverse() * truth[i]).inverse() * (estimate[i - 1].inverse() * estimate[i]))
        .collect();
    let rpe_t: Vec<f64> = steps.iter().map(|d| d.translation.vector.norm()).collect();
    let rpe_r: Vec<f64> = steps.iter().map(|d| d.rotation.angle().to_degrees()).collect();
    let path: f64 = truth.windows(2).map(|w| (w[1].translation.vector - w[0].translation.vector).norm()).sum();
    println!(
        "ATE rmse {:.4} m max {:.4} m  RPE {:.4} m {:.3} deg  path {path:.2} m",
        ate_rmse(truth, estimate),
        errors.iter().fold(0f64, |a, &b| a.max(b)),
        rmse(&rpe_t),
        rmse(&rpe_r)
    );
}

/// How far odometry alone is off after ways of several lengths: what `noise.rs` of the odometry is made of.
///
/// Pairs of poses that are so far apart along the truth's way; for each length their number, how far the truth turned in between in
/// the mean, and of both errors root mean square, median and what one of twenty exceeds.
pub(crate) fn drift(truth: &[Pose], estimate: &[Pose]) {
    let mut way = vec![(0.0, 0.0)];
    for pair in truth.windows(2) {
        let step = pair[0].inverse() * pair[1];
        let (m, rad) = way[way.len() - 1];
        way.push((m + step.translation.vector.norm(), rad + step.rotation.angle()));
    }
    println!("   way m  pairs turn rad | off m: rms median p95 | off mrad: rms median p95");
    for length in [0.3, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0] {
        let (mut metres, mut radians, mut turned) = (vec![], vec![], 0.0);
        for i in 0..truth.len() {
            let j = way.partition_point(|w| w.0 < way[i].0 + length);
            let (Some(a), Some(b)) = (truth.get(j), estimate.get(j)) else { break };
            let off = (truth[i].inverse() * a).inverse() * (estimate[i].inverse() * b);
            metres.push(off.translation.vector.norm());
            radians.push(1e3 * off.rotation.angle());
            turned += way[j].1 - way[i].1;
        }
        if metres.len() < 5 {
            break;
        }
        let of = |errors: &mut Vec<f64>| {
            errors.sort_by(f64::total_cmp);
            let at = |share: f64| errors[((errors.len() - 1) as f64 * share) as usize];
            format!("{:.4} {:.4} {:.4}", rmse(errors), at(0.5), at(0.95))
        };
        let pairs = metres.len();
        println!("{length:8.1} {pairs:6} {:8.2} | {} | {}", turned / pairs as f64, of(&mut metres), of(&mut radians));
    }
}

/// How motion changes while nothing measures it: what `motion_noise.rs` is made of.
///
/// Velocities of base in base are those between frames at least 0.1 s apart. For times of several lengths: how far velocities that far
/// apart differ, and how far a pose is off that goes on with the velocity before; root mean squares of an axis of those that move, the
/// first by the root of the time, the second by half of its square.
pub(crate) fn motion(stamps_s: &[f64], poses: &[Pose], is_planar: bool) {
    let num_axes = if is_planar { (2.0, 1.0) } else { (3.0, 3.0) };
    let after = |i: usize, seconds: f64| stamps_s.partition_point(|s| *s < stamps_s[i] + seconds);
    let velocity = |i: usize| {
        let j = after(i, 0.1);
        let dt = stamps_s.get(j)? - stamps_s[i];
        (dt < 1.0).then(|| (se3::log(&poses[i].inv_mul(&poses[j])) / dt, j))
    };
    println!("  after s  pairs | velocities differ m/s/sqrt(s) rad/s/sqrt(s) | poses off m/s^2 rad/s^2");
    for seconds in [0.1, 0.2, 0.5, 1.0, 2.0, 5.0] {
        let (mut sums, mut pairs) = ([0.0; 4], 0);
        for i in 0..poses.len() {
            let Some((now, last)) = velocity(i) else { continue };
            let j = after(last, seconds);
            let Some(((then, _), dt)) =
                velocity(j.min(poses.len() - 1)).zip(stamps_s.get(j).map(|s| s - stamps_s[last]))
            else {
                continue;
            };
            if dt > 1.5 * seconds + 0.1 {
                continue;
            }
            let off = se3::log(&(poses[last] * se3::exp(&(now * dt))).inv_mul(&poses[j]));
            let parts = |v: &Vector6<f64>| (v.fixed_rows::<3>(0).norm_squared(), v.fixed_rows::<3>(3).norm_squared());
            let ((a, b), (c, d)) = (parts(&(then - now)), parts(&off));
            let square = dt.powi(4) / 4.0;
            for (sum, part) in sums.iter_mut().zip([a / dt, b / dt, c / square, d / square]) {
                *sum += part;
            }
            pairs += 1;
        }
        if pairs < 5 {
            continue;
        }
        let axes = [num_axes.0, num_axes.1, num_axes.0, num_axes.1];
        let rms: Vec<String> =
            sums.iter().zip(axes).map(|(sum, axes)| format!("{:.3}", (sum / f64::from(pairs) / axes).sqrt())).collect();
        println!("{seconds:9.1} {pairs:6} | {} {} | {} {}", rms[0], rms[1], rms[2], rms[3]);
    }
}

/// Errors since the first frame beside those that the estimates tell of: root mean squares of positions and turns.
pub(crate) fn consistency(truth: &[Pose], estimates: &[OdometryEstimate]) {
    let Some((first, start)) = truth.first().zip(estimates.first()) else { return };
    let (mut off, mut told) = (vec![], vec![]);
    for (t, e) in truth.iter().zip(estimates) {
        let d = (first.inverse() * t).inverse() * (start.t_odom_base.inverse() * e.t_odom_base);
        off.push([d.translation.vector.norm(), d.rotation.angle().to_degrees()]);
        let sigma = |from: usize| (from..from + 3).map(|k| e.covariance[(k, k)]).sum::<f64>().sqrt();
        told.push([sigma(0), sigma(3).to_degrees()]);
    }
    let of = |errors: &[[f64; 2]], k: usize| rmse(&errors.iter().map(|e| e[k]).collect::<Vec<_>>());
    println!(
        "since the start off by {:.4} m, {:.3} deg; told {:.4} m, {:.3} deg",
        of(&off, 0),
        of(&off, 1),
        of(&told, 0),
        of(&told, 1)
    );
}

/// What wheels say that say nothing of themselves, on a robot that drives in a plane.
pub(crate) fn wheel_prior(t_prev_now: &Pose) -> MotionPrior {
    let mut covariance = unknown_wheels(t_prev_now.translation.vector.norm(), t_prev_now.rotation.angle());
    (2..5).for_each(|k| covariance[(k, k)] = 1e-6);
    MotionPrior { t_prev_now: *t_prev_now, covariance }
}

/// How far one relation is off.
pub(crate) struct RelationError {
    pub(crate) metres: f64,
    pub(crate) degrees: f64,
    /// Whether its ends lie more than a minute apart.
    pub(crate) is_loop: bool,
}

/// Errors over relations `t1 t2 dx dy dz roll pitch yaw` between poses at `stamps` (s, in any order; the nearest counts).
pub(crate) fn relation_errors(rows: &[f64], stamps: &[f64], poses: &[Pose]) -> Vec<RelationError> {
    let mut order: Vec<usize> = (0..stamps.len()).collect();
    order.sort_by(|&a, &b| stamps[a].total_cmp(&stamps[b]));
    let at = |t: f64| {
        let after = order.partition_point(|&i| stamps[i] < t).min(order.len() - 1);
        let (a, b) = (order[after.saturating_sub(1)], order[after]);
        poses[if (stamps[a] - t).abs() < (stamps[b] - t).abs() { a } else { b }]
    };
    let one = |r: &[f64]| {
        let d = se3::from_xy_yaw(r[2], r[3], r[7]).inverse() * (at(r[0]).inverse() * at(r[1]));
        let (metres, degrees) = (d.translation.vector.norm(), d.rotation.angle().to_degrees());
        RelationError { metres, degrees, is_loop: (r[1] - r[0]).abs() > 60.0 }
    };
    rows.chunks_exact(8).map(one).collect()
}

/// The same in words.
pub(crate) fn relations(rows: &[f64], stamps: &[f64], poses: &[Pose]) -> String {
    let errors = relation_errors(rows, stamps, poses);
    let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len().max(1) as f64;
    let mut all: Vec<f64> = errors.iter().map(|e| e.metres).collect();
    let loops: Vec<f64> = errors.iter().filter(|e| e.is_loop).map(|e| e.metres).collect();
    let degrees: Vec<f64> = errors.iter().map(|e| e.degrees).collect();
    all.sort_by(f64::total_cmp);
    let at = |q: usize| all.get(all.len() * q / 100).copied().unwrap_or(0.0);
    format!(
        "relations mean {:.4} m, median {:.4}, p90 {:.4}, {} loops mean {:.4} m, {:.3} deg",
        mean(&all),
        at(50),
        at(90),
        loops.len(),
        mean(&loops),
        mean(&degrees)
    )
}

/// A trajectory as the TUM benchmark writes it: `t x y z qx qy qz qw`.
pub(crate) fn write_tum(path: &str, stamps: &[f64], poses: &[Pose]) -> Result<(), Failure> {
    use std::fmt::Write;
    let mut text = String::new();
    for (s, t) in stamps.iter().zip(poses) {
        let (p, [x, y, z, w]) = (t.translation.vector, se3::quaternion_xyzw(t));
        writeln!(text, "{s:.6} {:.6} {:.6} {:.6} {x:.8} {y:.8} {z:.8} {w:.8}", p.x, p.y, p.z)?;
    }
    Ok(std::fs::write(path, text)?)
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
