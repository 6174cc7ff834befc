//! What is decided about the map is shown at once: keyframes, trajectory and submaps move together, and what hangs on them is
//! told by how much. Submaps that do not fit their keyframes or the map's cells any more are built anew afterwards, a little
//! from each frame to the next, beside them.

use super::{MapGraph, MapUpdate};
use crate::beside::Task;
use percept_geometry::{Correction, KeyframeId, Pose};
use percept_slam::MergedKeyframe;
use std::collections::BTreeMap;

/// Points of keyframes that submaps are built anew from until the next frame, at most: 4 to 9 ms on one core of a planar lidar's,
/// and one keyframe at least (`examples/submaps.rs`). Counted, not timed, so that the same input gives the same answers.
const POINTS_A_FRAME: usize = 2_000;
/// Keyframes that have to wait for that; with fewer it is as much less. Robots of a fleet that set out together would
/// else do all at once what they have time for. Merging leaves a hundred or so waiting: so many that a planar robot builds
/// one with a frame then, which two cores do for 64 robots.
const MANY: usize = 600;

/// What was decided.
#[derive(Debug, Default)]
pub(crate) struct Decision {
    /// Keyframes that move, base to map.
    pub(crate) poses: BTreeMap<KeyframeId, Pose>,
    /// Odom to map from then on; none if it stays.
    pub(crate) t_map_odom: Option<Pose>,
    /// The newest keyframe that was thought of: later ones move with odom.
    pub(crate) newest: Option<KeyframeId>,
    /// Keyframes that others stand for from then on.
    pub(crate) merged: Vec<MergedKeyframe>,
}

impl MapGraph {
    /// Odometry goes on from another place in the map, seen from a keyframe of it.
    pub(crate) fn place_odometry(&mut self, keyframe: KeyframeId, t_keyframe_odom: &Pose) {
        if let Some(info) = self.keyframes.of(keyframe) {
            self.t_map_odom = info.t_map_base * t_keyframe_odom;
        }
    }

    /// Moves everything to where it was decided to be.
    pub(crate) fn decide(&mut self, decision: Decision, update: &mut MapUpdate) {
        let Decision { mut poses, t_map_odom, newest, merged } = decision;
        if poses.is_empty() && merged.is_empty() {
            return;
        }
        poses.retain(|id, _| self.keyframes.of(*id).is_some());
        if let Some(t_map_odom) = t_map_odom {
            self.t_map_odom = t_map_odom;
            let later = newest.map_or(self.keyframes.len(), |id| id.0 as usize + 1);
            let later = self.keyframes.iter().skip(later);
            poses.extend(later.map(|k| (k.id, t_map_odom * k.t_odom_base)));
        }
        poses.retain(|id, _| merged.iter().all(|m| m.id != *id));
        let (moved, changed) = self.keyframes.revise(&poses, &merged);
        let correction = Correction { t_map_base: poses.iter().map(|(id, pose)| (*id, *pose)).collect() };
        let gone: Vec<KeyframeId> = merged.iter().map(|m| m.id).collect();
        if let Err(error) = self.map.correct(&correction, &gone) {
            // Poses are our own; a map that refuses them keeps its old state.
            debug_assert!(false, "{error}");
        }
        update.change.merged.extend(changed);
        update.change.corrected.extend(poses);
        update.moved.push(moved);
    }

    /// Takes in by what submaps were built on since the frame before, and begins to build on until the next; stores ahead what there
    /// will be no room for.
    pub(crate) fn build_on(&mut self) {
        self.take_step();
        if self.map.is_rebuilding() {
            let waiting = self.map.num_to_rebuild().min(MANY);
            let step = self.map.next_step(POINTS_A_FRAME * waiting / MANY);
            self.step = step.map(|step| Task::begin(self.executor.as_ref(), || step.run()));
        }
        if let Some(executor) = &self.executor
            && let Some(ahead) = self.map.store_ahead()
        {
            executor.spawn(Box::new(move || ahead.run()));
        }
    }

    /// Takes in by what submaps were built on, if they were.
    pub(super) fn take_step(&mut self) {
        if let Some(step) = self.step.take() {
            self.map.take_step(step.finished());
        }
    }

    /// Whether something is being decided about the map, or submaps are still to be built anew.
    pub(crate) fn is_revising(&self) -> bool {
        self.map.is_rebuilding() || self.constraints.is_working()
    }
}
