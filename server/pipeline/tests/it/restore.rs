//! A session that was stored and brought back goes on as if nothing had happened.

use crate::drive::{empty, feed, planar, simulation};
use percept_geometry::{KeyframeScan, se3};
use percept_pipeline::{KeyframeInfo, Merged, PipelineParams, Restored, RestoredContent, RestoredKeyframe};
use percept_sim::SensorSuite;
use std::sync::Arc;

#[test]
fn a_restored_session_has_its_map_and_goes_on_tracking() {
    let simulation = planar(16.0);
    let frames: Vec<_> = simulation.frames().map(|f| f.frame).collect();
    let (first, rest) = frames.split_at(frames.len() / 2);
    let mut before = empty(&simulation, PipelineParams::default());
    let stored = feed(&mut before, first.iter().cloned());
    let keyframe = |(t_map_base, t_odom_base, scan)| {
        let content = RestoredContent::Scan(scan);
        RestoredKeyframe { t_map_base, t_odom_base, after_gap: false, content }
    };
    let restored = Restored {
        keyframes: stored.keyframes.into_iter().map(keyframe).collect(),
        trajectory: stored.trajectory,
        last_stamps: first.iter().map(|f| (f.sensor.clone(), f.stamp)).collect(),
        ..Restored::default()
    };
    let mut after = empty(&simulation, PipelineParams::default());
    after.restore(restored);
    let (old, new) = (before.snapshot(), after.snapshot());
    assert_eq!(old.layers.occupancy, new.layers.occupancy);
    assert_eq!(
        old.trajectory().map(|(t, _)| t).collect::<Vec<_>>(),
        new.trajectory().map(|(t, _)| t).collect::<Vec<_>>()
    );
    // A frame that was taken in before the crash is refused, so that a client may send it again without harm.
    assert!(after.process(first.last().unwrap()).is_err());
    feed(&mut after, rest.iter().cloned());
    let pose = after.snapshot().pose.unwrap();
    assert!(pose.state.is_tracking());
    let truth = simulation.t_world_start().inverse() * simulation.pose_at(pose.stamp);
    let off = (truth.translation.vector - pose.t_map_base.translation.vector).norm();
    assert!(off < 0.08, "{off}");
}

#[test]
fn a_session_that_loops_have_corrected_comes_back_with_the_map_that_it_had() {
    let simulation = simulation(SensorSuite::only_lidar2d(), 60.0);
    let mut before = empty(&simulation, PipelineParams::default());
    let stored = feed(&mut before, simulation.frames().map(|f| f.frame));
    before.settle();
    let old = before.snapshot();
    let t_map_odom = old.keyframes[0].t_map_base * old.keyframes[0].t_odom_base.inverse();
    let moved = |k: &KeyframeInfo| se3::log(&(t_map_odom * k.t_odom_base).inv_mul(&k.t_map_base)).norm();
    let most = old.keyframes.iter().map(moved).fold(0.0, f64::max);
    assert!(most > 1e-3 && before.submaps().len() > 1, "{most} {}", before.submaps().len());
    let keyframe = |(info, stored): (&KeyframeInfo, &(_, _, Arc<KeyframeScan>))| {
        let content = RestoredContent::Scan(Arc::clone(&stored.2));
        RestoredKeyframe { t_map_base: info.t_map_base, t_odom_base: info.t_odom_base, after_gap: false, content }
    };
    let keyframes = old.keyframes.iter().zip(&stored.keyframes).map(keyframe).collect();
    let mut after = empty(&simulation, PipelineParams::default());
    after.restore(Restored { keyframes, trajectory: stored.trajectory, ..Restored::default() });
    let new = after.snapshot();
    assert_eq!((&old.layers.occupancy, &old.layers.cloud), (&new.layers.occupancy, &new.layers.cloud));
}

#[test]
fn a_merged_keyframe_is_where_the_one_is_that_stands_for_it() {
    let simulation = planar(6.0);
    let mut before = empty(&simulation, PipelineParams::default());
    let stored = feed(&mut before, simulation.frames().map(|f| f.frame));
    let mut keyframes: Vec<_> = stored
        .keyframes
        .into_iter()
        .map(|(t_map_base, t_odom_base, scan)| {
            let content = RestoredContent::Scan(scan);
            RestoredKeyframe { t_map_base, t_odom_base, after_gap: false, content }
        })
        .collect();
    let info = before.snapshot().keyframes[1].clone();
    let into = before.snapshot().keyframes[2].clone();
    let t_into_base = into.t_map_base.inverse() * info.t_map_base;
    let merged = Merged { into: into.id, t_into_base };
    // What was stored as its pose is from before the other one moved.
    keyframes[1].t_map_base = percept_geometry::Pose::identity();
    keyframes[1].content = RestoredContent::Merged { stamp: info.stamp, sensor: info.sensor, merged };
    let mut after = empty(&simulation, PipelineParams::default());
    after.restore(Restored { keyframes, trajectory: stored.trajectory, ..Restored::default() });
    let (old, new) = (before.snapshot(), after.snapshot());
    assert_eq!(new.living_keyframes().count() + 1, old.keyframes.len());
    let far = |(a, b): (percept_geometry::Pose, percept_geometry::Pose)| (a.inverse() * b).translation.vector.norm();
    let poses = old.trajectory().map(|(t, _)| t).zip(new.trajectory().map(|(t, _)| t));
    assert!(poses.map(far).fold(0.0, f64::max) < 1e-9);
}
