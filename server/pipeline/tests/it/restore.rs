//! A session that was stored and brought back goes on as if nothing had happened.

use crate::drive::{empty, feed, planar};
use percept_pipeline::{PipelineParams, Restored, RestoredKeyframe};

#[test]
fn a_restored_session_has_its_map_and_goes_on_tracking() {
    let simulation = planar(16.0);
    let frames: Vec<_> = simulation.frames().map(|f| f.frame).collect();
    let (first, rest) = frames.split_at(frames.len() / 2);
    let mut before = empty(&simulation, PipelineParams::default());
    let stored = feed(&mut before, first.iter().cloned());
    let keyframe = |(t_map_base, t_odom_base, scan)| RestoredKeyframe { t_map_base, t_odom_base, scan };
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
