//! A camera alone: recorded images, and the simulator's loops.

use super::read::{self, Failure};
use super::{Run, measure};
use percept_geometry::{CameraIntrinsics, Pose, SensorData, SensorSpec, Timestamp};
use percept_sim::{SensorSuite, SimFrame, SimParams, Simulation, WorldParams};
use percept_slam::{ImageScan, OdometryKind, OdometryParams, Scan, SecondCamera, TrackingState};
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

/// The simulator's drive through its rooms, seen by the colour images of its camera.
pub(crate) fn simulated(args: &[String]) -> Result<(), Failure> {
    let has = |flag: &str| args.iter().any(|a| a == flag);
    let number = |flag: &str| args.iter().position(|a| a == flag).and_then(|i| args.get(i + 1)?.parse::<usize>().ok());
    let mut sensors = SensorSuite::only_depth_camera();
    sensors.odometry = has("--wheels").then(percept_sim::OdometryParams::default);
    let seed = args.first().and_then(|s| s.parse().ok()).unwrap_or(1);
    let world = WorldParams { seed, rooms: number("--rooms").unwrap_or(1), ..WorldParams::default() };
    let laps = number("--laps").unwrap_or(1);
    let duration_s = number("--seconds").map(|s| s as f64);
    let params = SimParams { world, sensors, laps, duration_s, ..SimParams::default() };
    let simulation = Simulation::new(params.clone())?;
    // The same drive, seen by a camera that sits so many millimetres higher.
    let above = number("--second").map(|mm| Simulation::new(raised(params, mm as f64 * 1e-3))).transpose()?;
    let mut above = above.as_ref().map(|simulation| (simulation.sensors(), simulation.frames()));
    let spec = simulation.sensors().into_iter().find(|s| s.intrinsics.is_some()).ok_or("no camera")?;
    let intrinsics = spec.intrinsics.ok_or("no intrinsics")?;
    let mut params = OdometryParams::default();
    params.mono.close_loops = !has("--no-loops");
    let mut run = Run::with(OdometryKind::Mono, params);
    let (mut truth, mut wheels, mut last) = (vec![], None, None);
    for frame in simulation.frames() {
        let (depth, color) = match frame.frame.data {
            SensorData::Odometry(sample) => {
                wheels = Some(sample.t_odom_base);
                continue;
            }
            SensorData::Rgbd(depth, color) => (depth, color),
            _ => continue,
        };
        let depth = (has("--depth") && truth.len() % 30 == 0).then(|| Arc::new(depth));
        let (image, t_base_sensor) = (Arc::new(color), spec.t_base_sensor);
        let second = above.as_mut().and_then(|(sensors, frames)| second_image(sensors, frames, &t_base_sensor));
        let scan = Scan::Image(ImageScan { image, depth, second, intrinsics, t_base_sensor });
        let prior = last.zip(wheels).map(|(a, b): (Pose, Pose)| measure::wheel_prior(&(a.inverse() * b)));
        truth.push((frame.frame.stamp, frame.t_world_base));
        run.step(frame.frame.stamp, &scan, prior.as_ref());
        last = wheels;
    }
    println!("{} images, {:.1} m", truth.len(), simulation.path().lap_length_m());
    run.report();
    report(&run, &truth, &spec.t_base_sensor);
    drift(&run, &truth, &spec.t_base_sensor);
    Ok(())
}

fn raised(mut params: SimParams, by_m: f64) -> SimParams {
    params.sensors.depth_camera.iter_mut().for_each(|c| c.height_m += by_m);
    params
}

/// The next image of the camera above.
fn second_image(
    sensors: &[SensorSpec],
    frames: &mut impl Iterator<Item = SimFrame>,
    t_base_sensor: &Pose,
) -> Option<SecondCamera> {
    let spec = sensors.iter().find(|s| s.intrinsics.is_some())?;
    let color = frames.find_map(|f| if let SensorData::Rgbd(_, color) = f.frame.data { Some(color) } else { None })?;
    let t_sensor_second = t_base_sensor.inv_mul(&spec.t_base_sensor);
    Some(SecondCamera { image: Arc::new(color), intrinsics: spec.intrinsics?, t_sensor_second })
}

/// The map's scale (by the steps between its views) in its first and its last fifth: their ratio is the drift.
fn drift(run: &Run, truth: &[(Timestamp, Pose)], t_base_sensor: &Pose) {
    let by_stamp: BTreeMap<Timestamp, Pose> = truth.iter().copied().collect();
    let views = run.odometry.views(t_base_sensor);
    let mut ratios = vec![];
    for w in views.windows(2) {
        let (Some(a), Some(b)) = (by_stamp.get(&w[0].0), by_stamp.get(&w[1].0)) else { continue };
        let true_step = (a * t_base_sensor).inverse() * (b * t_base_sensor);
        let seen = (w[0].1.inverse() * w[1].1).translation.vector.norm();
        if true_step.translation.vector.norm() > 0.1 {
            ratios.push(true_step.translation.vector.norm() / seen);
        }
    }
    let median = |r: &[f64]| {
        let mut r = r.to_vec();
        r.sort_by(f64::total_cmp);
        r.get(r.len() / 2).copied().unwrap_or(f64::NAN)
    };
    let fifths: Vec<f64> = ratios.chunks((ratios.len() / 5).max(1)).take(5).map(median).collect();
    println!("metres by unit along the way {fifths:.3?}");
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
