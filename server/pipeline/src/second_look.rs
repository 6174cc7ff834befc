//! Second looks: keyframes that are made where the robot stands, as long as what it sees contradicts the map.
//!
//! A keyframe is made of each half metre, and the map lets go of what it is sure of after nine of them: a cabinet that was carried
//! away would stay in it for as long as the robot takes for four metres, and for ever where it stands. So every fifth of a second
//! the newest frame is compared with the map, beside the frames. Where that is wrong a keyframe is made, and again, until it is right.

use crate::beside::{Executor, Task};
use percept_geometry::{Cell, SensorId, Timestamp};
use percept_mapping::Contradicted;
use std::collections::BTreeMap;
use std::sync::Arc;

/// From one comparison to the next, seconds: nine keyframes fit into two seconds, the tenth into what an operator waits for.
const EVERY_S: f64 = 0.2;
/// Who has made no keyframe for so long stands or hardly moves, seconds: a keyframe is made of each half metre.
const FIRST_S: f64 = 0.5;
/// The map is wrong about a cell if so many looks have told it so.
const SURE_LOOKS: f32 = 1.0;
/// One look at what has come may leave a third of a look, which would not be missed when it goes: so two are taken.
const FEWEST: u32 = 2;
/// What has come belongs into the map once so many comparisons in a row have seen it: after three seconds, in which a person who
/// walks by is gone.
const COME_FOR: u32 = 15;
/// So many second looks follow each other at most: what the map has not learned by then it does not learn from here. From the surest
/// free cell to an occupied one it takes five, the other way ten.
const MOST: u32 = 12;

/// What the newest frames of each sensor say against the map.
#[derive(Default)]
pub(crate) struct SecondLooks(BTreeMap<SensorId, Watch>);

/// Why a map is looked at again.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum SecondLook {
    /// Something has gone. Who happens to be there meanwhile is not to enter the map by it.
    Gone,
    /// Something has come to stay.
    Come,
}

/// Of one sensor.
#[derive(Default)]
struct Watch {
    /// Stamp of its newest keyframe or comparison.
    since: Option<Timestamp>,
    /// Whether frames have been compared since its newest keyframe, or are to be.
    is_watching: bool,
    task: Option<Task<Contradicted>>,
    /// Whether the frame that is worked on becomes a keyframe by it.
    is_due: bool,
    /// In how many comparisons in a row something was seen in cells that the map says are free.
    come: BTreeMap<Cell, u32>,
    /// Second looks since the map was right, or since the robot came here.
    taken: u32,
    /// What the next one is for, or the newest one was.
    why: Option<SecondLook>,
}

impl SecondLooks {
    /// The robot may be elsewhere, or the map be another.
    pub(crate) fn clear(&mut self) {
        self.0.clear();
    }

    /// Whether a frame becomes a keyframe because the map was wrong; it is anchored in the map.
    pub(crate) fn is_due(&mut self, sensor: &SensorId, stamp: Timestamp) -> bool {
        let watch = self.0.entry(sensor.clone()).or_default();
        if watch.task.is_none() || !watch.is_over(stamp, EVERY_S) {
            return false;
        }
        watch.is_due = watch.task.take().is_some_and(|task| watch.learn(&task.finished()));
        watch.is_due
    }

    /// A frame becomes a keyframe: for a second look, or because the robot has moved on.
    pub(crate) fn take_keyframe(&mut self, sensor: &SensorId, stamp: Timestamp) -> Option<SecondLook> {
        let watch = self.0.entry(sensor.clone()).or_default();
        let why = watch.why.filter(|_| watch.is_due);
        (watch.since, watch.is_watching, watch.is_due) = (Some(stamp), watch.is_due, false);
        watch.task = None;
        watch.taken = if why.is_some() { watch.taken + 1 } else { 0 };
        why
    }

    /// Compares a frame with the map beside the frames, if it is time for that.
    pub(crate) fn compare(
        &mut self,
        sensor: &SensorId,
        stamp: Timestamp,
        executor: Option<&Arc<dyn Executor>>,
        compare: impl FnOnce(f32) -> Contradicted + Send + 'static,
    ) {
        let watch = self.0.entry(sensor.clone()).or_default();
        let is_time = match watch.taken {
            0 => watch.is_over(stamp, if watch.is_watching { EVERY_S } else { FIRST_S }),
            _ => true,
        };
        if watch.task.is_none() && is_time {
            (watch.since, watch.is_watching) = (Some(stamp), true);
            // What is begun is brought to an end: until the map says the right thing, not until it is no longer sure of the wrong one.
            let looks = if watch.taken > 0 { 0.0 } else { SURE_LOOKS };
            watch.task = Some(Task::begin(executor, move || compare(looks)));
        }
    }
}

impl Watch {
    /// Whether so much time is over since the newest keyframe or comparison. Who goes back in time begins anew.
    fn is_over(&self, stamp: Timestamp, time_s: f64) -> bool {
        self.since.is_none_or(|since| !(0.0..time_s).contains(&stamp.seconds_since(since)))
    }

    /// Whether the map is to be looked at again.
    fn learn(&mut self, contradicted: &Contradicted) -> bool {
        let before = std::mem::take(&mut self.come);
        let so_far = |cell: &Cell| before.get(cell).copied().unwrap_or(0);
        self.come = contradicted.come.iter().map(|cell| (*cell, so_far(cell) + 1)).collect();
        let has_come = self.come.values().any(|n| *n >= COME_FOR);
        self.why = match (has_come, contradicted.gone.is_empty()) {
            (true, _) => Some(SecondLook::Come),
            (false, false) => Some(SecondLook::Gone),
            (false, true) => self.why.filter(|_| (1..FEWEST).contains(&self.taken)),
        };
        if self.why.is_none() {
            self.taken = 0;
        }
        self.why.is_some() && self.taken < MOST
    }
}
