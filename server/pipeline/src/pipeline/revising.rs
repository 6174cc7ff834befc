//! What the back end decides is shown at once: keyframes, trajectory, submaps, objects and the pose move together. Submaps that
//! do not fit their keyframes or the map's cells any more are built anew afterwards, a little with every frame.

#[cfg(test)]
mod tests;

use super::{Pipeline, merging};
use crate::{KeyframeInfo, Merged};
use percept_geometry::{Correction, KeyframeId, Pose};
use percept_slam::{Loop, LoopId, MergedKeyframe};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Points of keyframes that submaps are built anew from with each frame: 4 to 9 ms on one core of a planar lidar's, and one
/// keyframe at least (`examples/submaps.rs`). Counted, not timed, so that the same input gives the same answers.
const POINTS_A_FRAME: usize = 2_000;

/// What changed in the map.
#[derive(Debug, Clone, Default)]
pub struct MapChange {
    /// Loops that were found or changed their state.
    pub loops: Vec<Loop>,
    /// Loops that went with keyframes that others stand for.
    pub dissolved: Vec<LoopId>,
    /// Keyframes that a correction moved, each once, with their new poses, base to map.
    pub corrected: BTreeMap<KeyframeId, Pose>,
    /// Keyframes that others stand for from now on, or through yet others than before.
    pub merged: Vec<(KeyframeInfo, Merged)>,
}

impl MapChange {
    /// Adds what changed after that.
    pub(super) fn extend(&mut self, later: Self) {
        self.loops.extend(later.loops);
        self.dissolved.extend(later.dissolved);
        // Who moved twice is where it moved last.
        self.corrected.extend(later.corrected);
        self.merged.extend(later.merged);
    }
}

/// What the back end has decided.
#[derive(Debug, Default)]
pub(super) struct Decision {
    /// Keyframes that move, base to map.
    pub(super) poses: BTreeMap<KeyframeId, Pose>,
    /// Odom to map from then on; none if it stays.
    pub(super) t_map_odom: Option<Pose>,
    /// The newest keyframe that was thought of: later ones move with odom.
    pub(super) newest: Option<KeyframeId>,
    /// Keyframes that others stand for from then on.
    pub(super) merged: Vec<MergedKeyframe>,
}

impl Pipeline {
    /// Odometry goes on from another place in the map, seen from a keyframe of it.
    pub(super) fn place_odometry(&mut self, keyframe: KeyframeId, t_keyframe_odom: &Pose) {
        if let Some(info) = self.keyframes.get(keyframe.0 as usize) {
            self.t_map_odom = info.t_map_base * t_keyframe_odom;
        }
    }

    /// Moves everything to where it was decided to be.
    pub(super) fn decide(&mut self, decision: Decision, change: &mut MapChange) {
        let Decision { mut poses, t_map_odom, newest, merged } = decision;
        if poses.is_empty() && merged.is_empty() {
            return;
        }
        poses.retain(|id, _| (id.0 as usize) < self.keyframes.len());
        if let Some(t_map_odom) = t_map_odom {
            self.t_map_odom = t_map_odom;
            let later = newest.map_or(self.keyframes.len(), |id| id.0 as usize + 1);
            let later = self.keyframes.iter().skip(later);
            poses.extend(later.map(|k| (k.id, t_map_odom * k.t_odom_base)));
        }
        poses.retain(|id, _| merged.iter().all(|m| m.id != *id));

        let infos = Arc::make_mut(&mut self.keyframes);
        let changed = merging::merge(infos, &merged);
        let mut moved: BTreeMap<KeyframeId, Pose> = BTreeMap::new();
        for (id, t_map_base) in &poses {
            let Some(info) = infos.get_mut(id.0 as usize) else { continue };
            moved.insert(*id, t_map_base * info.t_map_base.inverse());
            info.t_map_base = *t_map_base;
        }
        moved.extend(merging::carry(infos));
        change.merged.extend(changed.into_iter().filter_map(|k| Some((infos[k].clone(), infos[k].merged?))));
        let correction = Correction { t_map_base: poses.iter().map(|(id, pose)| (*id, *pose)).collect() };
        let gone: Vec<KeyframeId> = merged.iter().map(|m| m.id).collect();
        if let Err(error) = self.map.correct(&correction, &gone) {
            // Poses are our own; a map that refuses them keeps its old state.
            debug_assert!(false, "{error}");
        }
        change.corrected.extend(poses);
        self.scene.follow(&self.keyframes, &moved);
        self.restamp();
    }

    /// The newest pose, in the map as it is now.
    fn restamp(&mut self) {
        if let Some(pose) = &mut self.pose {
            pose.t_map_base = self.t_map_odom * pose.t_odom_base;
            pose.map_version = self.map.version();
        }
    }

    /// Builds on at submaps that are to be built anew.
    pub(super) fn build_on(&mut self) {
        if self.map.is_rebuilding() {
            self.map.advance(POINTS_A_FRAME);
        }
    }

    /// Whether something is being decided about the map, or submaps are still to be built anew.
    pub fn is_revising(&self) -> bool {
        self.map.is_rebuilding() || self.graph.as_ref().is_some_and(|g| !g.is_at_rest())
    }

    /// Decides what is still to be decided about the map, shows it, and builds all that is to be built anew.
    pub fn finish_revision(&mut self) -> MapChange {
        let change = self.finish_answers();
        while !self.map.advance(usize::MAX) {}
        self.restamp();
        change
    }
}
