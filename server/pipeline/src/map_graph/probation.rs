//! A robot that was found has to be right elsewhere, too, before what it sees enters the map.
//!
//! Rooms resemble each other, and one that nobody has mapped may be just like one that was: nothing that is seen in there tells
//! which it is, however long the robot looks. So its pose is told from when it was found, and what it sees is gathered beside the
//! map as before. Views from its way are compared with the map as it was, and say where in it the robot is. When enough of them
//! agree that see other surroundings than those it was found by, what was gathered joins the map; when they contradict the map,
//! the robot is lost again, and has drawn nothing.

use super::relocaliser::UnanchoredView;
use super::worker::Checked;
use super::{MapGraph, MapUpdate};
use crate::frontend::FoundAt;
use nalgebra::Point3;
use percept_geometry::{Covariance6, KeyframeId, KeyframeScan, Pose, Timestamp, se3};
use percept_slam::{Evidence, OdometryKind, Relocalisation};
use std::collections::{BTreeSet, VecDeque};

/// How far it is from where the robot was found to other surroundings: so many times as far as it usually saw there, within these
/// bounds, metres.
const ELSEWHERE: f64 = 1.5;
const ELSEWHERE_M: (f64, f64) = (2.0, 5.0);
/// A sensor that does not see all around sees other surroundings where it has turned so far, radians: more than half of what it sees.
const TURNED: f64 = 1.0;
/// Views from elsewhere that have to agree, each with so much of the share of it that fits where the robot was found: in the twin rooms of
/// the test views from a wrong place have 0.60 to 0.69, from the right one 0.74 to 0.97.
const AGREE: usize = 4;
const AS_WELL: f64 = 0.8;
/// Where views say nothing, since the robot has left what is mapped: the way after which it is believed all the same, times the way to
/// other surroundings.
const UNSEEN: f64 = 3.0;
/// The newest views that say something, and how many of them have to contradict the map for the robot to be lost again.
const NEWEST: usize = 8;
const CONTRADICT: usize = 3;
/// A robot that was certain to be there is lost only if so many of them contradict, and none has agreed for so long a way, metres: a
/// room whose furniture was moved contradicts the map, and so do people, while it is where it is.
const CONTRADICT_SURE: usize = 6;
const NONE_AGREED_M: f64 = 10.0;

/// What has come of it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Verdict {
    /// It goes on.
    Open,
    /// The robot is where it was found to be.
    Confirmed,
    /// It is not.
    Withdrawn,
}

/// What has come of it that a robot was found.
pub(crate) enum Probed {
    /// It is where it was found last, as far as is known.
    Open(FoundAt),
    /// It is there, and what it has seen is in the map.
    Confirmed(FoundAt),
    /// It is not there: what it sees contradicts the map.
    Withdrawn,
}

/// Why a robot that is in the map may be elsewhere.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Doubt {
    /// It is certain to be there.
    None,
    /// What it sees fits there, and may fit elsewhere.
    LooksAlike,
    /// Somebody says so, and nothing that it sees can say otherwise.
    WordAlone,
}

/// A robot that was found, until that is certain.
#[derive(Debug)]
pub(super) struct Probation {
    /// Where the newest view that agreed has found it.
    found: Relocalisation,
    at: FoundAt,
    /// Base to odom where it was found first, the way up to there, and how far other surroundings are from there, metres.
    begun_at: Pose,
    begun_after_m: f64,
    elsewhere_m: f64,
    sees_around: bool,
    /// Share of the view that fitted there.
    begun_inlier_ratio: f64,
    /// The way up to the newest view that agreed, metres.
    agreed_after_m: f64,
    /// Whether the newest views that said something agreed.
    newest: VecDeque<bool>,
    /// Views from elsewhere that agreed.
    agreed: usize,
    /// Whether it may be believed where nobody has mapped: not of a word alone.
    may_be_unseen: bool,
    /// Whether a view is being compared.
    pub(super) is_asked: bool,
}

impl Probation {
    /// Begins where a robot was found by what it saw there, after so long a way since it was lost, metres.
    pub(super) fn new(found: Relocalisation, at: FoundAt, seen: &KeyframeScan, way_m: f64) -> Self {
        Self {
            begun_inlier_ratio: found.inlier_ratio,
            found,
            at,
            begun_at: at.t_odom_base,
            elsewhere_m: (ELSEWHERE * usual_range_m(seen)).clamp(ELSEWHERE_M.0, ELSEWHERE_M.1),
            begun_after_m: way_m,
            sees_around: sees_around(seen),
            agreed_after_m: way_m,
            newest: VecDeque::new(),
            agreed: 0,
            may_be_unseen: true,
            is_asked: false,
        }
    }

    /// Where it was found, if none of the newest views contradicts that.
    pub(super) fn unopposed(&self) -> Option<(Relocalisation, FoundAt)> {
        (!self.newest.contains(&false)).then(|| (self.found.clone(), self.at))
    }

    /// The keyframe by which a view was found that agreed, the newest such.
    pub(super) fn found_by(&self) -> KeyframeId {
        self.found.keyframe
    }

    /// A view agrees that was taken there, after so long a way since the robot was lost, metres.
    fn agree(&mut self, found: Relocalisation, at: FoundAt, way_m: f64) {
        self.agreed_after_m = way_m;
        let off = self.begun_at.inv_mul(&at.t_odom_base);
        let has_turned = !self.sees_around && off.rotation.angle() > TURNED;
        let is_elsewhere = off.translation.vector.norm() > self.elsewhere_m || has_turned;
        if is_elsewhere && found.inlier_ratio >= AS_WELL * self.begun_inlier_ratio {
            self.agreed += 1;
        }
        (self.found, self.at) = (found, at);
        self.say(true);
    }

    /// A view contradicts the map.
    fn contradict(&mut self) {
        self.say(false);
    }

    fn say(&mut self, agrees: bool) {
        self.newest.push_back(agrees);
        if self.newest.len() > NEWEST {
            self.newest.pop_front();
        }
    }

    /// Whether enough other surroundings agree, or nobody has mapped them.
    fn is_sure(&self, way_m: f64) -> bool {
        let is_past = self.may_be_unseen && way_m - self.begun_after_m >= UNSEEN * self.elsewhere_m;
        self.agreed >= AGREE || is_past
    }

    /// What has come of it, after so long a way since the robot was lost, metres.
    fn verdict(&self, way_m: f64) -> Verdict {
        let contradict = self.newest.iter().filter(|agrees| !**agrees).count();
        let is_sure = self.is_sure(way_m);
        let is_wrong = match self.agreed >= AGREE {
            true => contradict >= CONTRADICT_SURE && way_m - self.agreed_after_m >= NONE_AGREED_M,
            false => contradict >= CONTRADICT,
        };
        match (is_wrong, is_sure && contradict == 0) {
            (true, _) => Verdict::Withdrawn,
            (false, true) => Verdict::Confirmed,
            (false, false) => Verdict::Open,
        }
    }
}

impl MapGraph {
    /// A robot that is in the map is to be there only as long as what it sees agrees, and adds nothing to the map until that is certain,
    /// if it is not already; whether it can be. `in_map` is the covariance of its pose.
    pub(crate) fn doubt(&mut self, view: &UnanchoredView<'_>, in_map: &Covariance6, why: Doubt) -> bool {
        let t_odom_base = view.estimate.t_odom_base;
        let Some((keyframe, t_keyframe_base)) = self.nearest_keyframe(&(self.t_map_odom * t_odom_base)) else {
            return false;
        };
        if !self.constraints.is_active() || view.kind == OdometryKind::Mono {
            return false;
        }
        let inlier_ratio = view.estimate.inlier_ratio;
        let found = Relocalisation { keyframe, t_keyframe_base, covariance: *in_map, inlier_ratio };
        let at = FoundAt { t_odom_base, of_odometry: view.estimate.covariance, in_map: *in_map };
        self.relocaliser.begin_anew();
        self.atlas.begin_anew();
        let agreed = if why == Doubt::None { AGREE } else { 0 };
        let may_be_unseen = why != Doubt::WordAlone;
        let probation = Probation { agreed, may_be_unseen, ..Probation::new(found, at, &(view.kept)(), 0.0) };
        self.relocaliser.probation = Some(probation);
        self.gather(view);
        true
    }

    /// The robot is told to be elsewhere: odom lies where it is by that. What was gathered waits.
    pub(crate) fn go_elsewhere(&mut self, view: &UnanchoredView<'_>, t_map_base: &Pose, update: &mut MapUpdate) {
        let Some((keyframe, t_keyframe_base)) = self.nearest_keyframe(t_map_base) else { return };
        self.take_back(update);
        let gathered = self.relocaliser.begin_anew();
        if !self.params.localisation_only {
            self.set_aside(gathered, view.kind, view.pose_sensor);
        }
        self.learn_height(keyframe, &t_keyframe_base);
        self.place_odometry(keyframe, &(t_keyframe_base * view.estimate.t_odom_base.inverse()));
    }

    /// The keyframe nearest to a pose in the map, and base seen from there.
    fn nearest_keyframe(&self, t_map_base: &Pose) -> Option<(KeyframeId, Pose)> {
        let living = self.keyframes.iter().filter(|k| k.merged.is_none());
        let from = living.map(|k| (k.id, k.t_map_base.inv_mul(t_map_base)));
        from.min_by(|a, b| a.1.translation.vector.norm().total_cmp(&b.1.translation.vector.norm()))
    }

    /// Frames of a robot that is not where it was believed to be do not count as placed: those since the newest view that agreed, if it
    /// was certain to be there.
    fn take_back(&mut self, update: &mut MapUpdate) {
        let Some(probation) = &self.relocaliser.probation else { return };
        let frames = &self.relocaliser.part.frames;
        let is_agreed = |(_, t): &(Timestamp, Pose)| *t == probation.at.t_odom_base;
        let was_certain = probation.agreed >= AGREE;
        let from = if was_certain { frames.iter().rposition(is_agreed).map_or(0, |i| i + 1) } else { 0 };
        update.mended.extend(self.trajectory.forget(&frames[from..]));
        update.mended.sort_by_key(|e| e.stamp);
    }

    /// Whether the robot was found, and is not certain to be there.
    pub(crate) fn is_on_probation(&self) -> bool {
        let probation = self.relocaliser.probation.as_ref();
        probation.is_some_and(|p| !p.is_sure(self.relocaliser.way_m))
    }

    /// What a view of a robot says that was found and is not certain to be there.
    pub(crate) fn probe(&mut self, view: &UnanchoredView<'_>, update: &mut MapUpdate) -> Probed {
        let Some(probation) = &self.relocaliser.probation else { return Probed::Withdrawn };
        let at = probation.at;
        if !view.estimate.state.is_tracking() {
            return Probed::Open(at);
        }
        match probation.verdict(self.relocaliser.way_m) {
            Verdict::Confirmed if !self.params.localisation_only => {
                let found = probation.found.clone();
                if self.join(&found, &at.t_odom_base, view.pose_sensor, update) {
                    return Probed::Confirmed(at);
                }
            }
            Verdict::Open | Verdict::Confirmed => {
                self.gather(view);
                return Probed::Open(at);
            }
            Verdict::Withdrawn => {}
        }
        self.take_back(update);
        let t_map_odom = self.t_map_odom;
        self.relocaliser.withdraw(&t_map_odom);
        Probed::Withdrawn
    }

    /// What a view said of where the robot was believed to be.
    pub(super) fn hear_checked(&mut self, checked: Checked) {
        let Checked { evidence, drift, t_odom_base, covariance, part } = checked;
        // What was asked before it was lost again says nothing about where it is now.
        if part != self.relocaliser.part.number {
            return;
        }
        let Some(probation) = &mut self.relocaliser.probation else { return };
        probation.is_asked = false;
        let way_m = self.relocaliser.way_m;
        match evidence {
            Evidence::Agrees(found) => {
                let believed = (self.t_map_odom * t_odom_base, probation.at.since(&t_odom_base, &covariance));
                let Some(info) = self.keyframes.of(found.keyframe) else { return };
                let found = fused(found, &info.t_map_base, &believed);
                let in_map = se3::compose_covariance(&drift, &found.t_keyframe_base, &found.covariance);
                let at = FoundAt { t_odom_base, of_odometry: covariance, in_map };
                if let Some(at) = self.place_found(&found, at)
                    && let Some(probation) = &mut self.relocaliser.probation
                {
                    probation.agree(found, at, way_m);
                }
            }
            Evidence::Contradicts => probation.contradict(),
            Evidence::Nothing => {}
        }
    }
}

/// A place as one view has measured it, made surer by where odometry has led to: base to map, and its covariance.
fn fused(found: Relocalisation, t_map_keyframe: &Pose, believed: &(Pose, Covariance6)) -> Relocalisation {
    let off = se3::log(&believed.0.inv_mul(&(t_map_keyframe * found.t_keyframe_base)));
    let Some(inverse) = (believed.1 + found.covariance).try_inverse() else { return found };
    let gain = believed.1 * inverse;
    let covariance = (Covariance6::identity() - gain) * believed.1;
    Relocalisation {
        t_keyframe_base: t_map_keyframe.inv_mul(&(believed.0 * se3::exp(&(gain * off)))),
        covariance: (covariance + covariance.transpose()) * 0.5,
        ..found
    }
}

/// Half of what a scan has met lies nearer than this to its sensor, metres.
fn usual_range_m(scan: &KeyframeScan) -> f64 {
    let sensor = scan.t_base_sensor.translation.vector.cast::<f32>();
    let mut ranges: Vec<f32> = scan.hits.positions.iter().map(|p| (p.coords - sensor).norm()).collect();
    let half = ranges.len() / 2;
    if ranges.is_empty() { 0.0 } else { f64::from(*ranges.select_nth_unstable_by(half, f32::total_cmp).1) }
}

/// Whether a scan has met something in more than half of the directions around base.
fn sees_around(scan: &KeyframeScan) -> bool {
    let sector = |p: &Point3<f32>| ((p.y.atan2(p.x).to_degrees() + 180.0) / 10.0) as usize;
    let sectors: BTreeSet<usize> = scan.hits.positions.iter().map(sector).collect();
    sectors.len() > 18
}

#[cfg(test)]
mod tests;
