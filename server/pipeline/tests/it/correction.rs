//! The seam for loop closure: an artificial correction moves whatever hangs on the keyframes.

use crate::drive::{empty, feed, planar};
use percept_geometry::{Correction, KeyframeId, Pose, se3};
use percept_pipeline::{PipelineParams, Snapshot};

fn poses(snapshot: &Snapshot) -> Vec<Pose> {
    snapshot.trajectory().map(|(t, _)| t).collect()
}

/// Corrections come from the test, none from loops.
fn by_hand() -> PipelineParams {
    let mut params = PipelineParams::default();
    params.slam.back_end.enabled = false;
    params
}

#[test]
fn a_correction_moves_trajectory_map_and_robot_and_leaves_the_old_snapshot_alone() {
    let simulation = planar(15.0);
    let mut pipeline = empty(&simulation, by_hand());
    feed(&mut pipeline, simulation.frames().map(|f| f.frame));
    let before = pipeline.snapshot();
    let shift = se3::from_xy_yaw(2.0, -1.0, 0.5);
    let moved = before.keyframes.iter().map(|k| (k.id, shift * k.t_map_base)).collect();
    pipeline.apply(&Correction { t_map_base: moved });
    let after = pipeline.snapshot();
    assert!(after.map_version > before.map_version);
    for (old, new) in poses(&before).iter().zip(poses(&after)) {
        assert!(se3::log(&((shift * old).inverse() * new)).norm() < 1e-9);
    }
    let (old, new) = (before.pose.clone().unwrap(), after.pose.unwrap());
    assert!(se3::log(&((shift * old.t_map_base).inverse() * new.t_map_base)).norm() < 1e-9);
    // Odometry is never corrected.
    assert_eq!(old.t_odom_base, new.t_odom_base);
    assert_ne!(before.layers.occupancy, after.layers.occupancy);
    // The snapshot taken before still shows the map before.
    assert_eq!(poses(&before).len(), poses(&pipeline.snapshot()).len());
    assert_eq!(before.layers.version, before.map_version);
}

#[test]
fn undoing_a_correction_gives_the_map_back() {
    let simulation = planar(8.0);
    let mut pipeline = empty(&simulation, by_hand());
    feed(&mut pipeline, simulation.frames().map(|f| f.frame));
    let before = pipeline.snapshot();
    let original: Vec<(KeyframeId, Pose)> = before.keyframes.iter().map(|k| (k.id, k.t_map_base)).collect();
    let bent = original.iter().map(|(id, t)| (*id, t * se3::from_xy_yaw(0.1 * id.0 as f64, 0.0, 0.02))).collect();
    pipeline.apply(&Correction { t_map_base: bent });
    pipeline.apply(&Correction { t_map_base: original });
    let after = pipeline.snapshot();
    assert_eq!(before.layers.occupancy, after.layers.occupancy);
    assert_eq!(poses(&before), poses(&after));
}

#[test]
fn frames_after_a_correction_go_on_from_the_corrected_place() {
    let simulation = planar(10.0);
    let frames: Vec<_> = simulation.frames().map(|f| f.frame).collect();
    let (first, rest) = frames.split_at(frames.len() / 2);
    let mut pipeline = empty(&simulation, by_hand());
    feed(&mut pipeline, first.iter().cloned());
    let shift = se3::from_xy_yaw(5.0, 5.0, 1.0);
    let moved = pipeline.snapshot().keyframes.iter().map(|k| (k.id, shift * k.t_map_base)).collect();
    pipeline.apply(&Correction { t_map_base: moved });
    feed(&mut pipeline, rest.iter().cloned());
    let pose = pipeline.snapshot().pose.unwrap();
    let truth = shift * simulation.t_world_start().inverse() * simulation.pose_at(pose.stamp);
    assert!((truth.translation.vector - pose.t_map_base.translation.vector).norm() < 0.05);
}

#[test]
fn a_correction_of_unknown_keyframes_changes_nothing() {
    let simulation = planar(3.0);
    let mut pipeline = empty(&simulation, by_hand());
    feed(&mut pipeline, simulation.frames().map(|f| f.frame));
    let before = pipeline.snapshot();
    pipeline.apply(&Correction { t_map_base: vec![(KeyframeId(9999), Pose::identity())] });
    assert_eq!(pipeline.snapshot().map_version, before.map_version);
}
