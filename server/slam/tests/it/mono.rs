//! A camera alone, on images drawn from the directions of rays and from the simulator.

use nalgebra::{UnitQuaternion, Vector3};
use percept_geometry::{CameraIntrinsics, Covariance6, Pose, RgbImage, SensorData, Timestamp};
use percept_sim::{SensorSuite, SimParams, Simulation, WorldParams};
use percept_slam::{
    ImageScan, LostReason, MotionPrior, Odometry, OdometryEstimate, OdometryKind, OdometryParams, Scale, Scan,
    SecondCamera, TrackingState, Waiting,
};
use std::sync::Arc;

fn camera() -> CameraIntrinsics {
    CameraIntrinsics::pinhole(320, 240, 260.0, 260.0, 159.5, 119.5)
}

fn scan(image: RgbImage) -> Scan {
    let (intrinsics, t_base_sensor) = (camera(), Pose::identity());
    Scan::Image(ImageScan { image: Arc::new(image), depth: None, second: None, intrinsics, t_base_sensor })
}

/// What a camera sees of a far sphere of coloured blocks.
fn sky(r_world_camera: &UnitQuaternion<f64>) -> RgbImage {
    let k = camera();
    let grey = |i: usize| {
        let d = (r_world_camera * k.ray((i % k.width) as f64, (i / k.width) as f64).coords).normalize();
        let cell = |x: f64| (x * 40.0).floor() as i64;
        let hash = (cell(d.x) * 7_919 + cell(d.y) * 104_729 + cell(d.z) * 1_299_709).wrapping_mul(2_654_435_761);
        30 + ((hash >> 7) & 0x7f) as u8
    };
    let data = (0..k.width * k.height).flat_map(|i| [grey(i); 3]).collect();
    RgbImage::new(k.width, k.height, data).unwrap()
}

fn flat(grey: u8) -> RgbImage {
    RgbImage::new(320, 240, vec![grey; 320 * 240 * 3]).unwrap()
}

fn run(images: impl Iterator<Item = Scan>) -> Vec<OdometryEstimate> {
    let mut odometry = Odometry::new(OdometryKind::Mono, OdometryParams::default());
    images.enumerate().map(|(i, s)| odometry.register(Timestamp::from_secs_f64(i as f64 / 15.0), &s, None)).collect()
}

#[test]
fn a_camera_that_only_turns_waits_for_parallax_and_says_so() {
    let turned = |i: usize| UnitQuaternion::from_axis_angle(&Vector3::y_axis(), 0.02 * i as f64);
    let estimates = run((0..20).map(|i| scan(sky(&turned(i)))));
    assert!(estimates.iter().all(|e| e.state == TrackingState::Initialising), "{estimates:?}");
    assert_eq!(estimates[19].waiting, Some(Waiting::NoParallax));
    assert!(estimates[19].waiting.unwrap().to_string().contains("sideways"));
    assert_eq!(estimates[19].scale, Scale::Unknown);
}

#[test]
fn images_without_use_are_lost_with_the_reason() {
    let mut small = scan(sky(&UnitQuaternion::identity()));
    let Scan::Image(s) = &mut small else { panic!() };
    s.intrinsics.width = 640;
    let estimates = run([scan(flat(120)), scan(flat(255)), scan(flat(0)), small].into_iter());
    let reasons: Vec<TrackingState> = estimates.iter().map(|e| e.state).collect();
    let lost = |reason| TrackingState::Lost { reason };
    let dark_or_bright = lost(LostReason::BadExposure);
    assert_eq!(
        reasons,
        [lost(LostReason::NoTexture), dark_or_bright, dark_or_bright, lost(LostReason::IntrinsicsMismatch)]
    );
}

/// Three seconds of the simulator's drive, with depth at one image if asked for: true and estimated poses of the camera.
fn drive(with_depth: bool) -> Vec<(Pose, OdometryEstimate)> {
    let sensors = SensorSuite::only_depth_camera();
    let world = WorldParams { seed: 1, rooms: 1, ..WorldParams::default() };
    let params = SimParams { world, sensors, duration_s: Some(3.4), ..SimParams::default() };
    let simulation = Simulation::new(params).unwrap();
    let spec = simulation.sensors().remove(0);
    let (intrinsics, t_base_sensor) = (spec.intrinsics.unwrap(), spec.t_base_sensor);
    let mut odometry = Odometry::new(OdometryKind::Mono, OdometryParams::default());
    let one = |(i, frame): (usize, percept_sim::SimFrame)| {
        let SensorData::Rgbd(depth, color) = frame.frame.data else { panic!() };
        let depth = (with_depth && i % 10 == 0).then(|| Arc::new(depth));
        let image = Arc::new(color);
        let scan = Scan::Image(ImageScan { image, depth, second: None, intrinsics, t_base_sensor });
        (frame.t_world_base, odometry.register(frame.frame.stamp, &scan, None))
    };
    simulation.frames().enumerate().map(one).collect()
}

#[test]
fn a_depth_image_now_and_then_makes_lengths_metres() {
    let placed = drive(true);
    let metric: Vec<_> = placed.iter().filter(|(_, e)| e.state.is_tracking() && e.scale == Scale::FromDepth).collect();
    assert!(metric.len() > 10, "{}", metric.len());
    let (first, last) = (metric[0], metric[metric.len() - 1]);
    let (truth, got) = (first.0.inverse() * last.0, first.1.t_odom_base.inverse() * last.1.t_odom_base);
    let way = truth.translation.vector.norm();
    // Depth is good to a per cent at these ranges, the pose to some more.
    assert!((truth.inverse() * got).translation.vector.norm() < 0.08 * way + 0.02, "{way} {got}");
}

/// The drive of [`drive`] by two cameras, the second `up` and `ahead` of the first by metres: how far off the newest pose
/// is as a share of the way since the scale was known, and from which image on it was.
fn two_cameras(up: f64, ahead: f64, seconds: f64) -> (f64, usize) {
    let simulation = |up: f64, ahead: f64| {
        let mut sensors = SensorSuite::only_camera();
        let camera = sensors.depth_camera.as_mut().unwrap();
        camera.height_m += up;
        camera.forward_m += ahead;
        let world = WorldParams { seed: 1, rooms: 1, ..WorldParams::default() };
        Simulation::new(SimParams { world, sensors, duration_s: Some(seconds), ..SimParams::default() }).unwrap()
    };
    let (first, second) = (simulation(0.0, 0.0), simulation(up, ahead));
    let (spec, second_spec) = (first.sensors().remove(0), second.sensors().remove(0));
    let t_sensor_second = spec.t_base_sensor.inv_mul(&second_spec.t_base_sensor);
    let color = |frame: percept_sim::SimFrame| {
        let SensorData::Camera(image) = frame.frame.data else { panic!() };
        Arc::new(image)
    };
    let mut odometry = Odometry::new(OdometryKind::Mono, OdometryParams::default());
    let mut placed = vec![];
    for (a, b) in first.frames().zip(second.frames()) {
        let (stamp, truth) = (a.frame.stamp, a.t_world_base);
        let second = SecondCamera { image: color(b), intrinsics: second_spec.intrinsics.unwrap(), t_sensor_second };
        let (intrinsics, t_base_sensor) = (spec.intrinsics.unwrap(), spec.t_base_sensor);
        let scan = ImageScan { image: color(a), depth: None, second: Some(second), intrinsics, t_base_sensor };
        placed.push((truth, odometry.register(stamp, &Scan::Image(scan), None)));
    }
    let metric = |e: &OdometryEstimate| e.state.is_tracking() && e.scale == Scale::FromBaseline;
    let at = placed.iter().position(|(_, e)| metric(e)).expect("a scale");
    let (begin, end) = (&placed[at], placed.iter().rfind(|(_, e)| metric(e)).unwrap());
    let (truth, got) = (begin.0.inverse() * end.0, begin.1.t_odom_base.inverse() * end.1.t_odom_base);
    assert!(truth.translation.vector.norm() > 0.3, "{truth}");
    ((truth.inverse() * got).translation.vector.norm() / truth.translation.vector.norm(), at)
}

#[test]
fn a_second_camera_at_a_known_distance_makes_lengths_metres() {
    for (up, ahead) in [(0.12, 0.0), (-0.06, 0.0), (0.05, 0.1)] {
        let (off, since) = two_cameras(up, ahead, 3.4);
        assert!(off < 0.06 && since < 3, "{up} {ahead}: {off:.3} since image {since}");
    }
}

#[test]
fn a_second_camera_holds_the_scale_where_the_robot_turns() {
    let (off, _) = two_cameras(0.12, 0.0, 10.0);
    assert!(off < 0.06, "{off:.3}");
}

/// Images of a drive through a world of its own, with the true poses of base.
fn images(seed: u64, seconds: f64) -> Vec<(Scan, Pose)> {
    let mut sensors = SensorSuite::only_camera();
    if let Some(c) = &mut sensors.depth_camera {
        c.intrinsics = camera();
    }
    let world = WorldParams { seed, rooms: 1, person: false, ..WorldParams::default() };
    let params = SimParams { world, sensors, duration_s: Some(seconds), seed, ..SimParams::default() };
    let simulation = Simulation::new(params).unwrap();
    let t_base_sensor = simulation.sensors().remove(0).t_base_sensor;
    let one = |frame: percept_sim::SimFrame| {
        let SensorData::Camera(image) = frame.frame.data else { panic!() };
        let image = Arc::new(image);
        let scan = ImageScan { image, depth: None, second: None, intrinsics: camera(), t_base_sensor };
        (Scan::Image(scan), frame.t_world_base)
    };
    simulation.frames().map(one).collect()
}

/// What good wheels say of the way from one pose to another.
fn wheels(a: &Pose, b: &Pose) -> MotionPrior {
    MotionPrior { t_prev_now: a.inverse() * b, covariance: Covariance6::identity() * 1e-5 }
}

#[test]
fn a_map_that_was_left_is_found_again_and_none_is_the_end() {
    let (here, elsewhere) = (images(1, 3.0), images(2, 4.0));
    let mut odometry = Odometry::new(OdometryKind::Mono, OdometryParams::default());
    let mut estimates = vec![];
    let mut show = |(scan, _): &(Scan, Pose), prior: Option<MotionPrior>| {
        let stamp = Timestamp::from_secs_f64(estimates.len() as f64 / 15.0);
        estimates.push(odometry.register(stamp, scan, prior.as_ref()));
    };
    show(&here[0], None);
    here.windows(2).for_each(|w| show(&w[1], Some(wheels(&w[0].1, &w[1].1))));
    // Carried into another room, the camera drives on.
    elsewhere.windows(2).for_each(|w| show(&w[1], Some(wheels(&w[0].1, &w[1].1))));
    // And back, to where it was.
    let back = here.len() - 10;
    here[back..].iter().for_each(|image| show(image, None));
    let first = &estimates[..here.len()];
    let away = &estimates[here.len()..estimates.len() - 10];
    assert_eq!(first[here.len() - 1].scale, Scale::FromOdometry);
    assert!(away[0].state.is_lost());
    assert!(away[away.len() - 1].state.is_tracking());
    let again = &estimates[estimates.len() - 10..];
    for (a, b) in first[back..].iter().zip(again).skip(2) {
        assert!(b.state.is_tracking() && b.scale == Scale::FromOdometry, "{:?}", b.state);
        // The same image fits the same place: the map was adjusted since, by millimetres.
        assert!((a.t_odom_base.inverse() * b.t_odom_base).translation.vector.norm() < 0.03);
    }
}
