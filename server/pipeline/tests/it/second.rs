//! A second sensor that sees: its keyframes lie where they belong, it leads where the pose sensor cannot, and does no harm.

use crate::drive::feed;
use percept_geometry::{CameraIntrinsics, Pose, SensorData, SensorFrame, SensorId, Timestamp, se3};
use percept_pipeline::{Pipeline, PipelineParams, Restored, RestoredContent, RestoredKeyframe};
use percept_sim::{DepthCameraParams, Lidar2dParams, Pause, SensorSuite, SimFrame, SimParams, Simulation, WorldParams};
use std::f64::consts::PI;

/// Two simulations of one drive: the pose sensor's and the second sensor's, which has the id `second`.
struct Rig {
    first: Simulation,
    second: Simulation,
    /// Where the second sensor's mount is declared to be, seen from where it is.
    declared_off: Pose,
}

fn planar(rate_hz: f64, yaw_rad: f64) -> SensorSuite {
    let lidar = Lidar2dParams { rate_hz, yaw_rad, forward_m: 0.2, fov_rad: 1.5 * PI, beams: 270, ..Default::default() };
    SensorSuite { lidar2d: Some(lidar), ..SensorSuite::none() }
}

impl Rig {
    /// A planar lidar ahead and this sensor, at speed through one room, or through a corridor of this length.
    fn new(second: SensorSuite, seconds: f64, corridor_m: Option<f64>) -> Self {
        let world = WorldParams { seed: 5, rooms: 1, person: false, corridor_m, ..WorldParams::default() };
        let mut params = SimParams { world, seed: 5, duration_s: Some(seconds), ..SimParams::default() };
        params.robot.speed_m_per_s = 0.9;
        params.robot.turn_rate_rad_per_s = 1.5;
        params.robot.look_around = corridor_m.is_none();
        params.disturbances.pauses = vec![Pause { at_s: 0.0, lasts_s: 1.0 }];
        params.sensors = planar(10.0, 0.0);
        let beside = SimParams { sensors: second, seed: 6, ..params.clone() };
        Self {
            first: Simulation::new(params).unwrap(),
            second: Simulation::new(beside).unwrap(),
            declared_off: Pose::identity(),
        }
    }

    fn aft(seconds: f64) -> Self {
        Self::new(planar(7.3, PI), seconds, None)
    }

    fn pipeline(&self, params: PipelineParams) -> Pipeline {
        let mut pipeline = Pipeline::new(params).unwrap();
        self.first.sensors().into_iter().for_each(|s| pipeline.declare_sensor(s));
        for mut spec in self.second.sensors() {
            spec.id = SensorId::from("second");
            spec.t_base_sensor = self.declared_off * spec.t_base_sensor;
            pipeline.declare_sensor(spec);
        }
        pipeline
    }

    /// Frames of both, as they arrive: those of the second sensor so much later.
    fn frames(&self, late_s: f64) -> Vec<SimFrame> {
        let second = |mut f: SimFrame| {
            f.frame.sensor = SensorId::from("second");
            (f.measured_s + late_s, f)
        };
        let mut frames: Vec<_> = self.first.frames().map(|f| (f.measured_s, f)).collect();
        frames.extend(self.second.frames().map(second));
        frames.sort_by(|a, b| a.0.total_cmp(&b.0));
        frames.into_iter().map(|(_, f)| f).collect()
    }

    fn truth(&self, stamp: Timestamp) -> Pose {
        self.first.t_world_start().inverse() * self.first.pose_at(stamp)
    }
}

/// Poses and the second sensor's keyframes in odom, by stamp.
#[derive(Default)]
struct Run {
    poses: Vec<(Timestamp, Pose, bool, Option<SensorId>)>,
    keyframes: Vec<(Timestamp, Pose)>,
}

fn run(rig: &Rig, params: PipelineParams, frames: impl IntoIterator<Item = SensorFrame>) -> (Run, Pipeline) {
    let (mut run, mut pipeline) = (Run::default(), rig.pipeline(params));
    for frame in frames {
        let report = pipeline.process(&frame).unwrap();
        let second = report.keyframe.filter(|k| k.info.sensor.0 == "second");
        run.keyframes.extend(second.map(|k| (k.info.stamp, k.t_odom_base)));
        run.poses.extend(report.pose.map(|p| (p.stamp, p.t_odom_base, !p.state.is_lost(), p.led_by)));
    }
    (run, pipeline)
}

fn all(rig: &Rig) -> impl Iterator<Item = SensorFrame> {
    rig.frames(0.0).into_iter().map(|f| f.frame)
}

fn switched_off() -> PipelineParams {
    let mut params = PipelineParams::default();
    params.slam.second_sensors.enabled = false;
    params
}

/// Root mean square of how far the second sensor's keyframes lie from where they belong beside the pose nearest in time: metres
/// and radians.
fn keyframe_error(rig: &Rig, run: &Run) -> (f64, f64) {
    let error = |(stamp, t_odom_base): &(Timestamp, Pose)| {
        let near = run.poses.iter().min_by_key(|p| p.0.nanos().abs_diff(stamp.nanos())).unwrap();
        let truth = rig.truth(near.0).inv_mul(&rig.truth(*stamp));
        let off = truth.inv_mul(&near.1.inv_mul(t_odom_base));
        (off.translation.vector.norm_squared(), off.rotation.angle().powi(2))
    };
    let n = run.keyframes.len() as f64;
    let sum = run.keyframes.iter().map(error).fold((0.0, 0.0), |a, b| (a.0 + b.0, a.1 + b.1));
    ((sum.0 / n).sqrt(), (sum.1 / n).sqrt())
}

/// How far the pose is off at most, metres.
fn worst(rig: &Rig, run: &Run) -> f64 {
    let off = |(stamp, t, ..): &(Timestamp, Pose, bool, Option<SensorId>)| {
        (rig.truth(*stamp).translation.vector - t.translation.vector).norm()
    };
    run.poses.iter().map(off).fold(0.0, f64::max)
}

#[test]
fn its_keyframes_lie_where_its_own_motion_places_them() {
    let rig = Rig::aft(24.0);
    let (registered, _) = run(&rig, PipelineParams::default(), all(&rig));
    let (placed, _) = run(&rig, switched_off(), all(&rig));
    assert!(registered.keyframes.len() > 20);
    let (m, rad) = keyframe_error(&rig, &registered);
    let before = keyframe_error(&rig, &placed);
    // Registrations err by 3 mm and 2 mrad; poses between frames of a robot that speeds its turns up add as much.
    assert!(m < 0.008 && rad < 0.006, "{m} {rad}, placed by the pose sensor {before:?}");
    assert!(before.1 > 2.0 * rad, "{rad} {before:?}");
}

#[test]
fn it_does_not_matter_in_what_order_sensors_frames_arrive() {
    let rig = Rig::aft(24.0);
    for late_s in [0.06, 0.2] {
        let frames = rig.frames(late_s).into_iter().map(|f| f.frame);
        let (run, _) = run(&rig, PipelineParams::default(), frames);
        let (m, rad) = keyframe_error(&rig, &run);
        assert!(m < 0.008 && rad < 0.006, "{late_s}: {m} {rad}");
        assert!(worst(&rig, &run) < 0.03, "{late_s}: {}", worst(&rig, &run));
    }
}

/// A depth camera with a small image, which sees the paint of walls.
fn camera() -> SensorSuite {
    let intrinsics = CameraIntrinsics::primesense();
    let s = 0.5;
    let (width, height) = (intrinsics.width / 2, intrinsics.height / 2);
    let intrinsics = CameraIntrinsics {
        width,
        height,
        fx: s * intrinsics.fx,
        fy: s * intrinsics.fy,
        cx: 0.5 * (width as f64 - 1.0),
        cy: 0.5 * (height as f64 - 1.0),
        ..intrinsics
    };
    let camera = DepthCameraParams { rate_hz: 8.3, intrinsics, ..DepthCameraParams::default() };
    SensorSuite { depth_camera: Some(camera), ..SensorSuite::none() }
}

#[test]
fn in_a_corridor_that_tells_the_pose_sensor_nothing_it_leads() {
    let rig = Rig::new(camera(), 30.0, Some(40.0));
    let (registered, _) = run(&rig, PipelineParams::default(), all(&rig));
    let (alone, _) = run(&rig, switched_off(), all(&rig));
    assert!(registered.poses.iter().all(|p| p.2), "tracked throughout");
    // 25 m at a hundredth.
    assert!(worst(&rig, &registered) < 0.25, "{} m, without {} m", worst(&rig, &registered), worst(&rig, &alone));
    assert!(worst(&rig, &alone) > 3.0 * worst(&rig, &registered) || alone.poses.iter().any(|p| !p.2));
}

fn is_ahead(f: &SimFrame) -> bool {
    f.frame.sensor.0 == "scan"
}

/// From 12 to 18 s.
fn is_dark(f: &SimFrame) -> bool {
    is_ahead(f) && (12.0..18.0).contains(&f.measured_s)
}

#[test]
fn while_the_pose_sensor_is_silent_the_pose_goes_on_and_says_by_which_sensor() {
    let rig = Rig::aft(30.0);
    let frames = rig.frames(0.0).into_iter().filter(|f| !is_dark(f)).map(|f| f.frame);
    let mut params = PipelineParams::default();
    // Else the second one, which is of the same kind, takes over after two seconds.
    params.slam.pose_sensor = "scan".to_owned();
    let (run, pipeline) = run(&rig, params, frames);
    let led: Vec<_> = run.poses.iter().filter(|p| p.3.is_some()).collect();
    // Six seconds at 7.3 Hz, less what it takes to notice.
    assert!(
        led.len() > 38 && led.iter().all(|p| p.2 && p.3.as_ref().is_some_and(|s| s.0 == "second")),
        "{}",
        led.len()
    );
    assert!(run.poses.windows(2).all(|p| p[0].0 < p[1].0 && p[1].0.seconds_since(p[0].0) < 0.5));
    assert!(worst(&rig, &run) < 0.05, "{}", worst(&rig, &run));
    let snapshot = pipeline.snapshot();
    assert!(snapshot.trajectory().all(|(_, entry)| entry.tracked) && snapshot.pose.unwrap().led_by.is_none());
    let in_dark = run.keyframes.iter().filter(|k| (12.5..18.0).contains(&rig.first.seconds_at(k.0)));
    assert!(in_dark.count() > 3, "the map goes on");
}

#[test]
fn while_the_pose_sensor_sees_nothing_the_pose_goes_on() {
    let rig = Rig::aft(30.0);
    let covered = |mut f: SimFrame| {
        if is_dark(&f)
            && let SensorData::Scan(scan) = &mut f.frame.data
        {
            scan.ranges_m.fill(f32::NAN);
        }
        f.frame
    };
    let frames: Vec<_> = rig.frames(0.0).into_iter().map(covered).collect();
    let (with, pipeline) = run(&rig, PipelineParams::default(), frames.iter().cloned());
    let lost: Vec<_> = with.poses.iter().filter(|p| !p.2).map(|p| rig.first.seconds_at(p.0)).collect();
    assert!(lost.is_empty(), "tracked throughout but at {lost:?}");
    assert!(with.poses.iter().filter(|p| p.3.is_some()).count() > 55);
    assert!(worst(&rig, &with) < 0.05, "{}", worst(&rig, &with));
    assert!(pipeline.snapshot().trajectory().all(|(_, entry)| entry.tracked));
    let (without, _) = run(&rig, switched_off(), frames);
    assert!(without.poses.iter().filter(|p| !p.2).count() > 55, "nothing else leads");
}

#[test]
fn one_that_is_mounted_otherwise_or_bad_does_no_harm() {
    let rig = Rig::aft(24.0);
    let (alone, _) = run(&rig, switched_off(), all(&rig));
    let mut bad = planar(7.3, PI);
    bad.lidar2d.as_mut().unwrap().range_noise_m = 0.15;
    let bad = Rig::new(bad, 24.0, None);
    let turned = Rig { declared_off: se3::from_xy_yaw(0.0, 0.0, 0.3), ..Rig::aft(24.0) };
    let moved = Rig { declared_off: se3::from_xy_yaw(0.3, 0.2, 0.0), ..Rig::aft(24.0) };
    for (rig, name) in [(turned, "turned"), (moved, "moved"), (bad, "bad")] {
        let (run, _) = run(&rig, PipelineParams::default(), all(&rig));
        assert!(run.poses.iter().all(|p| p.2), "{name}");
        let (with, without) = (worst(&rig, &run), worst(&rig, &alone));
        assert!(with < without + 0.01, "{name}: {with} m, without {without} m");
    }
}

#[test]
fn one_that_takes_over_for_good_goes_on_where_it_has_led_to() {
    let rig = Rig::aft(36.0);
    let frames = rig.frames(0.0).into_iter().filter(|f| f.frame.sensor.0 == "second" || f.measured_s < 12.0);
    let (run, pipeline) = run(&rig, PipelineParams::default(), frames.map(|f| f.frame));
    assert!(run.poses.iter().all(|p| p.2));
    assert!(worst(&rig, &run) < 0.06, "{}", worst(&rig, &run));
    assert!(pipeline.snapshot().pose.unwrap().led_by.is_none(), "it is the pose sensor now");
}

#[test]
fn a_restored_session_goes_on_and_second_sensors_prove_themselves_anew() {
    let rig = Rig::aft(30.0);
    let frames: Vec<_> =
        rig.frames(0.0).into_iter().filter(|f| !(20.0..24.0).contains(&f.measured_s) || !is_ahead(f)).collect();
    let split = frames.iter().position(|f| f.measured_s > 10.0).unwrap();
    let mut params = PipelineParams::default();
    params.slam.pose_sensor = "scan".to_owned();
    let mut before = rig.pipeline(params.clone());
    let stored = feed(&mut before, frames[..split].iter().map(|f| f.frame.clone()));
    let keyframe = |(t_map_base, t_odom_base, scan)| {
        let content = RestoredContent::Scan(scan);
        RestoredKeyframe { t_map_base, t_odom_base, after_gap: false, content }
    };
    let keyframes = stored.keyframes.into_iter().map(keyframe).collect();
    let mut after = rig.pipeline(params);
    after.restore(Restored { keyframes, trajectory: stored.trajectory, ..Restored::default() });
    assert_eq!(before.snapshot().layers.occupancy, after.snapshot().layers.occupancy);
    let mut num_led = 0;
    for sim in &frames[split..] {
        let Some(pose) = after.process(&sim.frame).unwrap().pose else { continue };
        let off = rig.truth(pose.stamp).translation.vector - pose.t_map_base.translation.vector;
        assert!(off.norm() < 0.06 && !pose.state.is_lost(), "{} {:?}", off.norm(), pose.state);
        num_led += usize::from(pose.led_by.is_some());
    }
    assert!(num_led > 20, "{num_led}");
}

#[test]
fn the_same_frames_give_the_same_bytes() {
    let rig = Rig::aft(12.0);
    let (a, b) = (run(&rig, PipelineParams::default(), all(&rig)), run(&rig, PipelineParams::default(), all(&rig)));
    assert_eq!(a.0.poses, b.0.poses);
    assert_eq!(a.1.snapshot().layers.occupancy, b.1.snapshot().layers.occupancy);
}
