//! Figures of a robot with two sensors that see: `second_sensor CASE [name=value ...]`.
//!
//! Cases: `lidars` (planar, fore and aft), `lidar-depth` (3D lidar, depth camera), `depths` (two depth cameras, ahead and
//! back), `planar-rgbd` (planar lidar, depth camera); `corridor-lidars`, `corridor-planar-rgbd`, `corridor-lidar-rgbd` (60 m
//! without features, without wheels: only the camera sees the walls' paint); `wall` (a camera that sees 1.5 m far moves the
//! pose, beside a planar lidar).
//! Values: `seed`, `seconds`, `rooms`, `speed`, `turn` (rad/s), `rate` and `rate2` (Hz), `wheels` and `imu` (0 or 1), `second` (0 leaves
//! it out), `yaw_off` and `x_off` (errors of the second sensor's declared mount, rad and m), `noise2` (factor on its noise), `late2`
//! (its frames arrive so late, s), `blind` (`silent`, `covered`: the pose sensor's frames are missing or show nothing, for `lasts` s in
//! every `every` s), `register` (0 leaves it unregistered), `distance` (m, between its frames), `width` (px),
//! `csv` (1 prints every pose).

use percept_evaluation::{Alignment, PosePair, absolute_error};
use percept_geometry::{Pose, SensorData, SensorId, SensorKind, SensorSpec, Timestamp, se3};
use percept_pipeline::{Pipeline, PipelineParams};
use percept_sim::{
    DepthCameraParams, Lidar2dParams, Lidar3dParams, OdometryParams, Pause, SensorSuite, SimFrame, SimParams,
    Simulation, WorldParams,
};
use std::collections::BTreeMap;
use std::f64::consts::PI;
use std::time::Instant;

type Failure = Box<dyn std::error::Error>;

/// What was asked for.
struct Values(Vec<String>);

impl Values {
    fn text(&self, name: &str) -> &str {
        self.0.iter().find_map(|a| a.strip_prefix(name)?.strip_prefix('=')).unwrap_or("")
    }

    fn of(&self, name: &str, default: f64) -> f64 {
        self.text(name).parse().unwrap_or(default)
    }
}

/// Two simulations of one drive: the first with the pose sensor, the other with the second sensor alone.
struct Rig {
    first: Simulation,
    second: Simulation,
    pose_sensor: SensorId,
    values: Values,
}

const SECOND: &str = "second";

fn main() -> Result<(), Failure> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let case = args.first().cloned().ok_or("usage: second_sensor CASE [name=value ...]")?;
    let rig = Rig::of(&case, Values(args.clone()))?;
    let mut figures = Figures::new(&rig);
    let mut params = PipelineParams::default();
    params.slam.pose_sensor = rig.pose_sensor.0.clone();
    params.slam.second_sensors.distance_m = rig.values.of("distance", params.slam.second_sensors.distance_m);
    params.slam.odometry.rgbd.max_width_px = rig.values.of("width", 320.0) as usize;
    params.slam.second_sensors.enabled = rig.values.of("register", 1.0) > 0.0;
    let mut pipeline = Pipeline::new(params)?;
    rig.specs().into_iter().for_each(|spec| pipeline.declare_sensor(spec));
    for sim in rig.frames() {
        let begun = Instant::now();
        let report = pipeline.process(&sim.frame)?;
        figures.took(&sim.frame.sensor, begun.elapsed().as_secs_f64() * 1e3);
        if let Some(k) = report.keyframe.as_ref().filter(|k| k.info.sensor.0 == SECOND) {
            if !rig.values.text("csv").is_empty() {
                println!(
                    "keyframe {:.2} {:?}",
                    rig.first.seconds_at(k.info.stamp),
                    figures.keyframe_error(&(k.info.stamp, k.t_odom_base))
                );
            }
            figures.keyframes.push((k.info.stamp, k.t_odom_base));
        }
        if let Some(pose) = report.pose.filter(|_| !rig.values.text("csv").is_empty()) {
            let off = figures.truth(pose.stamp).inv_mul(&pose.t_odom_base);
            let (e, sigma) = (off.translation.vector, |k: usize| pose.covariance[(k, k)].sqrt());
            println!(
                "{:.2}, {:.3}, {:.3}, {:.3}, {:.4}, {:?}, {:?}, {:.3}, {:?}",
                rig.first.seconds_at(pose.stamp),
                e.x,
                e.y,
                e.z,
                off.rotation.angle(),
                pose.state,
                pose.led_by,
                sigma(0),
                pose.degenerate_axes
            );
        }
        figures.see(&sim, &pipeline);
    }
    pipeline.settle();
    println!("{}\n{}", args.join(" "), figures.told(&pipeline)?);
    Ok(())
}

impl Rig {
    fn of(case: &str, values: Values) -> Result<Self, Failure> {
        let v = |name: &str, default: f64| values.of(name, default);
        let planar = |rate_hz, yaw_rad: f64| Lidar2dParams {
            rate_hz,
            yaw_rad,
            forward_m: 0.2,
            fov_rad: 1.5 * PI,
            beams: 270,
            ..Lidar2dParams::default()
        };
        let camera =
            |rate_hz, yaw_rad, color| DepthCameraParams { rate_hz, yaw_rad, color, ..DepthCameraParams::default() };
        let lidar = |rate_hz| Lidar3dParams { rate_hz, columns: 600, ..Lidar3dParams::default() };
        let none = SensorSuite::none;
        let with = |change: &dyn Fn(&mut SensorSuite)| {
            let mut suite = none();
            change(&mut suite);
            suite
        };
        let (rate, rate2, noise) = (v("rate", 10.0), v("rate2", 7.3), v("noise2", 1.0));
        let aft = Lidar2dParams { range_noise_m: 0.01 * noise, ..planar(rate2, PI) };
        let (a, b, pose_sensor) = match case.trim_start_matches("corridor-") {
            "lidars" => {
                (with(&|s| s.lidar2d = Some(planar(rate, 0.0))), with(&|s| s.lidar2d = Some(aft.clone())), "scan")
            }
            "lidar-depth" | "lidar-rgbd" => {
                let camera = DepthCameraParams { noise_scale: noise, ..camera(rate2, 0.0, case.ends_with("rgbd")) };
                (with(&|s| s.lidar3d = Some(lidar(rate))), with(&|s| s.depth_camera = Some(camera.clone())), "lidar")
            }
            "depths" => {
                let back = DepthCameraParams { noise_scale: noise, ..camera(rate2, PI, true) };
                let ahead = camera(rate, 0.0, true);
                (
                    with(&|s| s.depth_camera = Some(ahead.clone())),
                    with(&|s| s.depth_camera = Some(back.clone())),
                    "camera",
                )
            }
            "planar-rgbd" => {
                let camera = DepthCameraParams { noise_scale: noise, ..camera(rate2, 0.0, true) };
                (
                    with(&|s| s.lidar2d = Some(planar(rate, 0.0))),
                    with(&|s| s.depth_camera = Some(camera.clone())),
                    "scan",
                )
            }
            "wall" => {
                let camera = DepthCameraParams { range_max_m: 1.5, ..camera(rate, 0.0, false) };
                (with(&|s| s.depth_camera = Some(camera.clone())), with(&|s| s.lidar2d = Some(aft.clone())), "camera")
            }
            other => return Err(format!("unknown case {other}").into()),
        };
        let seed = v("seed", 1.0) as u64;
        let mut world = WorldParams { seed, rooms: v("rooms", 2.0) as usize, person: false, ..WorldParams::default() };
        if case.starts_with("corridor-") {
            world.corridor_m = Some(60.0);
        }
        let mut params = SimParams { world, seed, duration_s: Some(v("seconds", 80.0)), ..SimParams::default() };
        params.robot.speed_m_per_s = v("speed", 0.6);
        params.robot.turn_rate_rad_per_s = v("turn", 0.8);
        params.robot.look_around = !case.starts_with("corridor-");
        params.disturbances.pauses = vec![Pause { at_s: 0.0, lasts_s: v("rest", 2.0) }];
        params.sensors = a;
        params.sensors.odometry = (v("wheels", 0.0) > 0.0).then(OdometryParams::default);
        params.sensors.imu = (v("imu", 0.0) > 0.0).then(percept_sim::ImuParams::default);
        let second = SimParams { sensors: b, seed: seed + 1000, ..params.clone() };
        let pose_sensor = SensorId::from(pose_sensor);
        Ok(Self { first: Simulation::new(params)?, second: Simulation::new(second)?, pose_sensor, values })
    }

    fn specs(&self) -> Vec<SensorSpec> {
        let mut specs = self.first.sensors();
        for mut spec in self.second.sensors().into_iter().filter(|_| self.values.of("second", 1.0) > 0.0) {
            spec.id = SensorId::from(SECOND);
            let off = se3::from_xy_yaw(self.values.of("x_off", 0.0), 0.0, self.values.of("yaw_off", 0.0));
            spec.t_base_sensor = off * spec.t_base_sensor;
            specs.push(spec);
        }
        specs
    }

    /// Frames of both in the order in which they arrive.
    fn frames(&self) -> impl Iterator<Item = SimFrame> {
        let late = self.values.of("late2", 0.0);
        let sweep = |f: &SimFrame| if matches!(f.frame.data, SensorData::Cloud(_)) { 0.1 } else { 0.0 };
        let (mut a, mut b) = (self.first.frames().peekable(), self.second.frames().peekable());
        let with_second = self.values.of("second", 1.0) > 0.0;
        let (kind, lasts, every) =
            (self.values.text("blind").to_owned(), self.values.of("lasts", 5.0), self.values.of("every", 20.0));
        std::iter::from_fn(move || {
            let at = |f: Option<&SimFrame>, late: f64| f.map_or(f64::INFINITY, |f| f.measured_s + sweep(f) + late);
            if with_second && at(b.peek(), late) < at(a.peek(), 0.0) {
                let mut sim = b.next()?;
                sim.frame.sensor = SensorId::from(SECOND);
                return Some(Some(sim));
            }
            a.next().map(|sim| blinded(sim, &kind, lasts, every))
        })
        .flatten()
    }
}

/// The pose sensor's frame, if it sees and is sent.
fn blinded(mut sim: SimFrame, kind: &str, lasts: f64, every: f64) -> Option<SimFrame> {
    let since = sim.measured_s % every;
    let sees = !matches!(sim.frame.data.kind(), SensorKind::Imu | SensorKind::Odometry);
    if kind.is_empty() || !sees || since < every - lasts {
        return Some(sim);
    }
    if kind == "silent" {
        return None;
    }
    match &mut sim.frame.data {
        SensorData::Scan(scan) => scan.ranges_m.fill(f32::NAN),
        SensorData::Cloud(cloud) => *cloud = cloud.select(&(0..50).collect::<Vec<_>>()),
        SensorData::Depth(depth) | SensorData::Rgbd(depth, _) => {
            let dark = percept_geometry::DepthImage::new(
                depth.width(),
                depth.height(),
                vec![0.0; depth.width() * depth.height()],
            );
            *depth = dark.unwrap_or_else(|_| depth.clone());
        }
        _ => {}
    }
    Some(sim)
}

/// What a run has shown.
struct Figures<'a> {
    rig: &'a Rig,
    ms: BTreeMap<String, Vec<f64>>,
    poses: Vec<PosePair>,
    odom: Vec<PosePair>,
    keyframes: Vec<(Timestamp, Pose)>,
    /// At every tenth of a second: how far the newest pose is from where the robot is, and whether it is new and tracked.
    now: Vec<(f64, bool)>,
    next_tick: f64,
}

impl<'a> Figures<'a> {
    fn new(rig: &'a Rig) -> Self {
        let (ms, poses, odom, keyframes, now) = Default::default();
        Self { rig, ms, poses, odom, keyframes, now, next_tick: 5.0 }
    }

    fn took(&mut self, sensor: &SensorId, ms: f64) {
        self.ms.entry(sensor.0.clone()).or_default().push(ms);
    }

    fn truth(&self, stamp: Timestamp) -> Pose {
        self.rig.first.t_world_start().inverse() * self.rig.first.pose_at(stamp)
    }

    fn see(&mut self, sim: &SimFrame, pipeline: &Pipeline) {
        let Some(pose) = pipeline.snapshot().pose else { return };
        if self.odom.last().is_none_or(|p| p.stamp < pose.stamp) {
            let pair = |estimate| PosePair { stamp: pose.stamp, reference: self.truth(pose.stamp), estimate };
            let (odom, online) = (pair(pose.t_odom_base), pair(pose.t_map_base));
            self.odom.push(odom);
            self.poses.push(online);
        }
        if sim.measured_s < self.next_tick {
            return;
        }
        self.next_tick += 0.1;
        let now = self.truth(self.rig.first.params().start_stamp.plus_seconds(sim.measured_s));
        let off = now.translation.vector - pose.t_map_base.translation.vector;
        let is_new = sim.measured_s - self.rig.first.seconds_at(pose.stamp) < 0.3;
        self.now.push((off.norm(), is_new && pose.state.is_tracking()));
    }

    /// Errors of the second sensor's keyframes against the pose sensor's pose nearest in time: millimetres and milliradians.
    fn keyframe_errors(&self) -> (Vec<f64>, Vec<f64>) {
        self.keyframes.iter().filter_map(|k| self.keyframe_error(k)).unzip()
    }

    fn keyframe_error(&self, (stamp, estimate): &(Timestamp, Pose)) -> Option<(f64, f64)> {
        let near = self.odom.iter().min_by_key(|p| p.stamp.nanos().abs_diff(stamp.nanos()))?;
        let truth = near.reference.inv_mul(&self.truth(*stamp));
        let off = truth.inv_mul(&near.estimate.inv_mul(estimate));
        Some((1e3 * off.translation.vector.norm(), 1e3 * off.rotation.angle()))
    }

    fn told(&self, pipeline: &Pipeline) -> Result<String, Failure> {
        let snapshot = pipeline.snapshot();
        let tracked = snapshot.trajectory().filter(|(_, entry)| entry.tracked);
        let corrected: Vec<PosePair> = tracked
            .map(|(estimate, e)| PosePair { stamp: e.stamp, reference: self.truth(e.stamp), estimate })
            .collect();
        let (mm, mrad) = self.keyframe_errors();
        let (off, live): (Vec<f64>, Vec<bool>) = self.now.iter().copied().unzip();
        let share = live.iter().filter(|l| **l).count() as f64 / live.len().max(1) as f64;
        let costs =
            self.ms.iter().map(|(sensor, ms)| format!("{sensor} {:.2}/{:.1}", quantile(ms, 0.5), quantile(ms, 0.99)));
        Ok(format!(
            "  keyframes {}: rms {:.1} p95 {:.1} max {:.1} mm, rms {:.2} p95 {:.2} max {:.2} mrad\n  ATE odom {:.4} online {:.4} corrected {:.4} \
             m; entries {}; live {:.3}; off now p50 {:.3} p99 {:.3} max {:.3} m; mounts told {}; ms p50/p99 {}",
            mm.len(),
            rms(&mm),
            quantile(&mm, 0.95),
            quantile(&mm, 1.0),
            rms(&mrad),
            quantile(&mrad, 0.95),
            quantile(&mrad, 1.0),
            ate(&self.odom)?,
            ate(&self.poses)?,
            ate(&corrected)?,
            corrected.len(),
            share,
            quantile(&off, 0.5),
            quantile(&off, 0.99),
            quantile(&off, 1.0),
            snapshot.mount_offsets.len(),
            costs.collect::<Vec<_>>().join(", ")
        ))
    }
}

fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|v| v * v).sum::<f64>() / values.len().max(1) as f64).sqrt()
}

fn quantile(values: &[f64], q: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.get((sorted.len().saturating_sub(1) as f64 * q) as usize).copied().unwrap_or(0.0)
}

fn ate(pairs: &[PosePair]) -> Result<f64, Failure> {
    Ok(absolute_error(pairs, Alignment::Se3)?.translation_m.rmse)
}
