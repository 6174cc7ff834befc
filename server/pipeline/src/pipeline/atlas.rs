//! Parts of the map that hang on nothing: the largest is the map, the others wait until they are recognised in it.
//!
//! A robot that is adrift gathers a part of its own. One that grows far beyond the map becomes the map, as where a session was
//! lost early, and what was the map waits as a part; so does a part that a robot gathered before it was lost again. Parts that
//! wait are looked for in the map while it grows, a stretch of them at a time, and join where one is recognised. Frames hang on
//! the keyframes of their part, and count as tracked while that is the map. Parts that wait are not stored.
//!
//! The name is that of Elvira et al., "ORBSLAM-Atlas: a robust and accurate multi-map system", 2019.

use super::revising::Decision;
use super::{FrameReport, NewKeyframe, Pipeline};
use crate::map_graph::worker::{Question, Relocated, Sighting};
use crate::{KeyframeInfo, TrajectoryEntry};
use percept_geometry::{Covariance6, KeyframeId, KeyframeScan, Pose, SensorId, Timestamp, se3};
use percept_slam::loops::LoopClosure;
use percept_slam::{MergedKeyframe, OdometryEstimate, OdometryKind, Relocalisation};
use std::sync::Arc;

/// A part becomes the map once it has so many times its keyframes, and so many at least: a robot that was carried off for a
/// while comes back to the map that it had.
const TAKES_OVER: (usize, usize) = (2, 10);
/// Parts that wait, at most; when there are more, the smallest is given up.
const MOST_PARTS: usize = 16;
/// A part is looked for by so many keyframes at a time, and after them by those so many further on.
const STRETCH: (usize, usize) = (20, 8);
/// Keyframes of the map for one more keyframe between such searches: each of them looks at all of the map.
const MAP_A_KEYFRAME: usize = 1000;
/// What odometry may drift while a robot is adrift: metres and radians a metre, radians a radian.
const DRIFTS: (f64, f64, f64) = (0.03, 0.01, 0.02);
/// What odometry may be off from one keyframe to the next, where a part has joined in between: metres and radians.
const STEP: (f64, f64) = (0.02, 0.005);

/// A keyframe of a part.
#[derive(Debug, Clone)]
pub(super) struct PartKeyframe {
    /// Its number, if the part has been the map.
    pub(super) id: Option<KeyframeId>,
    pub(super) stamp: Timestamp,
    pub(super) sensor: SensorId,
    pub(super) t_part_base: Pose,
    /// Odometry's then; zero where nothing is known of it but where the keyframes of the map lie.
    pub(super) covariance: Covariance6,
    pub(super) scan: Arc<KeyframeScan>,
}

/// A part of the map that hangs on nothing.
#[derive(Debug, Default)]
pub(super) struct Part {
    /// Tells it from others.
    pub(super) number: u64,
    /// In the order of their stamps.
    pub(super) keyframes: Vec<PartKeyframe>,
    /// Base to the part at the frames that are known in it, in the order of their stamps.
    pub(super) frames: Vec<(Timestamp, Pose)>,
}

/// What was asked about where a part lies.
#[derive(Debug, Default)]
pub(super) struct Search {
    /// Whether the answer is still to come.
    pub(super) is_asked: bool,
    /// Whether the answer was that the search goes on.
    pub(super) is_unfinished: bool,
}

/// The parts that wait.
#[derive(Debug, Default)]
pub(super) struct Atlas {
    parts: Vec<Part>,
    search: Search,
    /// The part that is looked for, and the end of the stretch.
    turn: (usize, usize),
    /// Keyframes that came since the last search began.
    since: usize,
    /// Where one was found, until a frame makes use of it.
    found: Option<Relocated>,
}

impl Atlas {
    /// A part waits from now on.
    pub(super) fn wait(&mut self, part: Part) {
        if part.keyframes.is_empty() {
            return;
        }
        self.parts.push(part);
        if self.parts.len() > MOST_PARTS
            && let Some(smallest) = (0..self.parts.len()).min_by_key(|&k| self.parts[k].keyframes.len())
        {
            self.parts.remove(smallest);
        }
        self.turn = (0, 0);
    }

    /// An answer to where a part is that waits.
    pub(super) fn hear(&mut self, relocated: Relocated) {
        self.search = Search { is_asked: false, is_unfinished: relocated.is_unfinished };
        self.found = Some(relocated).filter(|r| r.found.is_some());
    }

    /// The stretch of a part that is looked for next, or on.
    fn sighting(&mut self, pose_sensor: &SensorId) -> Option<Sighting> {
        let (mut k, mut end) = self.turn;
        if !self.search.is_unfinished || end == 0 {
            end += STRETCH.1;
        }
        if self.parts.get(k).is_none_or(|part| end >= part.keyframes.len() + STRETCH.1) {
            (k, end) = (k + 1, STRETCH.1);
        }
        k = if k < self.parts.len() { k } else { 0 };
        self.turn = (k, end);
        let part = self.parts.get(k)?;
        let stretch = part.keyframes.iter().take(end).skip(end.saturating_sub(STRETCH.0));
        let seen: Vec<&PartKeyframe> = stretch.filter(|k| k.sensor == *pose_sensor).collect();
        let (newest, before) = seen.split_last()?;
        let seen_from = |k: &&PartKeyframe| (newest.t_part_base.inv_mul(&k.t_part_base), Arc::clone(&k.scan));
        Some(Sighting {
            before: before.iter().map(seen_from).collect(),
            scan: newest.scan.as_ref().clone(),
            t_odom_base: newest.t_part_base,
            part: part.number,
        })
    }
}

impl Pipeline {
    /// Odometry has begun anew: what was gathered hangs on nothing any more, and waits.
    pub(super) fn set_gathered_aside(&mut self) {
        let gathered = self.floating.begin_anew();
        self.atlas.wait(gathered);
    }

    /// Makes the part that was gathered the map, if that is by far the smaller one; whether it did.
    pub(super) fn take_over(
        &mut self,
        kind: OdometryKind,
        estimate: &OdometryEstimate,
        report: &mut FrameReport,
    ) -> bool {
        let of_map = self.map.keyframes().len();
        if self.floating.part.keyframes.len() < TAKES_OVER.1.max(TAKES_OVER.0 * of_map) {
            return false;
        }
        report.map.extend(self.finish_revision());
        // What ties keyframes of the old map to each other is in where they lie.
        report.map.dissolved.extend(self.loops.iter().map(|l| l.id));
        self.begin_graph_anew(kind);
        let gathered = self.floating.begin_anew();
        let old = self.map_as_part(gathered.number);
        let first = KeyframeId(self.keyframes.len() as u64);
        // Its keyframes leave the map, and lie relative to the first one of the new map as odometry had it, until they join.
        let t_first_map = gathered.keyframes.first().map(|k| (self.t_map_odom * k.t_part_base).inverse());
        let merged = old
            .keyframes
            .iter()
            .filter_map(|k| Some(MergedKeyframe { id: k.id?, into: first, t_into_base: t_first_map? * k.t_part_base }));
        let merged: Vec<MergedKeyframe> = merged.collect();
        self.enter_part(gathered, &Pose::identity(), None, report);
        self.decide(Decision { merged, ..Decision::default() }, &mut report.map);
        self.forget_frames(&old.frames, report);
        self.atlas.wait(old);
        self.atlas.found = None;
        self.anchoring.found(estimate);
        true
    }

    /// The map as a part, with the frames that were placed in it.
    fn map_as_part(&self, number: u64) -> Part {
        let of = |(id, k): (&KeyframeId, &percept_mapping::MapKeyframe)| {
            let scan = self.map.scan(*id)?;
            Some(PartKeyframe {
                id: Some(*id),
                stamp: scan.stamp,
                sensor: k.sensor.clone(),
                t_part_base: k.t_map_base,
                covariance: Covariance6::zeros(),
                scan,
            })
        };
        let mut keyframes: Vec<PartKeyframe> = self.map.keyframes().iter().filter_map(of).collect();
        keyframes.sort_by_key(|k| k.stamp);
        let placed = |entry: &TrajectoryEntry| {
            let anchor = self.keyframes.get(entry.anchor.filter(|_| entry.tracked)?.0 as usize)?;
            Some((entry.stamp, anchor.t_map_base * entry.t_anchor_base))
        };
        Part { number, keyframes, frames: self.trajectory.iter().filter_map(placed).collect() }
    }

    /// Frames that were placed in what is not the map any more.
    fn forget_frames(&mut self, frames: &[(Timestamp, Pose)], report: &mut FrameReport) {
        for (stamp, _) in frames {
            let i = self.trajectory.partition_point(|e| e.stamp < *stamp);
            if let Some(entry) = self.trajectory.get(i).filter(|e| e.stamp == *stamp) {
                let entry = TrajectoryEntry { tracked: false, ..*entry };
                self.trajectory.replace(i, entry);
                report.mended.push(entry);
            }
        }
        report.mended.sort_by_key(|e| e.stamp);
    }

    /// Puts a part into the map where `t_odom_part` has it, and hangs its frames on it. `found` is where it was recognised,
    /// and base to the part there.
    pub(super) fn enter_part(
        &mut self,
        part: Part,
        t_odom_part: &Pose,
        found: Option<(&Relocalisation, &Pose)>,
        report: &mut FrameReport,
    ) {
        self.after_gap = true;
        let (mut merged, joined) = (vec![], report.joined.len());
        let last = part.keyframes.len().saturating_sub(1);
        for (k, f) in part.keyframes.into_iter().enumerate() {
            let is_of_pose = self.sensors.pose_sensor().is_none_or(|s| *s == f.sensor);
            let mut keyframe = self.enter(f.stamp, &f.sensor, t_odom_part * f.t_part_base, f.scan);
            let id = keyframe.info.id;
            // The first is tied at once, so that the others are not looked for everywhere; the last, as it was found.
            let tied = found.filter(|_| k == 0 || k == last);
            let tied = tied.map(|(found, t_part_found)| tie(found, id, &t_part_found.inv_mul(&f.t_part_base)));
            self.close_loops_of(&mut keyframe, f.covariance, is_of_pose, tied);
            self.policy(&keyframe.info.sensor).resume(&keyframe.t_odom_base);
            merged.extend(f.id.map(|id_before| MergedKeyframe {
                id: id_before,
                into: id,
                t_into_base: Pose::identity(),
            }));
            report.joined.push(keyframe);
        }
        self.decide(Decision { merged, ..Decision::default() }, &mut report.map);
        let frames = part.frames.iter().map(|(stamp, t_part_base)| (*stamp, t_odom_part * t_part_base));
        let mended = self.mend(frames, &report.joined[joined..]);
        report.mended.extend(mended);
        report.mended.sort_by_key(|e| e.stamp);
    }

    /// Hangs frames whose odom poses are known on the keyframes before them, in the order of their stamps.
    fn mend(
        &mut self,
        frames: impl Iterator<Item = (Timestamp, Pose)>,
        keyframes: &[NewKeyframe],
    ) -> Vec<TrajectoryEntry> {
        let pose_sensor = self.sensors.pose_sensor();
        let anchors: Vec<&NewKeyframe> =
            keyframes.iter().filter(|k| pose_sensor.is_none_or(|s| *s == k.info.sensor)).collect();
        let mut mended = vec![];
        for (stamp, t_odom_base) in frames {
            let after = anchors.partition_point(|k| k.info.stamp <= stamp);
            let Some(anchor) = after.checked_sub(1).and_then(|k| anchors.get(k)) else { continue };
            let i = self.trajectory.partition_point(|e| e.stamp < stamp);
            if self.trajectory.get(i).is_none_or(|e| e.stamp != stamp) {
                continue;
            }
            let entry = TrajectoryEntry {
                stamp,
                tracked: true,
                anchor: Some(anchor.info.id),
                t_anchor_base: anchor.t_odom_base.inv_mul(&t_odom_base),
                is_keyframe: anchor.info.stamp == stamp,
            };
            self.trajectory.replace(i, entry);
            mended.push(entry);
        }
        mended
    }

    /// Parts that wait are looked for in the map, a stretch at a time while it grows.
    pub(super) fn look_for_parts(&mut self, stamp: Timestamp, pose_sensor: &SensorId, has_grown: bool) {
        self.atlas.since += usize::from(has_grown);
        let is_due = self.atlas.since > self.map.keyframes().len() / MAP_A_KEYFRAME || self.atlas.search.is_unfinished;
        if self.atlas.parts.is_empty() || self.atlas.search.is_asked || !is_due {
            return;
        }
        let Some(graph) = &mut self.graph else { return };
        self.atlas.since = 0;
        if let Some(sighting) = self.atlas.sighting(pose_sensor) {
            graph.ask(Question::Relocalise(sighting), stamp);
            self.atlas.search.is_asked = true;
        }
    }

    /// Puts a part that waited where a keyframe of it was found, if one was. The robot's keyframe before those that have joined:
    /// its way goes on from there, and with a keyframe at once.
    pub(super) fn join_waiting(&mut self, report: &mut FrameReport) -> Option<KeyframeInfo> {
        let Relocated { found, t_odom_base: t_part_found, part, .. } = self.atlas.found.take()?;
        let (found, before) = (found?, self.keyframes.last()?.clone());
        let t_map_keyframe = self.keyframes.get(found.keyframe.0 as usize)?.t_map_base;
        let k = self.atlas.parts.iter().position(|p| p.number == part)?;
        let part = self.atlas.parts.remove(k);
        self.atlas.turn = (0, 0);
        let t_map_part = t_map_keyframe * found.t_keyframe_base * t_part_found.inverse();
        self.enter_part(part, &(self.t_map_odom.inverse() * t_map_part), Some((&found, &t_part_found)), report);
        self.after_gap = true;
        self.keyframe_policies.clear();
        Some(before)
    }
}

/// What ties the robot's keyframe to the one before, where a part has joined in between.
pub(super) fn tie_over_join(before: &KeyframeInfo, now: &KeyframeInfo) -> LoopClosure {
    let sigma = [STEP.0, STEP.0, STEP.0, STEP.1, STEP.1, STEP.1];
    LoopClosure {
        from: before.id,
        to: now.id,
        t_from_to: before.t_odom_base.inv_mul(&now.t_odom_base),
        covariance: Covariance6::from_diagonal(&sigma.map(|s| s * s).into()),
        inlier_ratio: 1.0,
    }
}

/// What ties a keyframe to the place where a part was found, `t_found_then` away by odometry.
fn tie(found: &Relocalisation, to: KeyframeId, t_found_then: &Pose) -> LoopClosure {
    let (way, turn) = (t_found_then.translation.vector.norm(), t_found_then.rotation.angle());
    let [t, r] = [DRIFTS.0 * way, DRIFTS.1 * way + DRIFTS.2 * turn].map(|sigma| sigma * sigma);
    let odometry = Covariance6::from_diagonal(&[t, t, t, r, r, r].into());
    LoopClosure {
        from: found.keyframe,
        to,
        t_from_to: found.t_keyframe_base * t_found_then,
        covariance: se3::compose_covariance(&found.covariance, t_found_then, &odometry),
        inlier_ratio: found.inlier_ratio,
    }
}
