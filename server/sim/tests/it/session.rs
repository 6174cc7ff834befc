//! Sessions: order of messages, truth beside them, and the same bytes always.

use crate::sim_params;
use percept_geometry::{CameraIntrinsics, SensorData, SensorKind};
use percept_sim::{DepthCameraParams, Lidar3dParams, SensorSuite, SimFrame, SimParams, Simulation};

/// Every sensor, small and quick.
fn small(seed: u64) -> SimParams {
    let mut sensors = SensorSuite::all();
    sensors.depth_camera = Some(DepthCameraParams {
        intrinsics: CameraIntrinsics::pinhole(160, 120, 131.0, 131.0, 79.5, 59.5),
        ..DepthCameraParams::default()
    });
    sensors.lidar3d = Some(Lidar3dParams { columns: 300, ..Lidar3dParams::default() });
    SimParams { sensors, duration_s: Some(1.5), ..sim_params(seed) }
}

/// Debug output tells every bit of a float but NaN's, and NaN equals NaN in it.
fn bytes(params: &SimParams) -> Vec<String> {
    Simulation::new(params.clone()).unwrap().frames().map(|f| format!("{f:?}")).collect()
}

#[test]
fn the_same_seed_gives_the_same_bytes_on_any_number_of_threads() {
    let pool = |n| rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap();
    let one = pool(1).install(|| bytes(&small(3)));
    let three = pool(3).install(|| bytes(&small(3)));
    assert!(one == three);
    let other = bytes(&SimParams { seed: 4, ..small(3) });
    assert_eq!(one.len(), other.len());
    assert!(one != other);
}

#[test]
fn messages_come_when_they_are_complete_with_their_truth() {
    let sim = Simulation::new(small(5)).unwrap();
    let frames: Vec<SimFrame> = sim.frames().collect();
    assert_eq!(frames.len() as u64, sim.frames().total());
    // A sweep is sent after its last point, 0.1 s after the stamp: an inertial sensor has covered it by then.
    let complete = |f: &SimFrame| f.frame.stamp.plus_seconds(if f.frame.sensor.0 == "lidar" { 0.1 } else { 0.0 });
    assert!(frames.is_sorted_by_key(complete));
    for spec in sim.sensors() {
        spec.validate().unwrap();
        let own: Vec<&SimFrame> = frames.iter().filter(|f| f.frame.sensor == spec.id).collect();
        assert!(own.iter().all(|f| f.frame.data.kind() == spec.kind));
        assert!(own.windows(2).all(|f| f[0].frame.stamp < f[1].frame.stamp));
        let expected = match spec.kind {
            SensorKind::Imu => 150,
            SensorKind::Odometry => 30,
            SensorKind::Rgbd => 23,
            _ => 15,
        };
        assert_eq!(own.len(), expected, "{}", spec.id);
    }
    assert!(frames.iter().all(|f| f.t_world_base == sim.pose_at(f.frame.stamp)));
    assert!(sim.t_world_start().translation.vector.norm() > 1.0);
    let truth = sim.truth(10.0);
    assert_eq!(truth.len(), 16);
    assert_eq!(truth[0].value, sim.t_world_start());
}

#[test]
fn a_camera_without_colour_sends_depth_alone() {
    let mut params = small(1);
    params.sensors = SensorSuite::only_depth_camera();
    if let Some(camera) = &mut params.sensors.depth_camera {
        camera.color = false;
        camera.rate_hz = 1.0;
    }
    let sim = Simulation::new(params).unwrap();
    assert_eq!(sim.sensors()[0].kind, SensorKind::Depth);
    assert!(matches!(sim.frames().next().unwrap().frame.data, SensorData::Depth(_)));
}

#[test]
fn colours_show_texture_that_features_can_hold_on_to() {
    let mut params = small(1);
    params.sensors = SensorSuite::only_depth_camera();
    params.duration_s = Some(0.05);
    let frame = Simulation::new(params).unwrap().frames().next().unwrap();
    let SensorData::Rgbd(_, color) = frame.frame.data else { panic!("rgbd") };
    let gray = color.to_gray();
    // Steps of more than a twentieth of the range between neighbours: corners need them.
    let steps = gray
        .data()
        .chunks_exact(gray.width())
        .flat_map(|row| row.windows(2))
        .filter(|p| p[0].abs_diff(p[1]) > 13)
        .count();
    assert!(steps > 3000, "{steps}");
}

#[test]
fn parameters_survive_json_and_unknown_fields_are_refused() {
    let params = small(1);
    let json = serde_json::to_string(&params).unwrap();
    assert_eq!(serde_json::from_str::<SimParams>(&json).unwrap(), params);
    assert_eq!(serde_json::from_str::<SimParams>("{}").unwrap(), SimParams::default());
    assert!(serde_json::from_str::<SimParams>(r#"{"world": {"romms": 3}}"#).is_err());
}
