//! A robot that is unanchored is looked for in the map.
//!
//! Where places can be recognised the whole map is looked through, by the back end, beside the frames: what the robot sees
//! meanwhile gathers in a part of its own, which joins the map once one of its frames is found there, or becomes the map. Else
//! only the place where the robot was last known to be is tried: elsewhere rooms that resemble it would do as well.

use super::part::{Part, PartKeyframe, Search};
use super::worker::{Question, Relocated, Sighting};
use super::{MapGraph, MapUpdate};
use crate::frontend::{Found, FoundAt, Unanchored};
use percept_geometry::{KeyframeScan, Pose, SensorId, se3};
use percept_mapping::given::is_given;
use percept_slam::{KeyframeParams, Odometry, OdometryEstimate, OdometryKind, Relocalisation, Scan, TrackingState};
use std::sync::Arc;

/// Frames so far apart are looked for in the whole map, besides those that would be keyframes, seconds: a look of a 3D
/// lidar takes up to so long.
const LOOK_EVERY_S: f64 = 0.3;
/// Keyframes of a part of the map that hangs on nothing yet; when there are more, the oldest are given up.
const MOST_GATHERED: usize = 500;
/// Without place recognition, every so many frames are tried against the old keyframes: the model has to be built each time.
const TRY_EVERY: u32 = 3;
/// A frame is believed to be back if it fits this share of how well frames usually fit, and this well at least:
/// rooms resemble each other.
const SURE: (f64, f64) = (0.8, 0.6);

/// What an unanchored robot sees.
pub(crate) struct UnanchoredView<'a> {
    pub(crate) unanchored: Unanchored,
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
    part: Part,
    search: Search,
    /// Where the robot was found to be at an earlier frame, until a frame makes use of it.
    answer: Option<Relocated>,
}

impl Relocaliser {
    /// What was gathered hangs on nothing any more.
    pub(super) fn begin_anew(&mut self) -> Part {
        let next = Part { number: self.part.number + 1, ..Part::default() };
        self.search = Search::default();
        std::mem::replace(&mut self.part, next)
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
    fn gather(&mut self, view: &UnanchoredView<'_>, params: &KeyframeParams, base_height_m: f64) -> Option<Sighting> {
        let estimate = view.estimate;
        self.part.frames.push((estimate.stamp, estimate.t_odom_base));
        let is_far = |last: &PartKeyframe| is_keyframe_away(params, &last.t_part_base, &estimate.t_odom_base);
        let is_far = self.part.keyframes.last().is_none_or(is_far);
        let is_due = is_far
            || self.search.is_unfinished
            || self.search.asked_at.is_none_or(|then| estimate.stamp.seconds_since(then).abs() >= LOOK_EVERY_S);
        let asks = is_due && !self.search.is_asked;
        if !is_far && !asks {
            return None;
        }
        let mut scan = (view.kept)();
        scan.base_height_m = base_height_m;
        let sighting = asks.then(|| {
            let seen_from = |f: &PartKeyframe| (estimate.t_odom_base.inv_mul(&f.t_part_base), Arc::clone(&f.scan));
            let before = self.part.keyframes.iter().map(seen_from).collect();
            let (t_odom_base, covariance) = (estimate.t_odom_base, estimate.covariance);
            Sighting { before, scan: scan.clone(), t_odom_base, covariance, part: self.part.number }
        });
        if asks {
            (self.search.is_asked, self.search.asked_at) = (true, Some(estimate.stamp));
        }
        if is_far {
            self.keep(view, scan);
        }
        sighting
    }

    fn keep(&mut self, view: &UnanchoredView<'_>, scan: KeyframeScan) {
        let (part, estimate) = (&mut self.part, view.estimate);
        if part.keyframes.len() == MOST_GATHERED {
            part.keyframes.remove(0);
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
    pub(crate) fn relocalise(&mut self, view: &UnanchoredView<'_>, update: &mut MapUpdate) -> Option<Found> {
        if !self.constraints.is_active() {
            return self.try_last_place(view);
        }
        let at = Some(self.look_around(view, update)?);
        let estimate = OdometryEstimate { state: TrackingState::Tracking, ..view.estimate.clone() };
        Some(Found { estimate, odometry: None, at })
    }

    /// Where the robot was found, if a view joins the part that it belongs to with the map, or makes it the map.
    fn look_around(&mut self, view: &UnanchoredView<'_>, update: &mut MapUpdate) -> Option<FoundAt> {
        let state = view.estimate.state;
        if state.is_lost() {
            return None;
        }
        if !state.is_tracking() {
            // Odometry has begun anew: what was gathered hangs on nothing any more, and waits.
            let gathered = self.relocaliser.begin_anew();
            self.set_aside(gathered, view.kind, view.pose_sensor);
        }
        if let Some((found, mut at)) = self.relocaliser.take_found() {
            // A map that was given is what the robot is in, however it came about.
            let is_given = self.keyframes.of(found.keyframe).is_some_and(|k| is_given(&k.sensor));
            at.in_map = if is_given { found.covariance } else { at.in_map };
            return self.join(&found, &at.t_odom_base, view.pose_sensor, update).then_some(at);
        }
        if let Some(first) = self.take_over(view.kind, view.pose_sensor, update) {
            return Some(first);
        }
        let params = &self.params.odometry.keyframe;
        if let Some(sighting) = self.relocaliser.gather(view, params, self.base_height_m) {
            self.constraints.ask(Question::Relocalise(sighting), view.estimate.stamp);
        }
        None
    }

    /// Tries a view against the keyframes where the robot was last known to be, and in the first frame where wheels say it is.
    fn try_last_place(&self, view: &UnanchoredView<'_>) -> Option<Found> {
        let Unanchored { last, num_frames, is_reckoned } = view.unanchored;
        let place = match num_frames {
            0 if is_reckoned => view.estimate.t_odom_base,
            n if n.is_multiple_of(TRY_EVERY) => last.t_odom_base,
            _ => return None,
        };
        let mut odometry = Odometry::new(view.kind, self.params.odometry.clone());
        odometry.seed(&place, &self.keyframes_near(view.sensor, &place), last.stamp);
        let estimate = odometry.register(view.estimate.stamp, view.scan, None);
        let is_sure = estimate.inlier_ratio >= SURE.1.max(SURE.0 * view.usual_inlier_ratio);
        (estimate.state.is_tracking() && is_sure).then_some(Found { estimate, odometry: Some(odometry), at: None })
    }
}

fn is_keyframe_away(params: &KeyframeParams, t_odom_last: &Pose, t_odom_base: &Pose) -> bool {
    let off = t_odom_last.inv_mul(t_odom_base);
    off.translation.vector.norm() >= params.distance_m || off.rotation.angle() >= params.angle_rad
}
