//! A robot comes into a map that was given: it is found there, or starts where it was told.

use crate::drive::{empty, feed};
use percept_geometry::{Pose, SensorFrame};
use percept_mapping::given::{GivenOptions, GivenView, is_given, views_of_grid};
use percept_mapping::{DenseGrid, Occupancy as _};
use percept_pipeline::{NotEmpty, Pipeline, PipelineParams, Restored, RestoredContent, RestoredKeyframe};
use percept_sim::{SensorSuite, SimParams, Simulation, WorldParams};
use percept_slam::{LostReason, TrackingState};

/// Of the simulated planar lidar above the floor, metres.
const SENSOR_HEIGHT_M: f64 = 0.3;

fn rooms(sensors: SensorSuite, seconds: f64) -> Simulation {
    let world = WorldParams { seed: 8, rooms: 4, person: false, ..WorldParams::default() };
    Simulation::new(SimParams { world, sensors, duration_s: Some(seconds), seed: 8, ..SimParams::default() }).unwrap()
}

/// The true plan at the height of the beams, in the frame of the world, as a planar lidar sees it.
fn plan(simulation: &Simulation) -> Vec<GivenView> {
    let band = (SENSOR_HEIGHT_M - 0.01, SENSOR_HEIGHT_M + 0.01);
    let truth = simulation.world().occupancy(0.05, band).unwrap();
    let cells = truth.cells.iter().map(|c| if *c { 100 } else { 0 }).collect();
    let grid = DenseGrid::new(truth.geometry, truth.width, truth.height, cells).unwrap();
    let options = GivenOptions { range_max_m: 15.0, sensor_height_m: SENSOR_HEIGHT_M };
    views_of_grid(&grid, &options).unwrap().views
}

fn off(pipeline: &Pipeline, simulation: &Simulation) -> f64 {
    let pose = pipeline.snapshot().pose.unwrap();
    assert_eq!(pose.state, TrackingState::Tracking);
    (simulation.pose_at(pose.stamp).translation.vector - pose.t_map_base.translation.vector).xy().norm()
}

/// How many frames of the lidar there were before the robot was found.
fn frames_until_found(pipeline: &mut Pipeline, frames: &[SensorFrame]) -> Option<usize> {
    let poses = frames.iter().filter_map(|frame| pipeline.process(frame).unwrap().pose);
    let mut states = poses.map(|p| p.state).collect::<Vec<_>>().into_iter();
    assert_eq!(states.clone().next(), Some(TrackingState::Lost { reason: LostReason::Adrift }));
    states.position(|s| s == TrackingState::Tracking)
}

#[test]
fn a_robot_is_found_in_a_plan_that_was_given_and_the_plan_stays() {
    let simulation = rooms(SensorSuite::only_lidar2d(), 20.0);
    let frames: Vec<SensorFrame> = simulation.frames().map(|f| f.frame).collect();
    let mut pipeline = empty(&simulation, PipelineParams::default());
    let views = plan(&simulation);
    let given = pipeline.take_given(views.clone(), None).unwrap();
    assert_eq!(given.len(), views.len());
    let before = pipeline.snapshot().layers.occupancy.num_known();
    let found = frames_until_found(&mut pipeline, &frames).expect("never found");
    assert!(found < 60, "after {found} scans");
    pipeline.settle();
    assert!(off(&pipeline, &simulation) < 0.05, "{}", off(&pipeline, &simulation));
    let snapshot = pipeline.snapshot();
    // How long it took to find it says nothing about how sure that is.
    let sigma = snapshot.pose.as_ref().unwrap().covariance.diagonal().map(f64::sqrt);
    assert!(sigma.x < 0.2 && sigma.y < 0.2, "{sigma}");
    assert!(snapshot.layers.occupancy.num_known() >= before);
    assert!(snapshot.living_keyframes().filter(|k| is_given(&k.sensor)).count() == given.len());
    // What it saw before it was found is in the map as well.
    for (t_map_base, entry) in snapshot.trajectory().filter(|(_, e)| e.tracked) {
        let truth = simulation.pose_at(entry.stamp).translation.vector;
        assert!((truth - t_map_base.translation.vector).xy().norm() < 0.1, "{}", entry.stamp);
    }
}

#[test]
fn a_robot_starts_where_it_is_told_to_be_and_what_it_was_told_may_be_off() {
    let simulation = rooms(SensorSuite::only_lidar2d(), 4.0);
    let mut pipeline = empty(&simulation, PipelineParams::default());
    let start = simulation.t_world_start() * Pose::translation(0.15, -0.1, 0.0) * yaw(0.08);
    pipeline.take_given(plan(&simulation), Some(start)).unwrap();
    let mut frames = simulation.frames().map(|f| f.frame);
    let first = pipeline.process(&frames.next().unwrap()).unwrap().pose.unwrap();
    assert_eq!(first.state, TrackingState::Tracking);
    feed(&mut pipeline, frames);
    assert!(off(&pipeline, &simulation) < 0.05, "{}", off(&pipeline, &simulation));
}

/// What a person points out may be another place: a step along the wall, the other way round, another room.
#[test]
fn a_start_that_does_not_fit_what_is_seen_is_not_believed_and_the_robot_is_found_as_if_nothing_had_been_told() {
    let simulation = rooms(SensorSuite::only_lidar2d(), 20.0);
    let frames: Vec<SensorFrame> = simulation.frames().map(|f| f.frame).collect();
    let views = plan(&simulation);
    for off in [
        Pose::translation(1.5, 0.0, 0.0),
        Pose::translation(0.0, -1.5, 0.0),
        yaw(std::f64::consts::FRAC_PI_2),
        yaw(std::f64::consts::PI),
        Pose::translation(4.0, 4.0, 0.0),
    ] {
        let mut pipeline = empty(&simulation, PipelineParams::default());
        pipeline.take_given(views.clone(), Some(simulation.t_world_start() * off)).unwrap();
        for frame in &frames {
            let pose = pipeline.process(frame).unwrap().pose.unwrap();
            let truth = simulation.pose_at(pose.stamp).translation.vector;
            let error = (truth - pose.t_map_base.translation.vector).xy().norm();
            assert!(!pose.state.is_tracking() || error < 0.1, "{off}: {error} m off at {}", pose.stamp);
        }
        let pose = pipeline.snapshot().pose.unwrap();
        assert!(pose.state.is_tracking(), "{off}: never found");
    }
}

#[test]
fn a_robot_that_only_localises_adds_nothing_to_the_map_until_it_may() {
    let simulation = rooms(SensorSuite::only_lidar2d(), 40.0);
    let frames: Vec<SensorFrame> = simulation.frames().map(|f| f.frame).collect();
    let mut params = PipelineParams::default();
    params.slam.localisation_only = true;
    let mut pipeline = empty(&simulation, params.clone());
    // Without a map it is nowhere, and a map may still come.
    let (first, rest) = frames.split_at(20);
    for frame in first {
        let pose = pipeline.process(frame).unwrap().pose.unwrap();
        assert_eq!(pose.state, TrackingState::Lost { reason: LostReason::Adrift });
    }
    assert!(pipeline.snapshot().keyframes.is_empty());
    pipeline.take_given(plan(&simulation), None).unwrap();
    let (layers, keyframes) = (pipeline.snapshot().layers, pipeline.snapshot().keyframes.len());
    let (localising, mapping) = rest.split_at(rest.len() * 2 / 3);
    let mut num_found = 0;
    for frame in localising {
        let pose = pipeline.process(frame).unwrap().pose.unwrap();
        let truth = simulation.pose_at(pose.stamp).translation.vector;
        let error = (truth - pose.t_map_base.translation.vector).xy().norm();
        assert!(!pose.state.is_tracking() || error < 0.1, "{error} m off at {}", pose.stamp);
        num_found += usize::from(pose.state.is_tracking());
    }
    assert!(num_found + 60 > localising.len(), "{num_found} of {}", localising.len());
    let snapshot = pipeline.snapshot();
    assert_eq!(snapshot.keyframes.len(), keyframes);
    assert_eq!(snapshot.layers.occupancy, layers.occupancy);
    // Where it was is known all the same.
    assert_eq!(snapshot.trajectory().filter(|(_, e)| e.tracked).count(), num_found);
    for (t_map_base, entry) in snapshot.trajectory().filter(|(_, e)| e.tracked) {
        let truth = simulation.pose_at(entry.stamp).translation.vector;
        assert!((truth - t_map_base.translation.vector).xy().norm() < 0.1, "{}", entry.stamp);
    }

    params.slam.localisation_only = false;
    pipeline.set_params(params.clone()).unwrap();
    feed(&mut pipeline, mapping.iter().cloned());
    let mapped = pipeline.snapshot().keyframes.len();
    assert!(mapped > keyframes, "{mapped}");
    assert!(off(&pipeline, &simulation) < 0.05, "{}", off(&pipeline, &simulation));
    // And back: in a map of its own.
    params.slam.localisation_only = true;
    pipeline.set_params(params).unwrap();
    feed(&mut pipeline, frames.iter().map(|f| SensorFrame { stamp: f.stamp.plus_seconds(50.0), ..f.clone() }));
    assert_eq!(pipeline.snapshot().keyframes.len(), mapped);
}

#[test]
fn a_depth_camera_cannot_be_found_in_a_plan_but_starts_where_it_is_told_to_be() {
    let simulation = rooms(SensorSuite::only_depth_camera(), 2.0);
    for localisation_only in [false, true] {
        let mut params = PipelineParams::default();
        params.slam.localisation_only = localisation_only;
        let mut pipeline = empty(&simulation, params);
        let given = pipeline.take_given(plan(&simulation), Some(simulation.t_world_start())).unwrap();
        feed(&mut pipeline, simulation.frames().map(|f| f.frame));
        assert!(off(&pipeline, &simulation) < 0.05, "{}", off(&pipeline, &simulation));
        assert_eq!(pipeline.snapshot().keyframes.len() == given.len(), localisation_only);
    }
}

#[test]
fn a_given_map_outlives_a_restart_before_a_robot_comes() {
    let simulation = rooms(SensorSuite::only_lidar2d(), 12.0);
    let frames: Vec<SensorFrame> = simulation.frames().map(|f| f.frame).collect();
    let mut before = empty(&simulation, PipelineParams::default());
    let stored = before.take_given(plan(&simulation), None).unwrap();
    let keyframes = stored.into_iter().map(|k| RestoredKeyframe {
        t_map_base: k.info.t_map_base,
        t_odom_base: k.t_odom_base,
        after_gap: k.after_gap,
        content: RestoredContent::Scan(k.scan),
    });
    let keyframes: Vec<RestoredKeyframe> = keyframes.collect();
    let mut restored = empty(&simulation, PipelineParams::default());
    restored.restore(Restored { keyframes: keyframes.clone(), ..Restored::default() });
    assert_eq!(restored.snapshot().layers.occupancy, before.snapshot().layers.occupancy);
    let found = [&mut before, &mut restored].map(|p| frames_until_found(p, &frames));
    assert!(found[0].is_some() && found[0] == found[1], "{found:?}");
    assert_eq!(before.snapshot().pose, restored.snapshot().pose);

    let start = Some(simulation.t_world_start());
    let mut told = empty(&simulation, PipelineParams::default());
    told.restore(Restored { keyframes, start, ..Restored::default() });
    let first = told.process(&frames[0]).unwrap().pose.unwrap();
    assert_eq!(first.state, TrackingState::Tracking, "where it starts does, too");
}

#[test]
fn a_session_that_has_a_map_takes_no_other() {
    let simulation = rooms(SensorSuite::only_lidar2d(), 1.0);
    let mut pipeline = empty(&simulation, PipelineParams::default());
    feed(&mut pipeline, simulation.frames().map(|f| f.frame));
    let version = pipeline.snapshot().map_version;
    assert!(matches!(pipeline.take_given(plan(&simulation), None), Err(NotEmpty)));
    assert_eq!(pipeline.snapshot().map_version, version);
}

fn yaw(rad: f64) -> Pose {
    Pose::from_parts(nalgebra::Translation3::identity(), nalgebra::UnitQuaternion::from_euler_angles(0.0, 0.0, rad))
}
