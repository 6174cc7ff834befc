//! A correction of keyframes, as a loop closure will make it, is on disk when the session is woken again.

use percept_geometry::{Correction, Pose, se3};
use percept_pipeline::{PipelineParams, Snapshot};
use percept_service::{ComputePool, Limits, NewSession, OverloadPolicy, SensorDeclaration, Service, SessionMode};
use percept_sim::{SensorSuite, SimParams, Simulation, WorldParams};
use percept_store::{SlateStore, StoreConfig};
use std::path::Path;
use std::sync::Arc;

async fn open(directory: &Path) -> Service {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(2).build().unwrap();
    let store = SlateStore::open(StoreConfig::directory(directory)).await.unwrap();
    let compute = ComputePool::new(pool, 2);
    Service::open(Arc::new(store), compute, Limits::default(), PipelineParams::default()).await.unwrap()
}

fn poses(snapshot: &Snapshot) -> Vec<Pose> {
    snapshot.trajectory().map(|(t, _)| t).collect()
}

/// Corrections come from the test, none from loops.
fn by_hand() -> PipelineParams {
    let mut params = PipelineParams::default();
    params.slam.back_end.enabled = false;
    params
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn corrected_keyframes_trajectory_and_map_are_there_after_a_restart() {
    let directory = tempfile::tempdir().unwrap();
    let world = WorldParams { seed: 5, rooms: 1, person: false, ..WorldParams::default() };
    let sensors = SensorSuite::only_lidar2d();
    let simulation =
        Simulation::new(SimParams { world, sensors, duration_s: Some(8.0), seed: 5, ..SimParams::default() }).unwrap();
    let service = open(directory.path()).await;
    let declare = |spec| SensorDeclaration { spec, overload: OverloadPolicy::Block };
    let new = NewSession {
        id: Some("bent".to_owned()),
        display_name: String::new(),
        mode: SessionMode::Mapping,
        sensors: simulation.sensors().into_iter().map(declare).collect(),
        params: by_hand(),
        request_id: String::new(),
    };
    let session = service.create_session(new).await.unwrap();
    for timed in simulation.frames() {
        session.process(timed.frame).await.unwrap();
    }
    let before = session.snapshot();
    assert!(before.keyframes.len() > 3);
    let bend = |i: u64| se3::from_xy_yaw(0.05 * i as f64, 0.02, 0.01);
    let moved = before.keyframes.iter().skip(1).map(|k| (k.id, k.t_map_base * bend(k.id.0))).collect();
    let corrected = session.correct(Correction { t_map_base: moved }).await.unwrap();
    assert_ne!(poses(&before), poses(&corrected));
    service.stop().await;

    let service = open(directory.path()).await;
    let woken = service.session("bent").await.unwrap().snapshot();
    assert_eq!(poses(&woken), poses(&corrected));
    assert_eq!(woken.layers.occupancy, corrected.layers.occupancy);
    let (now, then) = (woken.pose.clone().unwrap(), corrected.pose.clone().unwrap());
    assert!(se3::log(&(now.t_map_base.inverse() * then.t_map_base)).norm() < 1e-9);
    service.stop().await;
}
