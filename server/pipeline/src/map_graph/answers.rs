//! What the back end has found is heeded: corrections, loops, merged keyframes, and where an unanchored part lies.

use super::revising::Decision;
use super::worker::{Answer, Answers};
use super::{MapGraph, MapUpdate};
use percept_geometry::{Correction, KeyframeId, Timestamp};
use percept_slam::{BackEnd, BackEndUpdate, LoopId};

impl MapGraph {
    /// What the back end has found until a frame.
    pub(crate) fn take_answers(&mut self, stamp: Timestamp, update: &mut MapUpdate) {
        if let Some(answers) = self.constraints.answers_at(stamp) {
            self.heed(answers, update);
        }
    }

    /// All that the back end was asked is answered, and what follows from that is decided.
    fn finish_answers(&mut self, update: &mut MapUpdate) {
        if let Some(answers) = self.constraints.finish() {
            self.heed(answers, update);
        }
    }

    fn heed(&mut self, answers: Answers, update: &mut MapUpdate) {
        for answer in answers.answers {
            match answer {
                Answer::Update(newest, found) => self.follow(Some(newest), *found, update),
                Answer::Relocalised(relocated) => self.relocaliser.hear(relocated),
                Answer::Checked(checked) => self.hear_checked(checked),
            }
        }
    }

    /// Notes what changed about loops, and decides what the map is to become. `newest` is the newest keyframe that was thought
    /// of; none if all were.
    fn follow(&mut self, newest: Option<KeyframeId>, found: BackEndUpdate, update: &mut MapUpdate) {
        let BackEndUpdate { loops, correction, t_map_odom, merged, dissolved } = found;
        let poses = correction.into_iter().flat_map(|c| c.t_map_base).collect();
        self.decide(Decision { poses, t_map_odom, newest, merged }, update);
        update.change.loops.extend(loops);
        update.change.dissolved.extend(dissolved);
    }

    /// Decides what is still to be decided about the map, and builds all that is to be built anew.
    pub(crate) fn finish_revision(&mut self, update: &mut MapUpdate) {
        self.finish_answers(update);
        self.take_step();
        while !self.map.advance(usize::MAX) {}
    }

    /// Moves every keyframe to where the back end believes it, however little that is, and builds the map that is so.
    pub(crate) fn settle(&mut self, update: &mut MapUpdate) {
        if !self.ask_at_once(|back_end| Some(back_end.settle()), update) {
            self.finish_revision(update);
        }
    }

    /// Takes a loop out of the map, or undoes that; whether there is such a loop.
    pub(crate) fn veto(&mut self, id: LoopId, vetoed: bool, update: &mut MapUpdate) -> bool {
        self.ask_at_once(|back_end| back_end.veto(id, vetoed), update)
    }

    /// Changes the back end, and carries out what follows from that and from all that it was asked before; whether it did.
    fn ask_at_once(
        &mut self,
        change: impl FnOnce(&mut BackEnd) -> Option<BackEndUpdate>,
        update: &mut MapUpdate,
    ) -> bool {
        self.finish_answers(update);
        let Some(back_end) = self.constraints.at_rest() else { return false };
        let found = change(back_end);
        let loops = back_end.loops().to_vec();
        self.constraints.set_loops(loops);
        let is_known = found.is_some();
        if let Some(found) = found {
            self.follow(None, found, update);
        }
        self.finish_revision(update);
        is_known
    }

    /// Moves keyframes as a caller says. Those that do not exist are ignored.
    pub(crate) fn correct(&mut self, correction: &Correction, update: &mut MapUpdate) {
        self.finish_revision(update);
        let mut decision = Decision { poses: correction.t_map_base.iter().copied().collect(), ..Decision::default() };
        // Where the newest keyframe goes, odom goes.
        let newest = self.keyframes.last().and_then(|k| Some((decision.poses.get(&k.id)?, k.t_odom_base)));
        decision.t_map_odom = newest.map(|(t_map_base, t_odom_base)| t_map_base * t_odom_base.inverse());
        self.decide(decision, update);
        self.finish_revision(update);
    }
}
