//! A camera alone: poses without scale build no map; wheels or depth give the scale, and what follows is metric.

use crate::drive::{empty, simulation};
use nalgebra::{UnitQuaternion, Vector3};
use percept_evaluation::{Alignment, PosePair, absolute_error, align};
use percept_geometry::sensor::ImuSample;
use percept_geometry::{
    CameraIntrinsics, Pose, RgbImage, SensorData, SensorFrame, SensorId, SensorKind, SensorSpec, Timestamp,
};
use percept_mapping::Occupancy;
use percept_pipeline::{FrameError, FrameReport, Pipeline, PipelineParams, PoseEstimate};
use percept_sim::{SensorSuite, Simulation};
use percept_slam::{LostReason, Scale, TrackingState, Waiting};

/// Half the usual resolution, quicker to render.
fn halved(mut suite: SensorSuite) -> SensorSuite {
    if let Some(camera) = &mut suite.depth_camera {
        camera.intrinsics = CameraIntrinsics::pinhole(320, 240, 262.0, 262.0, 159.5, 119.5);
    }
    suite
}

fn alone() -> SensorSuite {
    halved(SensorSuite::only_camera())
}

fn with_wheels() -> SensorSuite {
    SensorSuite { odometry: SensorSuite::all().odometry, ..alone() }
}

fn run(pipeline: &mut Pipeline, simulation: &Simulation) -> Vec<PoseEstimate> {
    simulation.frames().filter_map(|f| pipeline.process(&f.frame).unwrap().pose).collect()
}

/// Tracked poses beside the truth of the point that they describe: the camera's while lengths are unknown, else base's.
fn pairs(simulation: &Simulation, poses: &[PoseEstimate], scale: Scale) -> Vec<PosePair> {
    let camera = simulation.sensors().into_iter().find(|s| s.kind == SensorKind::Camera).unwrap();
    let point = match scale {
        Scale::Unknown => camera.t_base_sensor.translation.vector,
        _ => nalgebra::Vector3::zeros(),
    };
    let arm = percept_geometry::Pose::from_parts(point.into(), nalgebra::UnitQuaternion::identity());
    let tracked = poses.iter().filter(|p| p.state.is_tracking() && p.scale == scale);
    tracked
        .map(|p| PosePair { stamp: p.stamp, reference: simulation.pose_at(p.stamp) * arm, estimate: p.t_map_base })
        .collect()
}

#[test]
fn a_camera_alone_is_followed_in_a_unit_of_its_own_and_builds_no_map() {
    let simulation = simulation(alone(), 4.0);
    let mut pipeline = empty(&simulation, PipelineParams::default());
    let poses = run(&mut pipeline, &simulation);
    assert_eq!(poses[0].state, TrackingState::Initialising);
    assert_eq!(poses[0].waiting, Some(Waiting::SecondView));
    assert!(poses.iter().all(|p| p.scale == Scale::Unknown));
    assert!(poses[0].scale.to_string().contains("no map is built"));
    let pairs = pairs(&simulation, &poses, Scale::Unknown);
    assert!(pairs.len() > 30, "{}", pairs.len());
    // Features are good to a pixel, 4 mm a metre: a few centimetres at the room's depths.
    let error = absolute_error(&pairs, Alignment::Sim3).unwrap().translation_m.rmse;
    assert!(error < 0.05, "{error}");
    let snapshot = pipeline.snapshot();
    assert!(snapshot.keyframes.is_empty() && snapshot.objects.is_empty());
    assert_eq!(snapshot.layers.occupancy.num_known(), 0);
    let entries: Vec<_> = snapshot.trajectory().collect();
    assert_eq!(entries.iter().filter(|(_, e)| e.tracked).count(), pairs.len());
    assert!(entries.iter().all(|(_, e)| e.anchor.is_none()));
}

#[test]
fn wheels_tell_a_camera_its_scale_and_maps_begin() {
    let simulation = simulation(with_wheels(), 6.0);
    let mut pipeline = empty(&simulation, PipelineParams::default());
    let poses = run(&mut pipeline, &simulation);
    let metric = poses.iter().position(|p| p.scale == Scale::FromOdometry).expect("no scale");
    assert!(poses[metric..].iter().all(|p| p.scale == Scale::FromOdometry && p.state.is_tracking()));
    let snapshot = pipeline.snapshot();
    assert!(snapshot.keyframes.len() > 2);
    assert!(snapshot.keyframes.iter().all(|k| k.stamp >= poses[metric].stamp));
    assert!(snapshot.layers.cloud.len() > 100);
    let pairs = pairs(&simulation, &poses, Scale::FromOdometry);
    let scale = align(&pairs, Alignment::Sim3).unwrap().scale;
    // Wheels err by some per cent.
    assert!((scale - 1.0).abs() < 0.08, "{scale}");
    // The map begins where the session did.
    let last = pairs.last().unwrap();
    let truth = simulation.t_world_start().inverse() * last.reference;
    let way = truth.translation.vector.norm();
    let off = (truth.translation.vector - last.estimate.translation.vector).norm();
    assert!(off < 0.1 * way + 0.05, "{off} of {way}");
}

#[test]
fn depth_that_comes_along_tells_a_camera_its_scale() {
    let simulation = simulation(halved(SensorSuite::only_depth_camera()), 4.0);
    let mut params = PipelineParams::default();
    params.slam.pose_sensor = "images".to_owned();
    let mut pipeline = empty(&simulation, params);
    let mut spec = simulation.sensors().remove(0);
    (spec.id, spec.kind) = ("images".into(), SensorKind::Camera);
    pipeline.declare_sensor(spec.clone());
    (spec.id, spec.kind) = ("depth".into(), SensorKind::Depth);
    pipeline.declare_sensor(spec);
    let mut newest = None;
    for (i, f) in simulation.frames().enumerate() {
        let SensorData::Rgbd(depth, color) = f.frame.data else { panic!() };
        let of = |sensor: &str, data| SensorFrame { sensor: sensor.into(), stamp: f.frame.stamp, data };
        newest = pipeline.process(&of("images", SensorData::Camera(color))).unwrap().pose;
        if i % 5 == 0 {
            pipeline.process(&of("depth", SensorData::Depth(depth))).unwrap();
        }
    }
    let newest = newest.unwrap();
    assert_eq!((newest.state, newest.scale), (TrackingState::Tracking, Scale::FromDepth));
    let snapshot = pipeline.snapshot();
    let from = |id: &str| snapshot.keyframes.iter().filter(|k| k.sensor == SensorId::from(id)).count();
    // Depth images seen from metric poses build the map, too.
    assert!(from("images") > 0 && from("depth") > 0);
}

#[test]
fn a_second_camera_tells_the_scale_whichever_image_comes_first() {
    let mut above = alone();
    above.depth_camera.iter_mut().for_each(|c| c.height_m += 0.12);
    let (first, second) = (simulation(alone(), 4.0), simulation(above, 4.0));
    for second_is_first in [false, true] {
        let mut params = PipelineParams::default();
        params.slam.pose_sensor = "low".to_owned();
        let mut pipeline = empty(&first, params);
        for (id, simulation) in [("low", &first), ("high", &second)] {
            pipeline.declare_sensor(SensorSpec { id: id.into(), ..simulation.sensors().remove(0) });
        }
        let mut newest = None;
        for (low, high) in first.frames().zip(second.frames()) {
            let mut both = [("low", low.frame), ("high", high.frame)];
            if second_is_first {
                both.swap(0, 1);
            }
            for (id, frame) in both {
                newest = pipeline.process(&SensorFrame { sensor: id.into(), ..frame }).unwrap().pose.or(newest);
            }
        }
        let newest = newest.unwrap();
        assert_eq!((newest.state, newest.scale), (TrackingState::Tracking, Scale::FromBaseline));
        assert!(pipeline.snapshot().keyframes.iter().any(|k| k.sensor == SensorId::from("low")));
    }
}

#[test]
fn gravity_levels_the_map_of_a_camera_on_a_leaning_base() {
    let simulation = simulation(with_wheels(), 4.0);
    let mut pipeline = empty(&simulation, PipelineParams::default());
    let imu = SensorSpec { id: "imu".into(), kind: SensorKind::Imu, ..simulation.sensors().remove(0) };
    let imu = SensorSpec { intrinsics: None, t_base_sensor: Pose::identity(), ..imu };
    pipeline.declare_sensor(imu.clone());
    // Base leans forward by 0.2 rad, and rests for a second before the drive.
    let up = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), 0.2).inverse() * Vector3::z();
    let start = simulation.frames().next().unwrap().frame.stamp;
    for i in 0..100 {
        let stamp = start.plus_seconds(0.01 * f64::from(i - 99));
        let rest = ImuSample { angular_velocity: Vector3::zeros(), linear_acceleration: up * 9.81 };
        pipeline.process(&SensorFrame { sensor: imu.id.clone(), stamp, data: SensorData::Imu(rest) }).unwrap();
    }
    let poses = run(&mut pipeline, &simulation);
    let first = poses.iter().find(|p| p.state.is_tracking()).unwrap();
    assert!((first.t_map_base.rotation * up - Vector3::z()).norm() < 0.05, "{first:?}");
}

/// The frame with an image of one colour instead of what was seen.
fn flat(frame: &SensorFrame, grey: u8) -> SensorFrame {
    let SensorData::Camera(image) = &frame.data else { return frame.clone() };
    let (w, h) = (image.width(), image.height());
    SensorFrame { data: SensorData::Camera(RgbImage::new(w, h, vec![grey; w * h * 3]).unwrap()), ..frame.clone() }
}

#[test]
fn images_without_use_are_answered_with_the_reason_and_the_session_lives_on() {
    let simulation = simulation(alone(), 4.0);
    let frames: Vec<SensorFrame> = simulation.frames().map(|f| f.frame).collect();
    let mut pipeline = empty(&simulation, PipelineParams::default());
    let (bad, good) = (40..43, 44);
    let mut process = |f: &SensorFrame| -> FrameReport { pipeline.process(f).unwrap() };
    frames[..bad.start].iter().for_each(|f| drop(process(f)));
    let mut reason = |i: usize, grey| match process(&flat(&frames[i], grey)).pose.unwrap().state {
        TrackingState::Lost { reason } => reason,
        state => panic!("{state:?}"),
    };
    assert_eq!(reason(40, 0), LostReason::BadExposure);
    assert_eq!(reason(41, 255), LostReason::BadExposure);
    assert_eq!(reason(42, 120), LostReason::NoTexture);
    let small = SensorData::Camera(RgbImage::new(32, 24, vec![9; 32 * 24 * 3]).unwrap());
    let small = SensorFrame { data: small, ..frames[43].clone() };
    assert!(matches!(pipeline.process(&small), Err(FrameError::IntrinsicsMismatch { width: 32, .. })));
    let back = SensorFrame { stamp: Timestamp(frames[0].stamp.nanos() - 1), ..frames[44].clone() };
    assert!(matches!(pipeline.process(&back), Err(FrameError::StampNotIncreasing { .. })));
    let found = pipeline.process(&frames[good]).unwrap().pose.unwrap();
    assert!(found.state.is_tracking() && found.is_relocalised, "{found:?}");
    assert!(!pipeline.process(&frames[good + 1]).unwrap().pose.unwrap().is_relocalised);
}

#[test]
fn a_better_sensor_ranks_above_a_camera() {
    let mut sensors = alone();
    sensors.lidar2d = SensorSuite::only_lidar2d().lidar2d;
    let simulation = simulation(sensors, 1.0);
    let mut pipeline = empty(&simulation, PipelineParams::default());
    let poses = run(&mut pipeline, &simulation);
    assert!(!poses.is_empty() && poses.iter().all(|p| p.scale == Scale::Measured));
}
