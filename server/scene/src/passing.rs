//! What passes: people and things that move between keyframes, found in frames where the map says that nothing stands.
//!
//! They are tracks of their own until they come to rest: born where something is in free space, listed once it has left the place
//! where it was first seen, gone when nobody has seen them for a while. What never moves is not told: the map learns of it, and
//! keyframes show it.

use crate::association::associate;
use crate::track::Track;
use crate::tracker::{canonical_order, confirm};
use crate::{ObjectChange, ObjectChangeKind, ObjectState, Observation, Tracker, Visibility};
use percept_geometry::{ObjectClass, OrientedBox3, Timestamp};

/// Updates that see something that passes in motion, before it is listed.
const LOOKS: u64 = 2;
/// Who goes out of sight and comes back within so long is the same, if nobody else can be, seconds: a person takes that to walk around
/// a table. And so fast, m/s: a quick walk.
const AWAY_S: f64 = 10.0;
const WALK: f64 = 1.5;
/// What has not moved so far and is not seen for so long was nothing, seconds.
const FORGET_S: f64 = 1.0;

impl Tracker {
    /// Whether something may be passing: else an update without observations changes nothing.
    pub fn has_passing(&self) -> bool {
        self.tracks.iter().any(|t| t.is_passing)
    }

    /// Takes in what a frame shows in free space at `stamp`, and tells what changed, ascending by object. What was known to stand is
    /// left alone, but for people, who set off.
    ///
    /// `observations` are boxes in the map frame; `visibility` says what the frame tells about a place.
    pub fn update_passing(
        &mut self,
        stamp: Timestamp,
        observations: &[Observation],
        visibility: &dyn Fn(&OrientedBox3) -> Visibility,
    ) -> Vec<ObjectChange> {
        let mut observations: Vec<Observation> = observations.iter().filter(|o| o.is_usable()).copied().collect();
        observations.sort_by(canonical_order);
        let is_person = |t: &Track| t.state == ObjectState::Static && t.class().0 == ObjectClass::Person;
        let is_asked = |t: &Track| t.last_seen < stamp && (t.is_passing || is_person(t));
        let assigned = associate(&self.tracks, &observations, stamp, &self.params, is_asked);
        let mut changes = Vec::new();
        let mut removed = Vec::new();
        for (i, observation) in assigned.iter().enumerate() {
            match observation {
                Some(o) => self.see_passing(i, &observations[*o], stamp, &mut changes),
                None if self.tracks[i].is_passing && self.miss_passing(i, stamp, visibility, &mut changes) => {
                    removed.push(i)
                }
                None => {}
            }
        }
        self.remove(&removed);
        let is_new = |t: &Track| t.id.is_none() && t.is_passing && t.looks >= LOOKS;
        while let Some(i) = self.tracks.iter().position(is_new) {
            self.tell_of(i, stamp, &mut changes);
        }
        let room = self.params.max_objects.saturating_sub(self.tracks.len());
        let free = (0..observations.len()).filter(|o| !assigned.contains(&Some(*o)));
        for o in free.take(room) {
            let mut track = Track::new(&Observation { is_seen: false, ..observations[o] }, stamp, &self.params);
            track.is_passing = true;
            self.tracks.push(track);
        }
        self.tell_of_wholes(&mut changes);
        changes.sort_by_key(|c| c.id);
        changes
    }

    fn see_passing(&mut self, i: usize, seen: &Observation, stamp: Timestamp, changes: &mut Vec<ObjectChange>) {
        let track = &mut self.tracks[i];
        let mut kinds = Vec::new();
        // A look counts once it is on its way.
        let is_seen = track.id.is_some() || track.state == ObjectState::Moving;
        track.observe(&Observation { is_seen, ..*seen }, stamp, &self.params, &mut kinds);
        track.last_seen = track.last_seen.max(stamp);
        track.is_passing |= track.state == ObjectState::Moving;
        if let Some(id) = track.id {
            changes.extend(kinds.iter().map(|&kind| ObjectChange { id, kind }));
        }
    }

    /// Lists a track: as who went out of sight near there a while ago, if that can be said of one alone.
    fn tell_of(&mut self, i: usize, stamp: Timestamp, changes: &mut Vec<ObjectChange>) {
        let (now, class) = (self.tracks[i].bbox.center(), self.tracks[i].class().0);
        let may_be = |t: &&mut Track| {
            let away_s = stamp.seconds_since(t.last_seen);
            let reach_m = self.params.association_distance_m + WALK * away_s;
            let is_alike = t.state == ObjectState::Gone && t.class().0 == class && class == ObjectClass::Person;
            is_alike && away_s <= AWAY_S && (t.bbox.center() - now).xy().norm() <= reach_m
        };
        let mut away: Vec<&mut Track> = self.tracks.iter_mut().filter(may_be).collect();
        let before = match &mut away[..] {
            [one] => one.id.take().map(|id| (id, one.clone())),
            _ => None,
        };
        let Some((id, before)) = before else {
            self.tracks[i].id = Some(confirm(&mut self.next_id, changes));
            self.tracks[i].remember_at(stamp);
            return;
        };
        self.tracks[i].go_on_as(id, &before, stamp);
        // What has neither a name nor anybody who looks for it is forgotten.
        self.tracks.retain(|t| t.id.is_some() || t.state != ObjectState::Gone);
        changes.push(ObjectChange { id, kind: ObjectChangeKind::Reappeared });
    }

    /// Whether a track that was not seen is to be forgotten.
    fn miss_passing(
        &mut self,
        i: usize,
        stamp: Timestamp,
        visibility: &dyn Fn(&OrientedBox3) -> Visibility,
        changes: &mut Vec<ObjectChange>,
    ) -> bool {
        let (coast_s, gone_after_s) = (self.params.coast_s, self.params.gone_after_s);
        let track = &mut self.tracks[i];
        let missed_s = stamp.seconds_since(track.last_seen);
        let Some(id) = track.id else { return missed_s > FORGET_S };
        if visibility(&track.predicted(stamp, coast_s)) == Visibility::SeenThrough {
            track.seen_through += 1;
        }
        let was_seen_through = track.seen_through >= self.params.gone_observations && missed_s >= gone_after_s;
        if was_seen_through || missed_s > coast_s + gone_after_s {
            (track.state, track.is_passing) = (ObjectState::Gone, false);
            track.remember_at(stamp);
            changes.push(ObjectChange { id, kind: ObjectChangeKind::Gone });
        }
        false
    }
}
