//! Identity through time: which thing is which, what moved, what is gone.

use crate::association::associate;
use crate::track::Track;
use crate::{
    Object, ObjectChange, ObjectChangeKind, ObjectId, ObjectState, Observation, SceneError, TrackerParams, Visibility,
    overlap,
};
use nalgebra::Point3;
use percept_geometry::{OrientedBox3, Pose, Timestamp, se3};
use std::cmp::Ordering;
use std::collections::BTreeMap;

/// Share of the smaller of two boxes from which what a keyframe shows is what was seen passing there.
const SAME_AS_PASSING: f64 = 0.5;

/// Follows objects from update to update.
#[derive(Debug, Clone)]
pub struct Tracker {
    pub(crate) params: TrackerParams,
    /// In the order of birth.
    pub(crate) tracks: Vec<Track>,
    pub(crate) next_id: u64,
}

impl Tracker {
    /// A tracker that knows no object.
    ///
    /// # Errors
    /// `InvalidParam` from the parameters.
    pub fn new(params: TrackerParams) -> Result<Self, SceneError> {
        params.validate()?;
        Ok(Self { params, tracks: Vec::new(), next_id: 0 })
    }

    /// A tracker that goes on from saved objects. `next_id` is what [`Tracker::next_id`] said when they were saved.
    ///
    /// # Errors
    /// `InvalidParam` from the parameters.
    pub fn restore(params: TrackerParams, objects: &[Object], next_id: u64) -> Result<Self, SceneError> {
        params.validate()?;
        let mut tracks: Vec<Track> = objects.iter().map(Track::restored).collect();
        tracks.sort_by_key(|t| t.id);
        let beyond = objects.iter().map(|o| o.id.0.saturating_add(1)).max().unwrap_or(0);
        Ok(Self { params, tracks, next_id: next_id.max(beyond) })
    }

    /// Goes on with other parameters; what is followed stays.
    ///
    /// # Errors
    /// `InvalidParam`; nothing was changed.
    pub fn set_params(&mut self, params: TrackerParams) -> Result<(), SceneError> {
        params.validate()?;
        self.params = params;
        Ok(())
    }

    /// Boxes of what is on its way between keyframes, where it is expected at a stamp.
    pub fn passing_boxes(&self, stamp: Timestamp) -> Vec<OrientedBox3> {
        let moving = self.tracks.iter().filter(|t| t.is_passing && t.state == ObjectState::Moving);
        moving.map(|t| t.predicted(stamp, self.params.coast_s)).collect()
    }

    /// What is known to stand, its centre within `range_m` of a point in the map, with its box.
    pub fn standing_near(&self, center: &Point3<f64>, range_m: f64) -> Vec<(ObjectId, OrientedBox3)> {
        let is_near = |t: &&Track| (t.bbox.center() - center).norm_squared() <= range_m * range_m;
        let standing = self.tracks.iter().filter(|t| t.state == ObjectState::Static && !t.is_passing);
        standing.filter(is_near).filter_map(|t| Some((t.id?, t.bbox))).collect()
    }

    /// Notes at `stamp` that what stood is not where it was any more: its place was seen through for long enough by whoever asks.
    /// Nothing, if it does not stand.
    pub fn take_away(&mut self, id: ObjectId, stamp: Timestamp) -> Vec<ObjectChange> {
        let stands = |t: &Track| t.id == Some(id) && t.state == ObjectState::Static && !t.is_passing;
        let Some(i) = self.tracks.iter().position(stands) else { return vec![] };
        let mut changes: Vec<ObjectChange> = self.become_gone(i, stamp).into_iter().collect();
        if changes.is_empty() {
            self.remove(&[i]);
        }
        self.tell_of_wholes(&mut changes);
        changes
    }

    /// What a confirmed track that is gone tells; none if people had deleted it: what stands there from now on is something else, and
    /// the track is to be removed.
    fn become_gone(&mut self, i: usize, stamp: Timestamp) -> Option<ObjectChange> {
        let track = &mut self.tracks[i];
        track.state = ObjectState::Gone;
        track.remember_at(stamp);
        let id = track.id.filter(|_| !track.annotation.is_deleted)?;
        Some(ObjectChange { id, kind: ObjectChangeKind::Gone })
    }

    /// The number that the next object will get.
    pub fn next_id(&self) -> u64 {
        self.next_id
    }

    /// The confirmed objects, ascending by id: those that are gone included, and those that people set aside. Copies.
    pub fn objects(&self) -> Vec<Object> {
        let mut out: Vec<Object> = self.tracks.iter().filter_map(Track::to_object).collect();
        out.sort_by_key(|o| o.id);
        out
    }

    /// Takes in what was detected at `stamp` and tells what changed, ascending by object.
    ///
    /// `observations` is everything detected in this update, boxes in the map frame; unusable ones (see
    /// [`Observation::is_usable`]) are passed over. `visibility` says what the sensors of this update tell about
    /// the place of an object that was expected and not detected.
    pub fn update(
        &mut self,
        stamp: Timestamp,
        observations: &[Observation],
        visibility: &dyn Fn(&OrientedBox3) -> Visibility,
    ) -> Vec<ObjectChange> {
        let mut observations: Vec<Observation> = observations.iter().filter(|o| o.is_usable()).copied().collect();
        observations.sort_by(canonical_order);
        // What passes is followed by itself.
        let passing: Vec<OrientedBox3> =
            self.tracks.iter().filter(|t| t.is_passing).map(|t| t.predicted(stamp, self.params.coast_s)).collect();
        observations.retain(|o| passing.iter().all(|b| overlap::share_of_smaller(&o.bbox, b) < SAME_AS_PASSING));
        let assigned = associate(&self.tracks, &observations, stamp, &self.params, |t| !t.is_passing);
        let mut changes = Vec::new();
        self.observe(stamp, &observations, &assigned, &mut changes);
        let seen: Vec<bool> = assigned.iter().map(Option::is_some).collect();
        let removed = self.judge_missed(stamp, &seen, visibility, &mut changes);
        self.remove(&removed);
        let free = |o: &usize| !assigned.contains(&Some(*o));
        let born: Vec<Observation> = (0..observations.len()).filter(free).map(|o| observations[o]).collect();
        self.give_birth(stamp, &born, &mut changes);
        self.tell_of_wholes(&mut changes);
        changes.sort_by_key(|c| c.id);
        changes
    }

    /// Moves objects with the map after a correction: `t_new_old` says for each by which transform of map
    /// coordinates. Boxes stay upright.
    pub fn correct(&mut self, t_new_old: &dyn Fn(&OrientedBox3, Timestamp) -> Pose) {
        for track in &mut self.tracks {
            let t = t_new_old(&track.bbox, track.last_seen);
            track.transform(&t);
        }
    }

    /// What people set aside is not told of; of a part its whole is.
    pub(crate) fn tell_of_wholes(&self, changes: &mut Vec<ObjectChange>) {
        let aside: BTreeMap<ObjectId, Option<ObjectId>> = (self.tracks.iter())
            .filter(|t| !t.annotation.is_listed())
            .filter_map(|t| Some((t.id?, t.annotation.part_of)))
            .collect();
        if aside.is_empty() {
            return;
        }
        let wholes: Vec<ObjectId> = changes.iter().filter_map(|c| *aside.get(&c.id)?).collect();
        changes.retain(|c| !aside.contains_key(&c.id));
        for id in wholes {
            if changes.iter().all(|c| c.id != id) {
                changes.push(ObjectChange { id, kind: ObjectChangeKind::Updated });
            }
        }
    }

    fn observe(
        &mut self,
        stamp: Timestamp,
        observations: &[Observation],
        assigned: &[Option<usize>],
        changes: &mut Vec<ObjectChange>,
    ) {
        let mut kinds = Vec::new();
        for (track, observation) in self.tracks.iter_mut().zip(assigned) {
            let Some(o) = *observation else { continue };
            kinds.clear();
            track.observe(&observations[o], stamp, &self.params, &mut kinds);
            if let Some(id) = track.id {
                changes.extend(kinds.iter().map(|&kind| ObjectChange { id, kind }));
            } else if track.looks >= self.params.confirm_observations {
                track.id = Some(confirm(&mut self.next_id, changes));
                track.remember_at(track.first_seen);
            }
        }
    }

    /// What was not detected is hidden, gone, or a part of something else. Returns the tracks to remove, ascending.
    fn judge_missed(
        &mut self,
        stamp: Timestamp,
        seen: &[bool],
        visibility: &dyn Fn(&OrientedBox3) -> Visibility,
        changes: &mut Vec<ObjectChange>,
    ) -> Vec<usize> {
        let mut removed = Vec::new();
        let seen: Vec<usize> = (0..self.tracks.len()).filter(|&i| seen[i]).collect();
        let seen = &seen[..];
        let missed: Vec<usize> =
            (0..self.tracks.len()).filter(|i| seen.binary_search(i).is_err() && !self.tracks[*i].is_passing).collect();
        for i in missed {
            if self.tracks[i].state == ObjectState::Gone {
                continue;
            }
            if let Some(whole) = self.duplicate_of(i, seen, &removed) {
                removed.push(self.merge(i, whole, changes));
                continue;
            }
            let looked = visibility(&self.tracks[i].predicted(stamp, self.params.coast_s));
            let whole = if looked == Visibility::Occupied { self.whole_of(i, seen, &removed) } else { None };
            let track = &mut self.tracks[i];
            match looked {
                Visibility::SeenThrough => track.seen_through += 1,
                Visibility::Occupied => track.seen_through = 0,
                Visibility::Refuted => track.refuted += 1,
                Visibility::Unseen => {}
            }
            let is_said = !track.annotation.is_empty();
            if track.refuted >= self.params.swallow_observations && !is_said {
                removed.push(i);
                changes.extend(track.id.map(|id| ObjectChange { id, kind: ObjectChangeKind::Forgotten }));
                continue;
            }
            track.swallowed = if whole.is_some() { track.swallowed + 1 } else { track.swallowed };
            if let Some(whole) = whole.filter(|_| track.swallowed >= self.params.swallow_observations && !is_said) {
                removed.push(self.merge(i, whole, changes));
                continue;
            }
            if track.id.is_none() {
                let late = stamp.seconds_since(track.last_seen) > self.params.tentative_timeout_s;
                if late || looked == Visibility::SeenThrough {
                    removed.push(i);
                }
                continue;
            }
            let missed_s = stamp.seconds_since(track.last_seen);
            let was_seen_through =
                track.seen_through >= self.params.gone_observations && missed_s >= self.params.gone_after_s;
            // What went away while nobody looked is not where it was.
            let has_gone_on =
                track.state == ObjectState::Moving && missed_s > self.params.coast_s + self.params.gone_after_s;
            if was_seen_through || has_gone_on {
                match self.become_gone(i, stamp) {
                    Some(change) => changes.push(change),
                    None => removed.push(i),
                }
            }
        }
        removed.sort_unstable();
        removed
    }

    /// A track seen in this update that track `i`, missed and resting, is a double of.
    fn duplicate_of(&self, i: usize, seen: &[usize], removed: &[usize]) -> Option<usize> {
        let missed = &self.tracks[i];
        let resting = |t: &Track| t.state == ObjectState::Static;
        let overlaps = |j: &usize| overlap::iou(&missed.bbox, &self.tracks[*j].bbox) >= self.params.merge_iou;
        if !resting(missed) || !missed.annotation.is_empty() {
            return None;
        }
        let mut candidates = seen.iter().copied().filter(|j| !removed.contains(j) && resting(&self.tracks[*j]));
        candidates.find(overlaps)
    }

    /// A track seen in this update whose box holds that of track `i`.
    fn whole_of(&self, i: usize, seen: &[usize], removed: &[usize]) -> Option<usize> {
        let part = &self.tracks[i].bbox;
        let holds = |b: &OrientedBox3| b.volume() > part.volume() && overlap::share_of(part, b) >= 0.8;
        seen.iter().copied().find(|j| !removed.contains(j) && holds(&self.tracks[*j].bbox))
    }

    /// Makes one track of two; the identity of the one that people spoke of stays, else the older confirmed one's. Returns the index that is free now.
    fn merge(&mut self, missed: usize, seen: usize, changes: &mut Vec<ObjectChange>) -> usize {
        let age = |i: usize| (self.tracks[i].annotation.is_empty(), self.tracks[i].id.is_none(), self.tracks[i].id, i);
        let (keep, lose) = if age(missed) < age(seen) { (missed, seen) } else { (seen, missed) };
        let lost = self.tracks[lose].clone();
        self.tracks[keep].absorb(&lost);
        if let (Some(id), Some(into)) = (lost.id, self.tracks[keep].id) {
            changes.push(ObjectChange { id, kind: ObjectChangeKind::Merged { into } });
        }
        lose
    }

    pub(crate) fn remove(&mut self, ascending: &[usize]) {
        let mut index = 0;
        self.tracks.retain(|_| {
            index += 1;
            ascending.binary_search(&(index - 1)).is_err()
        });
    }

    fn give_birth(&mut self, stamp: Timestamp, born: &[Observation], changes: &mut Vec<ObjectChange>) {
        let over = (self.tracks.len() + born.len()).saturating_sub(self.params.max_objects);
        let mut gone: Vec<(Timestamp, Option<ObjectId>, usize)> = (0..self.tracks.len())
            .filter(|&i| self.tracks[i].state == ObjectState::Gone && self.tracks[i].annotation.is_empty())
            .map(|i| (self.tracks[i].last_seen, self.tracks[i].id, i))
            .collect();
        gone.sort_unstable();
        gone.truncate(over);
        changes
            .extend(gone.iter().filter_map(|g| g.1).map(|id| ObjectChange { id, kind: ObjectChangeKind::Forgotten }));
        let mut removed: Vec<usize> = gone.iter().map(|g| g.2).collect();
        removed.sort_unstable();
        self.remove(&removed);
        let room = self.params.max_objects.saturating_sub(self.tracks.len());
        for observation in born.iter().take(room) {
            let mut track = Track::new(observation, stamp, &self.params);
            if self.params.confirm_observations <= track.looks {
                track.id = Some(confirm(&mut self.next_id, changes));
                track.remember_at(stamp);
            }
            self.tracks.push(track);
        }
    }
}

pub(crate) fn confirm(next_id: &mut u64, changes: &mut Vec<ObjectChange>) -> ObjectId {
    let id = ObjectId(*next_id);
    *next_id += 1;
    changes.push(ObjectChange { id, kind: ObjectChangeKind::Appeared });
    id
}

/// An order that depends on what was seen only, so that the order of detection does not matter.
pub(crate) fn canonical_order(a: &Observation, b: &Observation) -> Ordering {
    let key = |o: &Observation| {
        let (c, s) = (o.bbox.center(), o.bbox.size);
        [c.x, c.y, c.z, s.x, s.y, s.z, se3::yaw(&o.bbox.t_frame_box), o.confidence, o.num_points as f64]
    };
    let (ka, kb) = (key(a), key(b));
    let numbers = ka.iter().zip(&kb).map(|(x, y)| x.total_cmp(y)).find(|o| o.is_ne());
    numbers.unwrap_or(Ordering::Equal).then(a.class.cmp(&b.class))
}
