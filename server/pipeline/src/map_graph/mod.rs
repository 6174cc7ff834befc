//! The only owner of poses in the map: keyframes, submaps, trajectory, and where odom lies in it.
//!
//! In come keyframes with their poses in odom; what comes out is stored ([`NewKeyframe`], [`MapChange`]) and moves what hangs on
//! keyframes ([`MapUpdate`]). Constraints, place index, optimisation and culling are the back end's, which works beside the
//! frames ([`worker`]) and decides what [`revising`] carries out. Start with [`MapGraph::add`] and [`MapGraph::take_answers`].

mod add;
mod answers;
mod atlas;
mod constraints;
mod given;
mod joining;
mod keyframes;
mod level;
mod part;
mod probation;
mod relocaliser;
mod restore;
mod revising;
mod trajectory;
mod update;
mod worker;

pub(crate) use probation::{Doubt, Probed};
pub(crate) use relocaliser::UnanchoredView;
pub(crate) use restore::End;
#[cfg(test)]
pub(crate) use revising::Decision;
pub(crate) use update::MapUpdate;
pub use update::{MapChange, NewKeyframe};

use crate::beside::Task;
use crate::{Executor, KeyframeInfo, ParamsError, PipelineParams, SessionMemory, SlamParams, TrajectoryEntry};
use atlas::Atlas;
use constraints::Constraints;
use keyframes::Keyframes;
use percept_geometry::{KeyframeId, KeyframeScan, Pose, SensorId, Timestamp};
use percept_mapping::{Map, MapKeyframe, MapStore, RebuildStepDone};
use percept_slam::{Loop, OdometryKind};
use relocaliser::Relocaliser;
use std::sync::Arc;
use trajectory::Trajectory;

/// A keyframe this near says that the robot has been there, metres.
const MAPPED_M: f64 = 1.0;

/// Keyframes that odometry starts again from.
const NUM_RECENT: usize = 20;

/// Keyframes, submaps and trajectory of one robot, and the constraints between them.
pub(crate) struct MapGraph {
    params: SlamParams,
    /// Submaps and layers.
    map: Map,
    keyframes: Keyframes,
    trajectory: Trajectory,
    /// Odom to map: found level at the first keyframe, moved by corrections.
    t_map_odom: Pose,
    /// Height of base above the floor, found with the level.
    base_height_m: f64,
    constraints: Constraints,
    relocaliser: Relocaliser,
    /// Parts of the map that hang on nothing and wait to be recognised in it.
    atlas: Atlas,
    /// By what a submap is being built on.
    step: Option<Task<RebuildStepDone>>,
    executor: Option<Arc<dyn Executor>>,
}

impl MapGraph {
    /// An empty map.
    ///
    /// # Errors
    /// A parameter out of bounds.
    pub(crate) fn new(params: &PipelineParams) -> Result<Self, ParamsError> {
        Ok(Self {
            params: params.slam.clone(),
            map: Map::new(params.map).map_err(|e| ParamsError::of("map", e))?,
            keyframes: Keyframes::default(),
            trajectory: Trajectory::default(),
            t_map_odom: Pose::identity(),
            base_height_m: 0.0,
            constraints: Constraints::default(),
            relocaliser: Relocaliser::default(),
            atlas: Atlas::default(),
            step: None,
            executor: None,
        })
    }

    /// Gathers keyframes of unanchored robots by other parameters from now on; others hold for a session's life.
    pub(crate) fn set_params(&mut self, params: SlamParams) {
        self.params = params;
    }

    /// Works beside frames, on threads of the executor's.
    pub(crate) fn set_executor(&mut self, executor: Arc<dyn Executor>) {
        self.constraints.set_executor(Arc::clone(&executor));
        self.executor = Some(executor);
    }

    /// Who works beside frames.
    pub(crate) fn executor(&self) -> Option<&Arc<dyn Executor>> {
        self.executor.as_ref()
    }

    /// Height of base above the floor, metres.
    pub(crate) fn base_height_m(&self) -> f64 {
        self.base_height_m
    }

    /// Makes the back end for the kind of sensor that moves the pose, if loops are wanted and can be found.
    pub(crate) fn prepare(&mut self, kind: OdometryKind) {
        self.constraints.prepare(&self.params, kind);
    }

    /// Submaps and layers.
    pub(crate) fn map(&self) -> &Map {
        &self.map
    }

    /// Sets where submaps go that are not in memory.
    pub(crate) fn set_store(&mut self, store: Arc<dyn MapStore>) {
        self.map.set_store(store);
    }

    /// What all of it takes in memory; the bytes of odometry and of the newest frames are kept beside it, and count towards the budget.
    pub(crate) fn take_memory(&mut self, odometry: usize, live: usize) -> SessionMemory {
        let back_end = self.constraints.memory();
        let trajectory = self.trajectory.len() * size_of::<TrajectoryEntry>();
        let keyframes = self.keyframes.len() * size_of::<KeyframeInfo>();
        let (places, graph) = (back_end.places, back_end.graph + trajectory + keyframes);
        self.map.set_beside(places + graph + odometry + live);
        SessionMemory { map: self.map.memory(), places, graph, odometry, live }
    }

    /// All keyframes by number.
    pub(crate) fn keyframes(&self) -> &Keyframes {
        &self.keyframes
    }

    /// Every registered frame.
    pub(crate) fn trajectory(&self) -> &Trajectory {
        &self.trajectory
    }

    /// Loops in the order of finding, those not believed included.
    pub(crate) fn loops(&self) -> Arc<Vec<Loop>> {
        self.constraints.loops()
    }

    /// Odom to map.
    pub(crate) fn t_map_odom(&self) -> Pose {
        self.t_map_odom
    }

    /// Whether a sensor has been where odometry is now: a keyframe of its is near.
    pub(crate) fn is_mapped(&self, sensor: &SensorId, t_odom_base: &Pose) -> bool {
        let here = (self.t_map_odom * t_odom_base).translation.vector;
        let near = |k: &KeyframeInfo| {
            k.merged.is_none() && k.sensor == *sensor && (k.t_map_base.translation.vector - here).norm() < MAPPED_M
        };
        self.keyframes.iter().any(near)
    }

    /// Keyframes of a sensor around a place, with their odom poses, oldest first.
    pub(crate) fn keyframes_near(&self, sensor: &SensorId, t_odom_base: &Pose) -> Vec<(Pose, Arc<KeyframeScan>)> {
        let here = (self.t_map_odom * t_odom_base).translation.vector;
        let of_sensor = self.map.keyframes().iter().filter(|(_, k)| k.sensor == *sensor);
        let mut by_distance: Vec<_> =
            of_sensor.map(|(id, k)| ((k.t_map_base.translation.vector - here).norm(), *id, k)).collect();
        by_distance.sort_by(|a, b| a.0.total_cmp(&b.0).then(b.1.cmp(&a.1)));
        by_distance.truncate(NUM_RECENT);
        by_distance.sort_by_key(|(_, id, _)| *id);
        by_distance.into_iter().filter_map(|(_, id, k)| self.seen_from_odom(id, k)).collect()
    }

    /// The newest keyframes of a sensor with their odom poses, oldest first: what odometry starts again from.
    pub(crate) fn recent_keyframes(&self, sensor: &SensorId) -> Vec<(Pose, Arc<KeyframeScan>)> {
        let of_sensor = self.map.keyframes().iter().filter(|(_, k)| k.sensor == *sensor);
        let newest = of_sensor.rev().take(NUM_RECENT).filter_map(|(id, k)| self.seen_from_odom(*id, k));
        let mut recent: Vec<_> = newest.collect();
        recent.reverse();
        recent
    }

    fn seen_from_odom(&self, id: KeyframeId, keyframe: &MapKeyframe) -> Option<(Pose, Arc<KeyframeScan>)> {
        Some((self.t_map_odom.inverse() * keyframe.t_map_base, self.map.scan(id)?))
    }

    /// Adds a frame to the trajectory: on its keyframe, if it is one, else on the newest of the sensor that moves the pose; in a map that
    /// was given and to which that adds nothing, on the one that it was found by. One that is
    /// older than the newest entry is left out, as a pose sensor's is that comes late while a second sensor leads.
    pub(crate) fn extend_trajectory(
        &mut self,
        sensor: &SensorId,
        frame: (Timestamp, &Pose, bool),
        keyframe: Option<&NewKeyframe>,
    ) -> Option<TrajectoryEntry> {
        if self.trajectory.newest().is_some_and(|newest| newest >= frame.0) {
            return None;
        }
        let anchor = match keyframe {
            Some(k) => &k.info,
            None => {
                let own = self.keyframes.iter().rev().find(|k| k.sensor == *sensor);
                own.or_else(|| self.keyframes.of(self.relocaliser.found_by()?))?
            }
        };
        Some(self.trajectory.push(frame, anchor, keyframe.is_some()))
    }

    /// Adds a frame whose pose is in a unit of its own.
    pub(crate) fn extend_without_scale(&mut self, frame: (Timestamp, &Pose, bool)) -> Option<TrajectoryEntry> {
        self.trajectory.push_without_scale(frame)
    }

    /// Frames in a unit of their own move with the camera's own map.
    pub(crate) fn move_without_scale(&mut self, moved: &[(Timestamp, Pose)]) {
        self.trajectory.move_without_scale(moved, &self.t_map_odom);
    }
}
