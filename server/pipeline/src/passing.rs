//! What passes: looked for in the newest frames, beside them, where the map says that nothing stands.
//!
//! A keyframe is made of each half metre that the robot drives: who walks past one that stands is in none. So each 0.15 s
//! the newest frame of each sensor is looked through; what was found enters at the first frame that is [`DELAY_S`] younger.
//!
//! The same frames say what has gone from where it stood: a camera that turns past the place makes one keyframe or two of it.

use crate::beside::{Executor, Task};
use crate::live::News;
use crate::visibility::Beams;
use nalgebra::Point3;
use percept_geometry::{OrientedBox3, Pose, SensorId, Timestamp};
use percept_mapping::CloudMap;
use percept_perception::detection::find_passing;
use percept_scene::{ObjectChange, ObjectId, Observation, Tracker, Visibility};
use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

/// From one look to the next, seconds, at least: at a walk a person goes half of what they are wide, and frames of 5 Hz are all looked at.
const EVERY_S: f64 = 0.15;
/// What was found is taken in so many seconds after the frame: a look takes some milliseconds.
const DELAY_S: f64 = 0.1;
/// A thing is gone when frames have seen through its place so many times, with none between them in which something was there,
const EMPTY_LOOKS: u32 = 5;
/// over so long, seconds, as the tracker waits with keyframes,
const EMPTY_S: f64 = 1.0;
/// and within so long: what was seen before is forgotten.
const EMPTY_WITHIN_S: f64 = 10.0;

/// Looks at frames that are not taken in yet.
#[derive(Default)]
pub(crate) struct Passing {
    /// Begun and not taken in, oldest first.
    looks: VecDeque<Look>,
    /// Stamp of the newest frame that each sensor was looked through.
    newest: BTreeMap<SensorId, Timestamp>,
    /// Since when frames see through the place of a thing that stands, and how many have.
    empty: BTreeMap<ObjectId, (Timestamp, u32)>,
}

struct Look {
    stamp: Timestamp,
    task: Task<Found>,
}

/// Things that stand near a sensor, with their boxes in the map frame.
pub(crate) type Standing = Vec<(ObjectId, OrientedBox3)>;

/// What a frame shows.
struct Found {
    observations: Vec<Observation>,
    t_map_base: Pose,
    beams: Beams,
    /// What it shows of things that stand, where it shows anything.
    standing: Vec<(ObjectId, Visibility)>,
}

impl Passing {
    /// Whether a sensor's frame is to be looked through.
    pub(crate) fn is_due(&self, sensor: &SensorId, stamp: Timestamp) -> bool {
        // Who goes back in time begins anew.
        self.newest.get(sensor).is_none_or(|newest| !(0.0..EVERY_S).contains(&stamp.seconds_since(*newest)))
    }

    /// Begins to look through a frame, at `standing`, too, and what the map's `cloud` holds of it.
    pub(crate) fn look(
        &mut self,
        (sensor, stamp): (&SensorId, Timestamp),
        executor: Option<&Arc<dyn Executor>>,
        (standing, cloud): (Standing, CloudMap),
        news: impl FnOnce() -> News + Send + 'static,
    ) {
        self.newest.insert(sensor.clone(), stamp);
        self.looks
            .push_back(Look { stamp, task: Task::begin(executor, move || Found::of(&news(), &standing, &cloud)) });
    }

    /// Whether something was begun and not taken in.
    pub(crate) fn is_looking(&self) -> bool {
        !self.looks.is_empty()
    }

    /// Takes in what is due at a frame; all that was begun, if there is none. Whether anything could change, and what did.
    pub(crate) fn take_found(&mut self, frame: Option<Timestamp>, tracker: &mut Tracker) -> (bool, Vec<ObjectChange>) {
        let (mut was_asked, mut changes) = (false, vec![]);
        let is_due = |look: &mut Look| frame.is_none_or(|now| now >= look.stamp.plus_seconds(DELAY_S));
        while let Some(look) = self.looks.pop_front_if(is_due) {
            let Found { observations, t_map_base, beams, standing } = look.task.finished();
            for (id, looked) in standing {
                if self.is_gone(id, looked, look.stamp) {
                    changes.extend(tracker.take_away(id, look.stamp));
                    was_asked = true;
                }
            }
            if observations.is_empty() && !tracker.has_passing() {
                continue;
            }
            was_asked = true;
            let visibility = |b: &_| beams.visibility(&t_map_base, b);
            changes.extend(tracker.update_passing(look.stamp, &observations, &visibility));
        }
        (was_asked, changes)
    }

    /// Whether a thing is not where it stood any more, once a frame has looked at its place.
    fn is_gone(&mut self, id: ObjectId, looked: Visibility, stamp: Timestamp) -> bool {
        if looked != Visibility::SeenThrough {
            self.empty.remove(&id);
            return false;
        }
        // Who goes back in time begins anew.
        self.empty.retain(|_, (since, _)| (0.0..EMPTY_WITHIN_S).contains(&stamp.seconds_since(*since)));
        let (since, looks) = self.empty.entry(id).or_insert((stamp, 0));
        *looks += 1;
        let is_gone = *looks >= EMPTY_LOOKS && stamp.seconds_since(*since) >= EMPTY_S;
        if is_gone {
            self.empty.remove(&id);
        }
        is_gone
    }
}

impl Found {
    fn of(news: &News, standing: &Standing, cloud: &CloudMap) -> Self {
        let floor_z = news.t_map_base.translation.vector.z - news.scan.base_height_m;
        let viewer = news.t_map_base * Point3::from(news.scan.t_base_sensor.translation.vector);
        let things = find_passing(&news.points, &viewer, floor_z);
        let observations = things.iter().map(|thing| Observation {
            class: thing.class,
            confidence: thing.confidence,
            bbox: thing.bbox,
            num_points: thing.num_points,
            is_moving: false,
            is_seen: true,
        });
        let beams = Beams::new(&news.scan);
        let look = |bbox: &OrientedBox3| match beams.visibility(&news.t_map_base, bbox) {
            Visibility::SeenThrough if !beams.has_gone(&news.t_map_base, bbox, cloud) => Visibility::Occupied,
            looked => looked,
        };
        let looked = standing.iter().map(|(id, bbox)| (*id, look(bbox)));
        let standing = looked.filter(|(_, looked)| *looked != Visibility::Unseen).collect();
        Self { observations: observations.collect(), t_map_base: news.t_map_base, beams, standing }
    }
}
