//! A camera alone: recorded images, and the simulator's loops.

use super::read::{self, Failure};
use super::{Run, measure};
use percept_geometry::{CameraIntrinsics, Pose, SensorSpec, Timestamp};
use percept_slam::{ImageScan, OdometryKind, Scan, TrackingState};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

/// 7-Scenes by its colour images alone.
pub(crate) fn recorded(dir: &Path, stride: usize) -> Result<(), Failure> {
    let k = read::numbers(&dir.join("camera-intrinsics.txt"))?;
    let focal = std::env::var("FOCAL").ok().and_then(|f| f.parse().ok()).unwrap_or(k[0]);
    let intrinsics = CameraIntrinsics::pinhole(640, 480, focal, focal, k[2], k[5]);
    let mut names: Vec<_> = std::fs::read_dir(dir)?
        .filter_map(|e| e.ok()?.file_name().into_string().ok()?.strip_suffix(".pose.txt").map(String::from))
        .collect();
    names.sort();
    let t_base_sensor = Pose::from_parts(nalgebra::Translation3::new(0.1, 0.0, 0.3), SensorSpec::optical_rotation());
    let mut run = Run::new(OdometryKind::Mono);
    let mut truth = vec![];
    for (i, name) in names.iter().enumerate().step_by(stride) {
        let image = Arc::new(read::color(&dir.join(format!("{name}.color.jpg")))?);
        let scan = Scan::Image(ImageScan { image, depth: None, second: None, intrinsics, t_base_sensor });
        let t = read::pose_3x4(&read::numbers(&dir.join(format!("{name}.pose.txt")))?)?;
        let stamp = Timestamp::from_secs_f64(i as f64 / 15.0);
        truth.push((stamp, t * t_base_sensor.inverse()));
        run.step(stamp, &scan, None);
    }
    run.report();
    report(&run, &truth, &t_base_sensor);
    Ok(())
}

/// Scale-aligned errors of the camera's poses as they were given, and of the views as the map has them in the end.
pub(crate) fn report(run: &Run, truth: &[(Timestamp, Pose)], t_base_sensor: &Pose) {
    let rotation = Pose::from_parts(nalgebra::Translation3::identity(), t_base_sensor.rotation);
    let mount = |metric: bool| if metric { *t_base_sensor } else { rotation };
    let metric = run.estimates.last().is_some_and(|e| e.scale.is_metric());
    let (mut a, mut b) = (vec![], vec![]);
    for (e, (_, t)) in
        run.estimates.iter().zip(truth).filter(|(e, _)| e.state.is_tracking() && e.scale.is_metric() == metric)
    {
        a.push(t * t_base_sensor);
        b.push(e.t_odom_base * mount(metric));
    }
    let by_stamp: BTreeMap<Timestamp, Pose> = truth.iter().copied().collect();
    let waited = run.estimates.iter().filter(|e| e.state == TrackingState::Initialising).count();
    let (scale, rmse) = measure::ate_scaled(&a, &b);
    println!("placed {}/{} ({waited} initialising), scale {scale:.4}, ATE (Sim3) {rmse:.4} m", a.len(), truth.len());
    let views: Vec<(Timestamp, Pose)> = run.odometry.views(t_base_sensor);
    let seen: Vec<(Pose, Pose)> =
        views.iter().filter_map(|(stamp, t)| Some((by_stamp.get(stamp)? * t_base_sensor, t * mount(metric)))).collect();
    let (a, b): (Vec<Pose>, Vec<Pose>) = seen.into_iter().unzip();
    let (scale, rmse) = measure::ate_scaled(&a, &b);
    println!("views {}, scale {scale:.4}, ATE (Sim3) {rmse:.4} m", a.len());
}
