//! The immutable picture of a session that every query is answered from.

use crate::related::RelatedThings;
use crate::rooms::{Basis, DividedMap};
use crate::{Chunks, Live, MountOffset, PipelineParams, WheelsFault};
use percept_geometry::{Covariance6, KeyframeId, Pose, SensorId, Timestamp};
use percept_mapping::{MapLayers, MapMemory, MappingError, OccupancyMap};
use percept_scene::rooms::{RoomId, Rooms};
use percept_scene::{Directions, Object, Related, RelationFilter, SceneGraph, SceneView};
use percept_slam::{ImuFault, Loop, Scale, TrackingState, Waiting};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Where the robot is, how sure we are, or that we are lost.
#[derive(Debug, Clone, PartialEq)]
pub struct PoseEstimate {
    /// Stamp of the frame, session's clock.
    pub stamp: Timestamp,
    /// Whether it can be trusted.
    pub state: TrackingState,
    /// Base to map.
    pub t_map_base: Pose,
    /// Base to odom: continuous, never corrected.
    pub t_odom_base: Pose,
    /// Of a right perturbation in base.
    pub covariance: Covariance6,
    /// Share of the frame's points that fit the local model, 0 to 1.
    pub inlier_ratio: f64,
    /// Root mean square residual of those, metres.
    pub rmse_m: f64,
    /// Axes of base (x, y, z, rotation x, y, z) that the surroundings do not fix.
    pub degenerate_axes: [bool; 6],
    /// Whether lengths are metres, and what tells so. Without, no map is built, and pose and covariance are in a unit of
    /// their own.
    pub scale: Scale,
    /// What an odometry that needs several frames to begin is waiting for.
    pub waiting: Option<Waiting>,
    /// Whether the robot was lost and this frame found it again, or it is where somebody said.
    pub is_relocalised: bool,
    /// Whether the robot was found here and may be in another place that looks alike: nothing enters the map until that is certain.
    pub is_tentative: bool,
    /// The second sensor that measured this pose, because the pose sensor is silent or sees nothing.
    pub led_by: Option<SensorId>,
    /// Version of the map that `t_map_base` refers to.
    pub map_version: u64,
}

/// A keyframe without what it saw.
#[derive(Debug, Clone, PartialEq)]
pub struct KeyframeInfo {
    /// Number.
    pub id: KeyframeId,
    /// Stamp, session's clock.
    pub stamp: Timestamp,
    /// Sensor.
    pub sensor: SensorId,
    /// Base to map, corrected.
    pub t_map_base: Pose,
    /// Base to odom: continuous, never corrected.
    pub t_odom_base: Pose,
    /// Points kept.
    pub num_points: usize,
    /// Set once a newer keyframe stands for this one: what it saw is gone, and it moves with that one.
    pub merged: Option<Merged>,
}

/// Where a keyframe is that another one stands for.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Merged {
    /// The one that stands for it.
    pub into: KeyframeId,
    /// Base here, seen from base there.
    pub t_into_base: Pose,
}

/// One registered frame: anchored to a keyframe, so that it moves with it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct TrajectoryEntry {
    /// Stamp, session's clock.
    pub stamp: Timestamp,
    /// Whether the pose can be trusted.
    pub tracked: bool,
    /// Keyframe that it hangs on; none while the scale was unknown: the pose is in a unit of its own then.
    pub anchor: Option<KeyframeId>,
    /// Base to the anchor's base, or to map if there is no anchor.
    pub t_anchor_base: Pose,
    /// Whether this frame is that keyframe.
    pub is_keyframe: bool,
}

/// What a session takes in memory, by part, bytes, about.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct SessionMemory {
    /// What keyframes saw, submaps' layers, composed tiles.
    pub map: MapMemory,
    /// What places are known by.
    pub places: usize,
    /// Keyframes, what ties them, and trajectory.
    pub graph: usize,
    /// The local model that frames are placed in.
    pub odometry: usize,
    /// The newest frames, which are compared with the map.
    pub live: usize,
}

impl SessionMemory {
    /// All of it.
    pub fn total(&self) -> usize {
        self.map.total() + self.places + self.graph + self.odometry + self.live
    }
}

/// A session's state at one moment. Shares what did not change with the ones before.
#[derive(Debug, Clone)]
pub struct Snapshot {
    /// Grows with every change of the map.
    pub map_version: u64,
    /// Newest pose.
    pub pose: Option<PoseEstimate>,
    /// Every registered frame.
    pub trajectory: Chunks<TrajectoryEntry>,
    /// All keyframes by number, merged ones too: trajectories hang on them.
    pub keyframes: Chunks<KeyframeInfo>,
    /// Occupancy and cloud.
    pub layers: MapLayers,
    /// What the newest frames see.
    pub live: Live,
    /// What the session takes in memory.
    pub memory: SessionMemory,
    /// Seconds by which sensors' stamps are late behind the pose sensor's, beyond their declared `time_offset_s`: IMUs and
    /// wheels, once the robot has turned enough to tell.
    pub clock_offsets: Arc<BTreeMap<SensorId, f64>>,
    /// Sensors whose mount is not as declared, by how far.
    pub mount_offsets: Arc<BTreeMap<SensorId, MountOffset>>,
    /// IMUs with which something is wrong, and what.
    pub imu_faults: Arc<BTreeMap<SensorId, Vec<ImuFault>>>,
    /// Wheels that contradict the pose sensor, and how.
    pub wheels_faults: Arc<BTreeMap<SensorId, Vec<WheelsFault>>>,
    /// Loops in the order of finding, those not believed included.
    pub loops: Arc<Vec<Loop>>,
    /// Confirmed objects by id, those gone included, as they are told: parts within their wholes.
    pub objects: Arc<Vec<Object>>,
    /// The same as they are followed and stored: each by itself, also what people set aside.
    pub tracked: Arc<Vec<Object>>,
    /// The rooms, once somebody has asked for them.
    pub(crate) divided: DividedMap,
    pub(crate) related: RelatedThings,
    /// Number that the next object gets.
    pub next_object_id: u64,
    /// The parameters in force.
    pub params: Arc<PipelineParams>,
}

impl Snapshot {
    /// The keyframes that the map is made of.
    pub fn living_keyframes(&self) -> impl Iterator<Item = &KeyframeInfo> {
        self.keyframes.iter().filter(|k| k.merged.is_none())
    }

    /// The trajectory with all corrections so far: stamp, base to map, entry.
    pub fn trajectory(&self) -> impl Iterator<Item = (Pose, &TrajectoryEntry)> {
        self.trajectory.iter().filter_map(|entry| {
            let Some(anchor) = entry.anchor else { return Some((entry.t_anchor_base, entry)) };
            let anchor = self.keyframes.get(usize::try_from(anchor.0).ok()?)?;
            Some((anchor.t_map_base * entry.t_anchor_base, entry))
        })
    }

    /// The part of the trajectory whose poses are in one unit: metres, if there are any in metres.
    pub fn trajectory_in_one_unit(&self) -> impl Iterator<Item = (Pose, &TrajectoryEntry)> {
        let is_metric = self.is_metric();
        self.trajectory().filter(move |(_, e)| e.anchor.is_some() == is_metric)
    }

    /// Whether there are poses in metres, or none at all.
    pub fn is_metric(&self) -> bool {
        !self.keyframes.is_empty() || self.trajectory.is_empty()
    }

    /// The grid that a robot drives on: the map's, with what the newest frames see laid over it. Worked out once for each snapshot,
    /// on the current rayon pool.
    pub fn grid_now(&self) -> OccupancyMap {
        self.live.over(&self.layers.occupancy)
    }

    /// The rooms of the map's grid. Worked out once for each state of map and objects.
    ///
    /// # Errors
    /// `RegionTooLarge` for a grid of more than `max_cells` cells around what is known.
    pub fn rooms(&self, max_cells: usize) -> Result<Arc<Rooms>, MappingError> {
        let Self { map_version, objects, params, .. } = self;
        let basis = Basis { map_version: *map_version, occupancy: &self.layers.occupancy, objects, params };
        let keyframes = self.keyframes.iter().map(|k| (k.id, &k.t_map_base));
        self.divided.of(&basis, keyframes, max_cells)
    }

    /// Robot, objects that are not gone, rooms, and how all that relates; with directions for somebody, if they are asked for. `names` are
    /// what people call rooms. `at`: as it was then, with the robot there (base to map), in the rooms as they are now. `since`: what happened
    /// from then on, too. `filter`: which relations, and nodes of these.
    ///
    /// # Errors
    /// As [`Snapshot::rooms`].
    pub fn scene_graph(
        &self,
        names: &BTreeMap<RoomId, String>,
        whose: Option<Directions>,
        at: Option<(Timestamp, Pose)>,
        since: Option<Timestamp>,
        filter: &RelationFilter,
        max_cells: usize,
    ) -> Result<SceneGraph, MappingError> {
        let now = || self.pose.as_ref().map_or((Timestamp::default(), Pose::identity()), |p| (p.stamp, p.t_map_base));
        let (stamp, t_map_base) = at.unwrap_or_else(now);
        let past: Option<Vec<Object>> = at.map(|(at, _)| self.objects.iter().filter_map(|o| o.at(at)).collect());
        let (rooms, map_version, params) = (&self.rooms(max_cells)?, self.map_version, &self.params.relations);
        let related = &*match &past {
            Some(past) => Arc::new(Related::of(past, rooms, params)),
            None => self.related.of(&self.objects, rooms, params),
        };
        let objects = past.as_deref().unwrap_or(&self.objects);
        let view = SceneView { stamp, map_version, t_map_base: &t_map_base, objects, rooms, related, names, since };
        Ok(SceneGraph::build(&view, params, whose, filter))
    }
}
