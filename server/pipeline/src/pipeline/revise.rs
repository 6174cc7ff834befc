//! What the map graph decides between frames: objects and the newest pose follow.

use super::Pipeline;
use crate::MapChange;
use crate::map_graph::{MapGraph, MapUpdate};
use percept_geometry::{Correction, KeyframeId, Pose, Timestamp};
use percept_slam::LoopId;
use std::collections::BTreeMap;

impl Pipeline {
    /// Changes the map graph; objects and the newest pose follow what it moves. Objects that were found are taken in, as far as
    /// they are due at a frame, or all, if there is none.
    pub(super) fn revise(
        &mut self,
        frame: Option<Timestamp>,
        change: impl FnOnce(&mut MapGraph, &mut MapUpdate),
    ) -> MapChange {
        let mut update = MapUpdate::default();
        change(&mut self.map_graph, &mut update);
        self.move_objects(&update.moved);
        if !update.moved.is_empty() {
            self.restamp();
        }
        let objects = self.scene.take_found(frame, self.map_graph.keyframes());
        MapChange { objects, ..update.change }
    }

    /// Objects follow keyframes that were moved in the map, new from old.
    pub(super) fn move_objects(&mut self, moved: &[BTreeMap<KeyframeId, Pose>]) {
        moved.iter().for_each(|t_new_old| self.scene.follow(self.map_graph.keyframes(), t_new_old));
    }

    /// The newest pose, in the map as it is now.
    fn restamp(&mut self) {
        if let Some(pose) = &mut self.pose {
            pose.t_map_base = self.map_graph.t_map_odom() * pose.t_odom_base;
            pose.map_version = self.map_graph.map().version();
        }
    }

    /// Moves keyframes, and all that hangs on them: trajectory, map layers, objects, and where the robot is now.
    /// Corrections for keyframes that do not exist are ignored.
    pub fn apply(&mut self, correction: &Correction) {
        self.revise(None, |graph, update| graph.correct(correction, update));
        self.restamp();
    }

    /// Decides what is still to be decided about the map, shows it, builds all that is to be built anew, and takes in all objects
    /// that were found.
    pub fn finish_revision(&mut self) -> MapChange {
        let change = self.revise(None, MapGraph::finish_revision);
        self.restamp();
        change
    }

    /// Moves every keyframe to where the back end believes it, however little that is, and shows the map that is so: what
    /// waits while frames come in.
    pub fn settle(&mut self) -> MapChange {
        let change = self.revise(None, MapGraph::settle);
        self.restamp();
        change
    }

    /// Takes a loop out of the map, or undoes that; none if there is no such loop. It is among the loops of the answer.
    pub fn veto(&mut self, id: LoopId, vetoed: bool) -> Option<MapChange> {
        let mut is_known = false;
        let change = self.revise(None, |graph, update| is_known = graph.veto(id, vetoed, update));
        self.restamp();
        is_known.then_some(change)
    }

    /// Whether something is being decided about the map, submaps are still to be built anew, or objects are looked for.
    pub fn is_revising(&self) -> bool {
        self.map_graph.is_revising() || self.scene.is_looking()
    }
}
