//! One thing followed through time: its box, class, motion and how often it was missed.

use crate::motion::Motion;
use crate::{
    Annotation, ClassBelief, Object, ObjectChangeKind, ObjectId, ObjectState, Observation, PastState, TrackerParams,
    overlap,
};
use nalgebra::Vector3;
use percept_geometry::{ObjectClass, OrientedBox3, Timestamp};

/// Share of the box's support that stays from one observation to the next: a map that was corrected may give
/// fewer points than before, and is to be believed after some twenty looks.
const SUPPORT_DECAY: f64 = 0.95;
/// A box moved by more than this (m) since it was last reported is reported again.
const REPORT_DISTANCE_M: f64 = 0.05;
/// States of the past that are kept of an object: of more the second oldest is forgotten, so that its first stays.
const MAX_HISTORY: usize = 64;
/// Observations in a row away from the anchor that make a movement: one alone may be a bad box.
const OBSERVATIONS_AWAY: u32 = 2;

#[derive(Debug, Clone)]
pub(crate) struct Track {
    /// None until confirmed.
    pub(crate) id: Option<ObjectId>,
    pub(crate) bbox: OrientedBox3,
    pub(crate) belief: ClassBelief,
    pub(crate) state: ObjectState,
    pub(crate) first_seen: Timestamp,
    pub(crate) last_seen: Timestamp,
    pub(crate) observation_count: u64,
    /// Of those the ones in which beams ended at it.
    pub(crate) looks: u64,
    /// Updates in a row that saw through its place.
    pub(crate) seen_through: u32,
    pub(crate) refuted: u32,
    /// Updates in a row in which its place was occupied, but detected as a part of a larger object.
    pub(crate) swallowed: u32,
    motion: Motion,
    /// Whether it is followed by what moves from frame to frame, beside what keyframes show.
    pub(crate) is_passing: bool,
    /// Where it stood when it was last known to move (or was first seen).
    anchor: OrientedBox3,
    anchor_stamp: Timestamp,
    away: u32,
    /// Its box before an observation away from it, until that proves to be a movement or a bad box.
    before: Option<OrientedBox3>,
    support: f64,
    num_points: usize,
    reported: OrientedBox3,
    pub(crate) annotation: Annotation,
    history: Vec<PastState>,
}

impl Track {
    pub(crate) fn new(observation: &Observation, stamp: Timestamp, params: &TrackerParams) -> Self {
        let bbox = overlap::upright(&observation.bbox);
        let mut belief = ClassBelief::uniform();
        belief.observe(observation.class, observation.confidence, params.class_memory);
        Self {
            id: None,
            bbox,
            belief,
            state: if observation.is_moving { ObjectState::Moving } else { ObjectState::Static },
            first_seen: stamp,
            last_seen: stamp,
            observation_count: 1,
            looks: u64::from(observation.is_seen),
            seen_through: 0,
            refuted: 0,
            swallowed: 0,
            motion: Motion::at(stamp, bbox.center()),
            is_passing: false,
            anchor: bbox,
            anchor_stamp: stamp,
            away: 0,
            before: None,
            support: observation.num_points.max(1) as f64,
            num_points: observation.num_points,
            reported: bbox,
            annotation: Annotation::default(),
            history: Vec::new(),
        }
    }

    pub(crate) fn restored(object: &Object) -> Self {
        Self {
            id: Some(object.id),
            bbox: object.bbox,
            belief: ClassBelief::from_probabilities(&object.class_probabilities),
            state: object.state,
            first_seen: object.first_seen,
            last_seen: object.last_seen,
            observation_count: object.observation_count,
            looks: object.observation_count,
            seen_through: 0,
            refuted: 0,
            swallowed: 0,
            motion: Motion::at(object.last_seen, object.bbox.center()).with_velocity(object.velocity_mps),
            is_passing: false,
            anchor: object.bbox,
            anchor_stamp: object.last_seen,
            away: 0,
            before: None,
            support: object.num_points.max(1) as f64,
            num_points: object.num_points,
            reported: object.bbox,
            annotation: object.annotation,
            history: object.history.clone(),
        }
    }

    /// A piece of another, as a person drew it.
    pub(crate) fn drawn(whole: &Self, id: ObjectId, bbox: &OrientedBox3) -> Self {
        let bbox = overlap::upright(bbox);
        let annotation =
            Annotation { class: whole.annotation.class, is_drawn: true, piece_of: whole.id, ..Annotation::default() };
        let mut piece = Self {
            id: Some(id),
            bbox,
            anchor: bbox,
            reported: bbox,
            before: None,
            state: ObjectState::Static,
            motion: Motion::at(whole.last_seen, bbox.center()),
            is_passing: false,
            annotation,
            history: Vec::new(),
            ..whole.clone()
        };
        (piece.seen_through, piece.refuted, piece.swallowed, piece.away) = (0, 0, 0, 0);
        piece
    }

    /// What a person said that it is, else the likeliest class; and how sure that is, 0..1.
    pub(crate) fn class(&self) -> (ObjectClass, f64) {
        self.annotation.class.map_or_else(|| self.belief.best(), |class| (class, 1.0))
    }

    /// Writes down what it is from when it was last seen on.
    pub(crate) fn remember(&mut self) {
        self.remember_at(self.last_seen);
    }

    /// Writes down what it is from a stamp on.
    pub(crate) fn remember_at(&mut self, stamp: Timestamp) {
        let stamp = self.history.last().map_or(stamp, |h| h.stamp.max(stamp));
        let now = PastState { stamp, class: self.class().0, state: self.state, bbox: self.bbox };
        match self.history.last_mut() {
            Some(last) if last.stamp == stamp => *last = now,
            _ => self.history.push(now),
        }
        if self.history.len() > MAX_HISTORY {
            self.history.remove(1);
        }
    }

    pub(crate) fn to_object(&self) -> Option<Object> {
        let (class, confidence) = self.class();
        Some(Object {
            id: self.id?,
            class,
            confidence,
            class_probabilities: self.belief.probabilities(),
            bbox: self.bbox,
            state: self.state,
            velocity_mps: if self.state == ObjectState::Moving { self.motion.velocity() } else { Vector3::zeros() },
            velocity_variance: if self.state == ObjectState::Moving { self.motion.velocity_variance() } else { 0.0 },
            first_seen: self.first_seen,
            last_seen: self.last_seen,
            observation_count: self.observation_count,
            num_points: self.num_points,
            annotation: self.annotation,
            history: self.history.clone(),
        })
    }

    /// Where it should be at `stamp`: a moving thing goes on for at most `coast_s`.
    pub(crate) fn predicted(&self, stamp: Timestamp, coast_s: f64) -> OrientedBox3 {
        let mut out = self.bbox;
        if self.state == ObjectState::Moving {
            let elapsed = stamp.seconds_since(self.last_seen).clamp(0.0, coast_s);
            out.t_frame_box.translation.vector += self.motion.velocity() * elapsed;
        }
        out
    }

    /// It is the thing that another track followed before.
    pub(crate) fn go_on_as(&mut self, id: ObjectId, before: &Self, stamp: Timestamp) {
        self.id = Some(id);
        self.first_seen = before.first_seen;
        self.observation_count += before.observation_count;
        self.looks += before.looks;
        self.belief = self.belief.pooled(&before.belief);
        (self.annotation, self.history) = (before.annotation, before.history.clone());
        self.remember_at(stamp);
    }

    /// Whether something seen there may be this, which is on its way.
    pub(crate) fn may_be_at(&self, seen: &OrientedBox3, stamp: Timestamp) -> bool {
        self.motion.predicted(stamp, f64::INFINITY).may_be_at(&seen.center())
    }

    /// Takes an observation in; what changed about a confirmed track is pushed to `changes`.
    pub(crate) fn observe(
        &mut self,
        observation: &Observation,
        stamp: Timestamp,
        params: &TrackerParams,
        changes: &mut Vec<ObjectChangeKind>,
    ) {
        if self.state == ObjectState::Gone && !observation.is_seen {
            // It is what the map still has of it.
            return;
        }
        let seen = overlap::upright(&observation.bbox);
        let class_before = self.class().0;
        self.belief.observe(observation.class, observation.confidence, params.class_memory);
        let class_now = self.class().0;
        if class_now != class_before {
            changes.push(ObjectChangeKind::Reclassified { from: class_before, to: class_now });
        }
        if self.state == ObjectState::Gone {
            self.state = ObjectState::Static;
            (self.bbox, self.anchor, self.motion) = (seen, seen, Motion::at(stamp, seen.center()));
            (self.away, self.before) = (0, None);
            changes.push(ObjectChangeKind::Reappeared);
        }
        self.follow_motion(&seen, observation.is_moving, stamp, params, changes);
        self.fuse(&seen, observation.num_points);
        if observation.is_seen {
            self.last_seen = self.last_seen.max(stamp);
            self.looks += 1;
            self.seen_through = 0;
        }
        self.observation_count += 1;
        (self.refuted, self.swallowed) = (0, 0);
        if !changes.is_empty() && self.id.is_some() {
            self.remember_at(stamp);
        }
        if self.differs_from_report() {
            self.reported = self.bbox;
            changes.push(ObjectChangeKind::Updated);
        }
    }

    /// Decides whether it moves. A box that grows as more of the thing is seen shifts its centre too, but keeps
    /// covering the anchor: only a box that leaves its anchor has moved.
    fn follow_motion(
        &mut self,
        seen: &OrientedBox3,
        is_moving: bool,
        stamp: Timestamp,
        params: &TrackerParams,
        changes: &mut Vec<ObjectChangeKind>,
    ) {
        self.motion.observe(stamp, &seen.center());
        let away = (seen.center() - self.anchor.center()).norm() > params.moving_distance_m
            && overlap::share_of_smaller(seen, &self.anchor) < 0.5;
        self.away = if away { self.away + 1 } else { 0 };
        match (away, self.before) {
            (true, None) => self.before = Some(self.bbox),
            (true, Some(_)) => {}
            (false, _) => self.bbox = self.before.take().unwrap_or(self.bbox),
        }
        let is_elsewhere = away && (self.state == ObjectState::Moving || self.away >= OBSERVATIONS_AWAY);
        if is_elsewhere && !is_moving && !self.is_passing && self.state == ObjectState::Static && !self.may_set_off() {
            // Nobody saw it move: it was carried, or its box was bad.
            (self.anchor, self.anchor_stamp, self.away, self.before) = (*seen, stamp, 0, None);
            (self.bbox, self.motion) = (*seen, Motion::at(stamp, seen.center()));
            changes.push(ObjectChangeKind::Updated);
            return;
        }
        if is_moving || is_elsewhere {
            (self.anchor, self.anchor_stamp, self.away, self.before) = (*seen, stamp, 0, None);
            if self.state != ObjectState::Moving {
                self.state = ObjectState::Moving;
                changes.push(ObjectChangeKind::StartedMoving);
            }
        } else if self.state == ObjectState::Moving && stamp.seconds_since(self.anchor_stamp) > params.settle_s {
            self.state = ObjectState::Static;
            (self.motion, self.is_passing) = (Motion::at(stamp, seen.center()), false);
            self.anchor = *seen;
            changes.push(ObjectChangeKind::Stopped);
        }
    }

    /// Whether it may move by itself: furniture does not.
    fn may_set_off(&self) -> bool {
        use ObjectClass::{Box, Chair, Cylinder, Shelf, Table};
        !matches!(self.class().0, Table | Chair | Shelf | Box | Cylinder)
    }

    /// Mixes the box in by its share of the points: one that rests on many more replaces, one on few adds little.
    fn fuse(&mut self, seen: &OrientedBox3, num_points: usize) {
        let points = num_points.max(1) as f64;
        let moving = self.state == ObjectState::Moving || self.away > 0;
        let gain = points / (points + self.support);
        // A moving thing is where it was seen last; its size still comes from all looks.
        self.bbox = overlap::blend(&self.bbox, seen, gain);
        if moving {
            self.bbox.t_frame_box.translation = seen.t_frame_box.translation;
        }
        self.support = (SUPPORT_DECAY * self.support).max(points);
        if points >= self.support {
            self.num_points = num_points;
        }
        let grown = self.bbox.volume() > 1.1 * self.anchor.volume();
        if !moving && grown && overlap::share_of(&self.anchor, &self.bbox) > 0.9 {
            self.anchor = self.bbox;
        }
    }

    fn differs_from_report(&self) -> bool {
        (self.bbox.center() - self.reported.center()).norm() > REPORT_DISTANCE_M
            || (self.bbox.size - self.reported.size).amax() > REPORT_DISTANCE_M
    }

    /// Takes in another track that turned out to be the same thing.
    pub(crate) fn absorb(&mut self, other: &Self) {
        if other.last_seen > self.last_seen || (other.last_seen == self.last_seen && other.support > self.support) {
            (self.bbox, self.support, self.num_points) = (other.bbox, other.support, other.num_points);
            (self.anchor, self.anchor_stamp) = (other.anchor, other.anchor_stamp);
            (self.state, self.motion) = (other.state, other.motion.clone());
        }
        self.belief = self.belief.pooled(&other.belief);
        self.history.extend(&other.history);
        self.history.sort_by_key(|h| h.stamp);
        let excess = self.history.len().saturating_sub(MAX_HISTORY);
        self.history.drain(1.min(excess)..1.min(excess) + excess);
        self.first_seen = self.first_seen.min(other.first_seen);
        self.last_seen = self.last_seen.max(other.last_seen);
        self.observation_count += other.observation_count;
        self.looks += other.looks;
        (self.seen_through, self.swallowed, self.away, self.before) = (0, 0, 0, None);
    }

    /// Moves it with the map.
    pub(crate) fn transform(&mut self, t_new_old: &percept_geometry::Pose) {
        for b in [&mut self.bbox, &mut self.anchor, &mut self.reported] {
            *b = overlap::upright(&b.transformed(t_new_old));
        }
        self.history.iter_mut().for_each(|h| h.bbox = overlap::upright(&h.bbox.transformed(t_new_old)));
        self.before = self.before.map(|b| overlap::upright(&b.transformed(t_new_old)));
        self.motion.transform(t_new_old);
    }
}
