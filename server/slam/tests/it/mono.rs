//! A camera alone, on images drawn from the directions of rays and from the simulator.

use nalgebra::{UnitQuaternion, Vector3};
use percept_geometry::{CameraIntrinsics, Pose, RgbImage, SensorData, Timestamp};
use percept_sim::{SensorSuite, SimParams, Simulation, WorldParams};
use percept_slam::{
    ImageScan, LostReason, Odometry, OdometryEstimate, OdometryKind, OdometryParams, Scale, Scan, TrackingState,
    Waiting,
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
