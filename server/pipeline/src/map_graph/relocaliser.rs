//! A robot that is unanchored is looked for in the map.
//!
//! Where places can be recognised the whole map is looked through, by the back end, beside the frames: what the robot sees
//! meanwhile gathers in a part of its own, which joins the map once one of its frames is found there and those after it agree
//! ([`super::probation`]), or becomes the map. Else only the place where the robot was last known to be is tried: elsewhere rooms that resemble it would do as well.

use super::part::{Part, PartKeyframe, Search};
use super::probation::Probation;
use super::worker::{Question, Relocated, Sighting};
use super::{MapGraph, MapUpdate};
use crate::SlamParams;
use crate::frontend::{Found, FoundAt, Unanchored, is_sure};
use percept_geometry::{KeyframeId, KeyframeScan, Pose, SensorId, se3};
use percept_mapping::given::is_given;
use percept_slam::{KeyframeParams, Odometry, OdometryEstimate, OdometryKind, Relocalisation, Scan, TrackingState};
use std::sync::Arc;

/// Frames so far apart are looked for in the whole map, besides those that would be keyframes, seconds: a look of a 3D
/// lidar takes up to so long.
const LOOK_EVERY_S: f64 = 0.3;
/// Keyframes of a part of the map that hangs on nothing yet; when there are more, the oldest are given up.
const MOST_GATHERED: usize = 500;
/// Of a robot that only localises, which adds nothing to the map: what it is looked for by when it is lost.
const MOST_SEEN: usize = 40;
/// Frames of such a part; when there are more, the older half is given up, 3 hours of a lidar at 10 Hz on a robot that stands.
const MOST_FRAMES: usize = 200_000;
/// Without place recognition, every so many frames are tried against the old keyframes: the model has to be built each time.
const TRY_EVERY: u32 = 3;

/// A place where the robot was found is another one if it is so far from it, metres and radians: what it is found by is measured to
/// decimetres.
const SAME_PLACE: (f64, f64) = (1.0, 0.5);

/// Where it was found and is not it is not found again before it has driven so far, metres: what contradicted there is not what it sees then,
/// and where a map has changed in one place it is known by others.
const WITHDRAWN_M: f64 = 3.0;

/// What an unanchored robot sees, or one that was found and is not certain to be there.
pub(crate) struct UnanchoredView<'a> {
    pub(crate) kind: OdometryKind,
    pub(crate) sensor: &'a SensorId,
    /// The sensor that moves the pose, if that is known for others, too.
    pub(crate) pose_sensor: Option<&'a SensorId>,
    pub(crate) scan: &'a Scan,
    pub(crate) estimate: &'a OdometryEstimate,
    /// How well frames that were anchored in the map usually fitted.
    pub(crate) usual_inlier_ratio: f64,
    /// What a keyframe would keep of it.
    pub(crate) kept: &'a dyn Fn() -> KeyframeScan,
}

/// The part of the map that a robot gathers since it is unanchored: `t_part_base` is base to odom.
#[derive(Debug, Default)]
pub(super) struct Relocaliser {
    pub(super) part: Part,
    search: Search,
    /// Where the robot was found to be at an earlier frame, until a frame makes use of it.
    answer: Option<Relocated>,
    /// Once it was found, until that is certain.
    pub(super) probation: Option<Probation>,
    /// Odom to map where it was found and is not, and the way up to when that was known, metres.
    withdrawn: Vec<(Pose, f64)>,
    /// The way since it is unanchored, metres, and base to odom at the newest frame.
    pub(super) way_m: f64,
    last: Option<Pose>,
}

impl Relocaliser {
    /// What was gathered hangs on nothing any more.
    pub(super) fn begin_anew(&mut self) -> Part {
        let next = Part { number: self.part.number + 1, ..Part::default() };
        self.search = Search::default();
        (self.probation, self.withdrawn, self.way_m, self.last) = (None, vec![], 0.0, None);
        std::mem::replace(&mut self.part, next)
    }

    /// The robot is not where it was found, by which odom lay so in the map: it is looked for elsewhere.
    pub(super) fn withdraw(&mut self, t_map_odom: &Pose) {
        (self.probation, self.search) = (None, Search::default());
        self.withdrawn.push((*t_map_odom, self.way_m));
    }

    /// The robot has moved on.
    fn move_on(&mut self, t_odom_base: &Pose) {
        let step = self.last.map_or(0.0, |last| (t_odom_base.translation.vector - last.translation.vector).norm());
        self.way_m += step;
        self.last = Some(*t_odom_base);
    }

    /// Whether it was found out a short while ago that odom does not lie so in the map, seen from where base is.
    fn is_withdrawn(&self, t_map_odom: &Pose, t_odom_base: &Pose) -> bool {
        let is_same = |(other, after_m): &(Pose, f64)| {
            if self.way_m - after_m > WITHDRAWN_M {
                return false;
            }
            let off = (other * t_odom_base).inv_mul(&(t_map_odom * t_odom_base));
            off.translation.vector.norm() < SAME_PLACE.0 && off.rotation.angle() < SAME_PLACE.1
        };
        self.withdrawn.iter().any(is_same)
    }

    /// The keyframe that a robot was found by which is not certain to be there.
    pub(super) fn found_by(&self) -> Option<KeyframeId> {
        self.probation.as_ref().map(Probation::found_by)
    }

    /// An answer to where the robot is.
    pub(super) fn hear(&mut self, relocated: Relocated) {
        // What was asked before it was lost again says nothing about where it is now.
        if relocated.part == self.part.number {
            (self.search.is_asked, self.search.is_unfinished) = (false, relocated.is_unfinished);
            self.answer = Some(relocated);
        }
    }

    /// Where the robot was found to be, and how sure that was, but for a map that was given; once.
    fn take_found(&mut self) -> Option<(Relocalisation, FoundAt)> {
        let Relocated { found, drift, t_odom_base, covariance, .. } =
            self.answer.take().filter(|r| r.part == self.part.number)?;
        let found = found?;
        let in_map = se3::compose_covariance(&drift, &found.t_keyframe_base, &found.covariance);
        Some((found, FoundAt { t_odom_base, of_odometry: covariance, in_map }))
    }

    /// Keyframes gathered, unless a search is on: then the robot may be found.
    pub(super) fn gathered_without_search(&self) -> Option<usize> {
        (!self.search.is_asked && !self.search.is_unfinished).then_some(self.part.keyframes.len())
    }

    /// Keeps what a view shows, and the question where that is; none if neither is due. `base_height_m` is above the floor.
    fn gather(&mut self, view: &UnanchoredView<'_>, params: &SlamParams, base_height_m: f64) -> Option<Sighting> {
        let (estimate, keyframe) = (view.estimate, &params.odometry.keyframe);
        self.move_on(&estimate.t_odom_base);
        if self.part.frames.len() == MOST_FRAMES {
            self.part.frames.drain(..MOST_FRAMES / 2);
        }
        self.part.frames.push((estimate.stamp, estimate.t_odom_base));
        let is_far = |last: &PartKeyframe| is_keyframe_away(keyframe, &last.t_part_base, &estimate.t_odom_base);
        let is_far = self.part.keyframes.last().is_none_or(is_far);
        let asks = match &self.probation {
            // Where it has not moved on it sees what it saw.
            Some(probation) => is_far && !probation.is_asked,
            None => (is_far || self.is_look_due(estimate)) && !self.search.is_asked,
        };
        if !is_far && !asks {
            return None;
        }
        let mut scan = (view.kept)();
        scan.base_height_m = base_height_m;
        let sighting = asks.then(|| {
            let seen_from = |f: &PartKeyframe| (estimate.t_odom_base.inv_mul(&f.t_part_base), Arc::clone(&f.scan));
            // What is only compared where it is needs no others.
            let before = if self.probation.is_some() { &[] } else { &self.part.keyframes[..] };
            let before = before.iter().map(seen_from).collect();
            let (t_odom_base, covariance) = (estimate.t_odom_base, estimate.covariance);
            Sighting { before, scan: scan.clone(), t_odom_base, covariance, part: self.part.number }
        });
        match &mut self.probation {
            Some(probation) => probation.is_asked |= asks,
            None if asks => (self.search.is_asked, self.search.asked_at) = (true, Some(estimate.stamp)),
            None => {}
        }
        if is_far {
            self.keep(view, scan, if params.localisation_only { MOST_SEEN } else { MOST_GATHERED });
        }
        sighting
    }

    /// Whether the robot is looked for by a frame, though that is no keyframe.
    fn is_look_due(&self, estimate: &OdometryEstimate) -> bool {
        let is_late = |then| estimate.stamp.seconds_since(then).abs() >= LOOK_EVERY_S;
        self.search.is_unfinished || self.search.asked_at.is_none_or(is_late)
    }

    fn keep(&mut self, view: &UnanchoredView<'_>, scan: KeyframeScan, most: usize) {
        let (part, estimate) = (&mut self.part, view.estimate);
        if part.keyframes.len() >= most {
            part.keyframes.drain(..=part.keyframes.len() - most);
            let first = part.keyframes.first().map_or(estimate.stamp, |f| f.stamp);
            part.frames.retain(|(stamp, _)| *stamp >= first);
        }
        part.keyframes.push(PartKeyframe {
            id: None,
            stamp: estimate.stamp,
            sensor: view.sensor.clone(),
            t_part_base: estimate.t_odom_base,
            covariance: estimate.covariance,
            scan: Arc::new(scan),
        });
    }
}

impl MapGraph {
    /// Looks for an unanchored robot; where it is now, if that is known with this frame.
    pub(crate) fn relocalise(
        &mut self,
        view: &UnanchoredView<'_>,
        unanchored: &Unanchored,
        update: &mut MapUpdate,
    ) -> Option<Found> {
        if !self.constraints.is_active() {
            return self.try_last_place(view, unanchored);
        }
        let (at, is_certain) = self.look_around(view, update)?;
        let estimate = OdometryEstimate { state: TrackingState::Tracking, ..view.estimate.clone() };
        Some(Found { estimate, odometry: None, at: Some(at), is_certain })
    }

    /// Where the robot was found, and whether that is certain: if the part that it belongs to becomes the map.
    fn look_around(&mut self, view: &UnanchoredView<'_>, update: &mut MapUpdate) -> Option<(FoundAt, bool)> {
        let state = view.estimate.state;
        if state.is_lost() {
            return None;
        }
        if !state.is_tracking() {
            // Odometry has begun anew: what was gathered hangs on nothing any more, and waits, unless nothing spoke against where it was.
            let unopposed = self.relocaliser.probation.as_ref().and_then(Probation::unopposed);
            if let Some((found, at)) = unopposed.filter(|_| !self.params.localisation_only) {
                self.join(&found, &at.t_odom_base, view.pose_sensor, update);
            } else {
                let gathered = self.relocaliser.begin_anew();
                self.set_aside(gathered, view.kind, view.pose_sensor);
            }
        }
        if let Some((found, at)) = self.relocaliser.take_found()
            && let Some(at) = self.place_found(&found, at)
        {
            // What a camera without depth sees says nothing of where it is beyond what it was found by.
            if view.kind == OdometryKind::Mono {
                return self.join(&found, &at.t_odom_base, view.pose_sensor, update).then_some((at, true));
            }
            let probation = Probation::new(found, at, &(view.kept)(), self.relocaliser.way_m);
            self.relocaliser.probation = Some(probation);
            return Some((at, false));
        }
        if !self.params.localisation_only
            && let Some(first) = self.take_over(view.kind, view.pose_sensor, update)
        {
            return Some((first, true));
        }
        self.gather(view);
        None
    }

    /// What an unanchored robot has seen was no place.
    pub(crate) fn forget_gathered(&mut self) {
        self.relocaliser.begin_anew();
    }

    /// Keeps what a view shows, and asks where that is, or whether it agrees with where it is believed to be.
    pub(super) fn gather(&mut self, view: &UnanchoredView<'_>) {
        let Some(sighting) = self.relocaliser.gather(view, &self.params, self.base_height_m) else { return };
        let question = match self.relocaliser.probation {
            Some(_) => Question::Check(sighting, self.t_map_odom * view.estimate.t_odom_base),
            None => Question::Relocalise(sighting),
        };
        self.constraints.ask(question, view.estimate.stamp);
    }

    /// Odometry goes on in the map where the robot was found, unless that is known to be wrong; how sure that is.
    pub(super) fn place_found(&mut self, found: &Relocalisation, at: FoundAt) -> Option<FoundAt> {
        let info = self.keyframes.of(found.keyframe)?;
        let t_keyframe_odom = found.t_keyframe_base * at.t_odom_base.inverse();
        if self.relocaliser.is_withdrawn(&(info.t_map_base * t_keyframe_odom), &at.t_odom_base) {
            return None;
        }
        // A map that was given is what the robot is in, however it came about.
        let in_map = if is_given(&info.sensor) { found.covariance } else { at.in_map };
        self.learn_height(found.keyframe, &found.t_keyframe_base);
        self.place_odometry(found.keyframe, &t_keyframe_odom);
        Some(FoundAt { in_map, ..at })
    }

    /// Tries a view against the keyframes where the robot was last known to be, and in the first frame where wheels say it is.
    fn try_last_place(&self, view: &UnanchoredView<'_>, unanchored: &Unanchored) -> Option<Found> {
        let Unanchored { last, num_frames, is_reckoned } = *unanchored;
        let place = match num_frames {
            0 if is_reckoned => view.estimate.t_odom_base,
            n if n.is_multiple_of(TRY_EVERY) => last.t_odom_base,
            _ => return None,
        };
        let mut odometry = Odometry::new(view.kind, self.params.odometry.clone());
        odometry.seed(&place, &self.keyframes_near(view.sensor, &place), last.stamp);
        let estimate = odometry.register(view.estimate.stamp, view.scan, None);
        let is_sure = is_sure(estimate.inlier_ratio, view.usual_inlier_ratio);
        (estimate.state.is_tracking() && is_sure).then_some(Found {
            estimate,
            odometry: Some(odometry),
            at: None,
            is_certain: true,
        })
    }
}

fn is_keyframe_away(params: &KeyframeParams, t_odom_last: &Pose, t_odom_base: &Pose) -> bool {
    let off = t_odom_last.inv_mul(t_odom_base);
    off.translation.vector.norm() >= params.distance_m || off.rotation.angle() >= params.angle_rad
}
