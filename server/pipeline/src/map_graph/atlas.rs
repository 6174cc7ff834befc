//! Parts of the map that hang on nothing: the largest is the map, the others wait until the robot is recognised in one.
//!
//! A robot that is unanchored gathers a part of its own. One that grows far beyond the map becomes the map, as where a session
//! was lost early, and what was the map waits as a part; so does a part that a robot gathered before it was lost again. While the
//! robot drives on in the map it is looked for in the parts that wait, by its newest keyframes: each has a back end of its own,
//! which knows its places, and is small beside the map's. Where it is recognised, that part joins. Parts that wait are not stored.
//!
//! The name is that of Elvira et al., "ORBSLAM-Atlas: a robust and accurate multi-map system", 2019.

use super::MapGraph;
use super::part::{Part, Search};
use super::worker::{Answer, GraphWorker, Question, Relocated, Sighting};
use percept_geometry::{Covariance6, KeyframeId, Pose, SensorId, Timestamp, se3};
use percept_slam::{BackEndKeyframe, OdometryKind, Relocalisation};
use std::collections::VecDeque;

/// Parts that wait, at most; when there are more, the smallest is given up.
const MOST_PARTS: usize = 16;
/// Keyframes by which the robot is looked for: a planar lidar's place is told by some metres of them.
const NUM_SEEN: usize = 20;

/// A part that waits, and the back end that knows its places: keyframe 0 there is the part's first.
struct Waiting {
    part: Part,
    worker: GraphWorker,
}

/// The robot was recognised in a part that waits.
pub(super) struct Recognised {
    pub(super) part: Part,
    /// From a keyframe of the map to where that is in the part.
    pub(super) found: Relocalisation,
    /// There, base to the part.
    pub(super) t_part_found: Pose,
}

/// The parts that wait.
#[derive(Default)]
pub(super) struct Atlas {
    parts: Vec<Waiting>,
    /// The robot's newest keyframes, oldest first, as far as odometry leads from one to the next.
    seen: VecDeque<KeyframeId>,
    /// The part in which the robot is looked for, and whether it has to be asked again.
    turn: usize,
    search: Search,
    /// The robot's keyframe by which was asked.
    asked_by: Option<KeyframeId>,
    /// Where it was recognised, and by which keyframe, until a frame makes use of it.
    found: Option<(Relocated, KeyframeId)>,
}

impl Atlas {
    /// A part waits from now on, with what knows its places.
    fn wait(&mut self, part: Part, worker: GraphWorker) {
        self.parts.push(Waiting { part, worker });
        let num_keyframes = |k: &usize| self.parts[*k].part.keyframes.len();
        if self.parts.len() > MOST_PARTS
            && let Some(smallest) = (0..self.parts.len()).min_by_key(num_keyframes)
        {
            self.remove(smallest);
        }
    }

    fn remove(&mut self, k: usize) -> Part {
        if k == self.turn {
            (self.turn, self.search, self.found) = (0, Search::default(), None);
        } else if k < self.turn {
            self.turn -= 1;
        }
        self.parts.remove(k).part
    }

    /// Odometry leads from no earlier keyframe to those that come: the robot was lost, or the map is another one.
    pub(super) fn begin_anew(&mut self) {
        self.seen.clear();
        (self.asked_by, self.found, self.search.is_unfinished) = (None, None, false);
    }

    /// Takes the answer to where the robot is, if it is due.
    fn hear(&mut self, stamp: Timestamp) {
        let Some(waiting) = self.parts.get_mut(self.turn).filter(|_| self.search.is_asked) else { return };
        let Some(answers) = waiting.worker.answers_at(stamp) else { return };
        for answer in answers.answers {
            let Answer::Relocalised(relocated) = answer else { continue };
            // Nobody is there who asked, where the robot was lost since.
            let by = self.asked_by.take();
            (self.search.is_asked, self.search.is_unfinished) = (false, relocated.is_unfinished && by.is_some());
            if let Some(by) = by.filter(|_| relocated.found.is_some()) {
                self.found = Some((relocated, by));
            } else if !self.search.is_unfinished {
                self.turn = (self.turn + 1) % self.parts.len();
            }
        }
    }
}

impl MapGraph {
    /// A part waits from now on, if places can be recognised in it.
    pub(super) fn set_aside(&mut self, part: Part, kind: OdometryKind, pose_sensor: Option<&SensorId>) {
        self.atlas.begin_anew();
        let Some(last) = part.keyframes.last().map(|k| k.stamp) else { return };
        let Some(mut worker) = self.constraints.worker(&self.params, kind) else { return };
        let known = part.keyframes.iter().enumerate().map(|(i, k)| BackEndKeyframe {
            id: KeyframeId(i as u64),
            t_map_base: k.t_part_base,
            t_odom_base: k.t_part_base,
            covariance: Covariance6::zeros(),
            scan: (&k.scan).into(),
            recognise: pose_sensor.is_none_or(|s| *s == k.sensor),
            after_gap: false,
            constraint: None,
        });
        worker.ask(Question::Restore(known.collect()), last);
        self.atlas.wait(part, worker);
    }

    /// Looks for the robot, which is anchored in the map, in the parts that wait, by its newest keyframes.
    pub(crate) fn look_for_parts(&mut self, stamp: Timestamp, pose_sensor: &SensorId, keyframe: Option<KeyframeId>) {
        let atlas = &mut self.atlas;
        if let Some(keyframe) = keyframe {
            atlas.seen.push_back(keyframe);
            if atlas.seen.len() > NUM_SEEN {
                atlas.seen.pop_front();
            }
        }
        atlas.hear(stamp);
        let is_due = keyframe.is_some() || atlas.search.is_unfinished;
        if atlas.parts.is_empty() || atlas.search.is_asked || atlas.found.is_some() || !is_due {
            return;
        }
        let Some(sighting) = self.sighting(pose_sensor) else { return };
        let atlas = &mut self.atlas;
        if let Some(waiting) = atlas.parts.get_mut(atlas.turn) {
            waiting.worker.ask(Question::Relocalise(sighting), stamp);
            atlas.search.is_asked = true;
            atlas.asked_by = atlas.seen.back().copied();
        }
    }

    /// What the robot has seen by its newest keyframes.
    fn sighting(&self, pose_sensor: &SensorId) -> Option<Sighting> {
        let seen = self.atlas.seen.iter().filter_map(|id| {
            let info = self.keyframes.of(*id).filter(|k| k.merged.is_none() && k.sensor == *pose_sensor)?;
            Some((info.t_odom_base, self.map.scan(*id)?))
        });
        let mut seen: Vec<_> = seen.collect();
        let (t_odom_base, scan) = seen.pop()?;
        let before = seen.into_iter().map(|(t, scan)| (t_odom_base.inv_mul(&t), scan)).collect();
        let part = self.atlas.parts.get(self.atlas.turn)?.part.number;
        let covariance = Covariance6::zeros();
        Some(Sighting { before, scan: scan.as_ref().clone(), t_odom_base, covariance, part })
    }

    /// The part in which the robot was recognised, if it was; it waits no longer.
    pub(super) fn take_recognised(&mut self) -> Option<Recognised> {
        let (Relocated { found, part, .. }, by) = self.atlas.found.take()?;
        let found = found?;
        let k = self.atlas.parts.iter().position(|w| w.part.number == part)?;
        let in_part = self.atlas.parts[k].part.keyframes.get(usize::try_from(found.keyframe.0).ok()?)?;
        let t_part_found = in_part.t_part_base;
        // What it was recognised by may have gone since; then it is looked for again.
        self.keyframes.of(by).filter(|info| info.merged.is_none())?;
        let found = inverse(&found, by);
        Some(Recognised { part: self.atlas.remove(k), found, t_part_found })
    }
}

/// Where the keyframe that was found is, seen from the one by which it was.
fn inverse(found: &Relocalisation, by: KeyframeId) -> Relocalisation {
    // (T exp(x))^-1 = exp(-x) T^-1 = T^-1 exp(-Ad(T) x).
    let adjoint = se3::adjoint(&found.t_keyframe_base);
    Relocalisation {
        keyframe: by,
        t_keyframe_base: found.t_keyframe_base.inverse(),
        covariance: adjoint * found.covariance * adjoint.transpose(),
        inlier_ratio: found.inlier_ratio,
    }
}
