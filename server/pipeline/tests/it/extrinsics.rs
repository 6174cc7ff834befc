//! A second sensor whose mount is not as declared contradicts the map, and the session says so.

use crate::drive::empty;
use percept_pipeline::PipelineParams;
use percept_sim::{DepthCameraParams, Disturbances, SensorSuite, SimParams, Simulation, WorldParams};

/// A drive with a lidar, planar or not, and a depth camera turned by `yaw_rad` on its mount.
fn drive(mut sensors: SensorSuite, yaw_rad: f64) -> Simulation {
    sensors.odometry = SensorSuite::default().odometry;
    sensors.depth_camera = Some(DepthCameraParams { rate_hz: 2.0, color: false, ..DepthCameraParams::default() });
    let world = WorldParams { seed: 5, rooms: 1, person: false, ..WorldParams::default() };
    let disturbances = Disturbances { mount_yaw_error_rad: yaw_rad, ..Disturbances::default() };
    let params = SimParams { world, sensors, disturbances, duration_s: Some(16.0), seed: 5, ..SimParams::default() };
    Simulation::new(params).unwrap()
}

#[test]
fn a_camera_turned_on_its_mount_is_told_and_by_how_much() {
    for (suite, name) in [(SensorSuite::only_lidar2d(), "planar"), (SensorSuite::only_lidar3d(), "3d")] {
        for yaw_rad in [0.0, 0.2] {
            let simulation = drive(suite.clone(), yaw_rad);
            let mut pipeline = empty(&simulation, PipelineParams::default());
            for timed in simulation.frames() {
                pipeline.process(&timed.frame).unwrap();
            }
            let told: Vec<_> = pipeline.snapshot().mount_offsets.values().copied().collect();
            match yaw_rad {
                0.0 => assert!(told.is_empty(), "{name}: {told:?}"),
                _ => {
                    assert_eq!(told.len(), 1, "{name}");
                    assert!(
                        (told[0].angle_rad - yaw_rad).abs() < 0.04 && told[0].distance_m < 0.08,
                        "{name}: {told:?}"
                    );
                }
            }
        }
    }
}

#[test]
fn it_is_told_as_well_where_the_session_names_the_sensor_that_moves_the_pose() {
    let simulation = drive(SensorSuite::only_lidar2d(), 0.2);
    let mut params = PipelineParams::default();
    params.slam.pose_sensor = "scan".to_owned();
    let mut pipeline = empty(&simulation, params);
    simulation.frames().for_each(|timed| drop(pipeline.process(&timed.frame).unwrap()));
    let told: Vec<_> = pipeline.snapshot().mount_offsets.values().copied().collect();
    assert!(told.len() == 1 && (told[0].angle_rad - 0.2).abs() < 0.04, "{told:?}");
}
