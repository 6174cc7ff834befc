//! Parts of the map that hang on nothing: the largest is the map, the others wait until they are recognised in it.
//!
//! A robot that is unanchored gathers a part of its own. One that grows far beyond the map becomes the map, as where a session
//! was lost early, and what was the map waits as a part; so does a part that a robot gathered before it was lost again. Parts
//! that wait are looked for in the map while it grows, some keyframes of them at a time, and join where one is recognised. Parts
//! that wait are not stored.
//!
//! The name is that of Elvira et al., "ORBSLAM-Atlas: a robust and accurate multi-map system", 2019.

use super::MapGraph;
use super::part::{Part, PartKeyframe, Search};
use super::worker::{Question, Relocated, Sighting};
use percept_geometry::{Pose, SensorId, Timestamp};
use percept_slam::Relocalisation;
use std::sync::Arc;

/// Parts that wait, at most; when there are more, the smallest is given up.
const MOST_PARTS: usize = 16;
/// A part is looked for by so many keyframes at a time, and after them by those so many further on.
const WINDOW: (usize, usize) = (20, 8);
/// Keyframes of the map for one more keyframe between such searches: each of them looks at all of the map.
const MAP_A_KEYFRAME: usize = 1000;

/// The parts that wait.
#[derive(Debug, Default)]
pub(super) struct Atlas {
    parts: Vec<Part>,
    search: Search,
    /// The part that is looked for, and the end of the window of its keyframes.
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

    /// The map is another one now: where a part was found in it says nothing any more.
    pub(super) fn forget_found(&mut self) {
        self.found = None;
    }

    /// A part that was found, where, and base to the part there; it waits no longer. None if none was.
    pub(super) fn take_found(&mut self) -> Option<(Part, Relocalisation, Pose)> {
        let Relocated { found, t_odom_base: t_part_found, part, .. } = self.found.take()?;
        let k = self.parts.iter().position(|p| p.number == part)?;
        let found = found?;
        self.turn = (0, 0);
        Some((self.parts.remove(k), found, t_part_found))
    }

    /// The keyframes of a part that are looked for next, or on.
    fn sighting(&mut self, pose_sensor: &SensorId) -> Option<Sighting> {
        let (mut k, mut end) = self.turn;
        if !self.search.is_unfinished || end == 0 {
            end += WINDOW.1;
        }
        if self.parts.get(k).is_none_or(|part| end >= part.keyframes.len() + WINDOW.1) {
            (k, end) = (k + 1, WINDOW.1);
        }
        k = if k < self.parts.len() { k } else { 0 };
        self.turn = (k, end);
        let part = self.parts.get(k)?;
        let window = part.keyframes.iter().take(end).skip(end.saturating_sub(WINDOW.0));
        let seen: Vec<&PartKeyframe> = window.filter(|k| k.sensor == *pose_sensor).collect();
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

impl MapGraph {
    /// Parts that wait are looked for in the map, a window at a time while it grows.
    pub(crate) fn look_for_parts(&mut self, stamp: Timestamp, pose_sensor: &SensorId, has_grown: bool) {
        let atlas = &mut self.atlas;
        atlas.since += usize::from(has_grown);
        let is_due = atlas.since > self.map.keyframes().len() / MAP_A_KEYFRAME || atlas.search.is_unfinished;
        if atlas.parts.is_empty() || atlas.search.is_asked || !is_due || !self.constraints.is_active() {
            return;
        }
        atlas.since = 0;
        if let Some(sighting) = atlas.sighting(pose_sensor) {
            self.constraints.ask(Question::Relocalise(sighting), stamp);
            atlas.search.is_asked = true;
        }
    }
}
