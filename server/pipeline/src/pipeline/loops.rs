//! Loops close: keyframes go to the back end, corrections come back and move what hangs on them; a robot that was lost
//! is found again among the keyframes.

use super::atlas::{Part, PartKeyframe, Search};
use super::revising::Decision;
use super::{FrameReport, MapChange, NewKeyframe, Pipeline, Restored};
use crate::map_graph::worker::{Answer, Answers, GraphWorker, Question, Relocated, Sighting};
use percept_geometry::{Covariance6, KeyframeId, Pose, SensorId, SensorSpec, Timestamp};
use percept_slam::loops::{LoopClosure, place_recognition};
use percept_slam::{
    BackEnd, BackEndKeyframe, BackEndUpdate, LoopId, Odometry, OdometryEstimate, OdometryKind, Relocalisation, Scan,
};
use std::sync::Arc;

/// While adrift, every so many frames are looked for in the whole map, besides those that would be keyframes.
const LOOK_EVERY: u32 = 10;
/// Keyframes of a part of the map that hangs on nothing yet; when there are more, the oldest are given up.
const MOST_FLOATING: usize = 500;

/// The part of the map that a robot gathers since it is adrift: `t_part_base` is base to odom.
#[derive(Debug, Default)]
pub(super) struct FloatingPart {
    pub(super) part: Part,
    search: Search,
}

impl FloatingPart {
    /// What was gathered hangs on nothing any more.
    pub(super) fn begin_anew(&mut self) -> Part {
        let next = Part { number: self.part.number + 1, ..Part::default() };
        std::mem::replace(self, Self { part: next, search: Search::default() }).part
    }
}

impl Pipeline {
    /// Makes the back end for the kind of sensor that moves the pose, if loops are wanted and can be found.
    pub(super) fn prepare_graph(&mut self, kind: OdometryKind) {
        if self.graph.is_none() && self.params.slam.back_end.enabled {
            let params = self.params.slam.back_end.clone();
            let recognition = place_recognition(kind, &self.params.slam.odometry);
            self.graph = recognition.map(|r| GraphWorker::new(BackEnd::new(params, r), self.executor.clone()));
        }
    }

    /// The back end forgets all keyframes and loops.
    pub(super) fn begin_graph_anew(&mut self, kind: OdometryKind) {
        let Some(next_loop) = self.graph.take().and_then(|mut g| g.finish().1.map(|b| b.next_loop())) else { return };
        self.loops = Arc::default();
        self.prepare_graph(kind);
        if let Some(back_end) = self.graph.as_mut().and_then(|g| g.finish().1) {
            back_end.resume(std::iter::empty(), vec![], next_loop);
        }
    }

    /// Hands a keyframe that is in the map to the back end; what follows from that comes with a later frame. `tied` is how it
    /// is known to lie to another one.
    pub(super) fn close_loops(&mut self, keyframe: &mut NewKeyframe, recognise: bool, tied: Option<LoopClosure>) {
        let covariance = self.odometry.as_ref().map(Odometry::covariance).unwrap_or_default();
        self.close_loops_of(keyframe, covariance, recognise, tied);
    }

    /// The same for a keyframe of another time: `covariance` is odometry's then.
    pub(super) fn close_loops_of(
        &mut self,
        keyframe: &mut NewKeyframe,
        covariance: Covariance6,
        recognise: bool,
        tied: Option<LoopClosure>,
    ) {
        let Some(graph) = &mut self.graph else { return };
        keyframe.after_gap = std::mem::take(&mut self.after_gap);
        let node = BackEndKeyframe {
            id: keyframe.info.id,
            t_map_base: keyframe.info.t_map_base,
            t_odom_base: keyframe.t_odom_base,
            covariance,
            scan: self.map.kept_scan(keyframe.info.id).cloned().unwrap_or_else(|| (&keyframe.scan).into()),
            recognise,
            after_gap: keyframe.after_gap,
            tied,
        };
        graph.ask(Question::Keyframe(node), keyframe.info.stamp);
    }

    /// What the back end has found until a frame.
    pub(super) fn take_answers(&mut self, stamp: Timestamp) -> MapChange {
        let answers = self.graph.as_mut().and_then(|g| g.answers_at(stamp));
        answers.map(|a| self.heed(a)).unwrap_or_default()
    }

    /// All that the back end was asked is answered, and what follows from that is decided.
    pub(super) fn finish_answers(&mut self) -> MapChange {
        let answers = self.graph.as_mut().map(|g| g.finish().0);
        answers.map(|a| self.heed(a)).unwrap_or_default()
    }

    fn heed(&mut self, answers: Answers) -> MapChange {
        let mut change = MapChange::default();
        for answer in answers.answers {
            match answer {
                Answer::Update(newest, update) => self.follow(Some(newest), *update, &mut change),
                Answer::Relocalised(relocated) => {
                    if relocated.part == self.floating.part.number {
                        self.floating.search = Search { is_asked: false, is_unfinished: relocated.is_unfinished };
                        self.relocated = Some(relocated);
                    } else {
                        self.atlas.hear(relocated);
                    }
                }
            }
        }
        if let Some(loops) = answers.loops {
            self.loops = loops;
        }
        change
    }

    /// Notes what changed about loops, and what the map is to become. `newest` is the newest keyframe that was thought of;
    /// none if all were.
    fn follow(&mut self, newest: Option<KeyframeId>, update: BackEndUpdate, change: &mut MapChange) {
        let BackEndUpdate { loops, correction, t_map_odom, merged, dissolved } = update;
        let poses = correction.into_iter().flat_map(|c| c.t_map_base).collect();
        self.decide(Decision { poses, t_map_odom, newest, merged }, change);
        change.loops.extend(loops);
        change.dissolved.extend(dissolved);
    }

    /// Moves every keyframe to where the back end believes it, however little that is, and shows the map that is so: what
    /// waits while frames come in.
    pub fn settle(&mut self) -> MapChange {
        self.ask_at_once(|back_end| Some(back_end.settle())).unwrap_or_else(|| self.finish_revision())
    }

    /// Takes a loop out of the map, or undoes that; none if there is no such loop. It is among the loops of the answer.
    pub fn veto(&mut self, id: LoopId, vetoed: bool) -> Option<MapChange> {
        self.ask_at_once(|back_end| back_end.veto(id, vetoed))
    }

    /// What follows from changing the back end, with all that it was asked before.
    fn ask_at_once(&mut self, change: impl FnOnce(&mut BackEnd) -> Option<BackEndUpdate>) -> Option<MapChange> {
        let mut answered = self.finish_answers();
        let (_, back_end) = self.graph.as_mut()?.finish();
        let back_end = back_end?;
        let update = change(back_end);
        self.loops = Arc::new(back_end.loops().to_vec());
        let is_known = update.is_some();
        if let Some(update) = update {
            self.follow(None, update, &mut answered);
        }
        answered.extend(self.finish_revision());
        is_known.then_some(answered)
    }

    /// Gives the stored keyframes and loops to the back end.
    pub(super) fn restore_back_end(&mut self, kind: OdometryKind, pose_sensor: &SensorId, restored: &Restored) {
        self.prepare_graph(kind);
        let Some(back_end) = self.graph.as_mut().and_then(|g| g.finish().1) else { return };
        let keyframes = restored.keyframes.iter().enumerate().filter_map(|(i, k)| {
            let (id, scan) = (KeyframeId(i as u64), k.scan()?);
            Some(BackEndKeyframe {
                id,
                t_map_base: k.t_map_base,
                t_odom_base: k.t_odom_base,
                covariance: Covariance6::zeros(),
                scan: self.map.kept_scan(id).cloned().unwrap_or_else(|| scan.into()),
                recognise: scan.sensor == *pose_sensor,
                after_gap: k.after_gap,
                tied: None,
            })
        });
        back_end.resume(keyframes, restored.loops.clone(), restored.next_loop_id);
        self.loops = Arc::new(restored.loops.clone());
    }

    /// A frame of a robot that is adrift: it goes into a part of the map of its own, which joins the map once one of its
    /// frames is found there, or becomes the map. Whether one of these happened with this one.
    pub(super) fn look_around(
        &mut self,
        kind: OdometryKind,
        spec: &SensorSpec,
        scan: &Scan,
        estimate: &OdometryEstimate,
        report: &mut FrameReport,
    ) -> bool {
        if estimate.state.is_lost() {
            return false;
        }
        if !estimate.state.is_tracking() {
            self.set_gathered_aside();
        }
        let part = self.floating.part.number;
        let found = self.relocated.take().filter(|r| r.part == part);
        if let Some(Relocated { found: Some(found), t_odom_base, .. }) = found {
            return self.join(&found, &t_odom_base, estimate, report);
        }
        let search = &self.floating.search;
        // While a search is on, it may be found.
        if !search.is_asked && !search.is_unfinished && self.take_over(kind, estimate, report) {
            return true;
        }
        self.floating.part.frames.push((estimate.stamp, estimate.t_odom_base));
        let (Some(odometry), Some(frames)) = (&self.odometry, self.anchoring.frames_adrift()) else { return false };
        let FloatingPart { part: gathered, search } = &self.floating;
        let is_far = gathered.keyframes.last().is_none_or(|last| self.is_keyframe_away(&last.t_part_base, estimate));
        let is_due = is_far || search.is_unfinished || frames.is_multiple_of(LOOK_EVERY);
        let asks = is_due && !search.is_asked;
        if !is_far && !asks {
            return false;
        }
        let mut scan = odometry.keyframe_scan(estimate.stamp, &spec.id, scan);
        scan.base_height_m = self.base_height_m;
        let FloatingPart { part: gathered, search } = &mut self.floating;
        if let Some(graph) = self.graph.as_mut().filter(|_| asks) {
            let seen_from = |f: &PartKeyframe| (estimate.t_odom_base.inv_mul(&f.t_part_base), Arc::clone(&f.scan));
            let before = gathered.keyframes.iter().map(seen_from).collect();
            let t_odom_base = estimate.t_odom_base;
            let sighting = Sighting { before, scan: scan.clone(), t_odom_base, part };
            graph.ask(Question::Relocalise(sighting), estimate.stamp);
            search.is_asked = true;
        }
        if is_far {
            if gathered.keyframes.len() == MOST_FLOATING {
                gathered.keyframes.remove(0);
                let first = gathered.keyframes.first().map_or(estimate.stamp, |f| f.stamp);
                gathered.frames.retain(|(stamp, _)| *stamp >= first);
            }
            gathered.keyframes.push(PartKeyframe {
                id: None,
                stamp: estimate.stamp,
                sensor: spec.id.clone(),
                t_part_base: estimate.t_odom_base,
                covariance: estimate.covariance,
                scan: Arc::new(scan),
            });
        }
        false
    }

    fn is_keyframe_away(&self, t_odom_base: &Pose, estimate: &OdometryEstimate) -> bool {
        let params = &self.params.slam.odometry.keyframe;
        let off = t_odom_base.inv_mul(&estimate.t_odom_base);
        off.translation.vector.norm() >= params.distance_m || off.rotation.angle() >= params.angle_rad
    }

    /// Puts the part of the map that hung on nothing where the robot was found to be at `t_odom_found`.
    fn join(
        &mut self,
        found: &Relocalisation,
        t_odom_found: &Pose,
        estimate: &OdometryEstimate,
        report: &mut FrameReport,
    ) -> bool {
        if self.keyframes.len() as u64 <= found.keyframe.0 {
            return false;
        }
        self.place_odometry(found.keyframe, &(found.t_keyframe_base * t_odom_found.inverse()));
        let gathered = self.floating.begin_anew();
        self.enter_part(gathered, &Pose::identity(), Some((found, t_odom_found)), report);
        self.anchoring.found(estimate);
        true
    }
}
