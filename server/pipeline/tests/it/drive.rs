//! Short simulated drives, shared by the tests.

use percept_geometry::{KeyframeScan, Pose, SensorFrame};
use percept_mapping::Occupancy;
use percept_pipeline::{Pipeline, PipelineParams};
use percept_sim::{SensorSuite, SimParams, Simulation, WorldParams};
use std::sync::Arc;

pub(crate) fn simulation(sensors: SensorSuite, seconds: f64) -> Simulation {
    let world = WorldParams { seed: 5, rooms: 1, person: false, ..WorldParams::default() };
    Simulation::new(SimParams { world, sensors, duration_s: Some(seconds), seed: 5, ..SimParams::default() }).unwrap()
}

/// A planar lidar and wheels: quick to render, so that tests stay short.
pub(crate) fn planar(seconds: f64) -> Simulation {
    let mut sensors = SensorSuite::only_lidar2d();
    sensors.odometry = SensorSuite::default().odometry;
    simulation(sensors, seconds)
}

pub(crate) fn empty(simulation: &Simulation, params: PipelineParams) -> Pipeline {
    let mut pipeline = Pipeline::new(params).unwrap();
    simulation.sensors().into_iter().for_each(|s| pipeline.declare_sensor(s));
    pipeline
}

/// What a run leaves behind for the store: keyframes and trajectory.
#[derive(Default)]
pub(crate) struct Stored {
    pub(crate) keyframes: Vec<(Pose, Pose, Arc<KeyframeScan>)>,
    pub(crate) trajectory: Vec<percept_pipeline::TrajectoryEntry>,
}

pub(crate) fn feed(pipeline: &mut Pipeline, frames: impl Iterator<Item = SensorFrame>) -> Stored {
    let mut stored = Stored::default();
    for frame in frames {
        let report = pipeline.process(&frame).unwrap();
        stored.trajectory.extend(report.trajectory);
        stored.keyframes.extend(report.keyframe.map(|k| (k.info.t_map_base, k.t_odom_base, k.scan)));
    }
    stored
}

#[test]
fn a_drive_is_followed_and_mapped() {
    let simulation = planar(30.0);
    let mut pipeline = empty(&simulation, PipelineParams::default());
    feed(&mut pipeline, simulation.frames().map(|f| f.frame));
    let snapshot = pipeline.snapshot();
    let t_map_world = simulation.t_world_start().inverse();
    let mut worst: f64 = 0.0;
    for (t_map_base, entry) in snapshot.trajectory() {
        assert!(entry.tracked);
        let truth = t_map_world * simulation.pose_at(entry.stamp);
        worst = worst.max((truth.translation.vector - t_map_base.translation.vector).norm());
    }
    // Range noise of 1 cm over hundreds of beams: centimetres after a lap of one room.
    assert!(worst < 0.05, "{worst}");
    // What stands where the truth says wall must be occupied or unknown, never free: sampled at the room's walls.
    assert!(snapshot.layers.occupancy.num_known() > 1000);
    assert!(snapshot.keyframes.len() > 5);
}

#[test]
fn the_same_frames_give_the_same_bytes_whatever_the_number_of_threads() {
    let simulation = simulation(SensorSuite::only_lidar3d(), 3.0);
    let frames: Vec<SensorFrame> = simulation.frames().map(|f| f.frame).collect();
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let mut pipeline = empty(&simulation, PipelineParams::default());
            feed(&mut pipeline, frames.iter().cloned());
            let snapshot = pipeline.snapshot();
            let poses: Vec<Pose> = snapshot.trajectory().map(|(t, _)| t).collect();
            (format!("{poses:?}"), format!("{:?}", snapshot.layers.cloud.to_cloud()))
        })
    };
    assert_eq!(run(1), run(3));
}
