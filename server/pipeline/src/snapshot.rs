//! The immutable picture of a session that every query is answered from.

use crate::{Chunks, PipelineParams};
use percept_geometry::{Covariance6, KeyframeId, Pose, SensorId, Timestamp};
use percept_mapping::MapLayers;
use percept_scene::{Object, SceneGraph};
use percept_slam::{Loop, TrackingState};
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
    /// Keyframe that it hangs on.
    pub anchor: KeyframeId,
    /// Base to the anchor's base.
    pub t_anchor_base: Pose,
    /// Whether this frame is that keyframe.
    pub is_keyframe: bool,
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
    pub keyframes: Arc<Vec<KeyframeInfo>>,
    /// Occupancy and cloud.
    pub layers: MapLayers,
    /// Seconds by which sensors' stamps are late behind the pose sensor's, beyond their declared `time_offset_s`: IMUs and
    /// wheels, once the robot has turned enough to tell.
    pub clock_offsets: Arc<BTreeMap<SensorId, f64>>,
    /// Loops in the order of finding, those not believed included.
    pub loops: Arc<Vec<Loop>>,
    /// Confirmed objects by id, those gone included.
    pub objects: Arc<Vec<Object>>,
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
            let anchor = self.keyframes.get(usize::try_from(entry.anchor.0).ok()?)?;
            Some((anchor.t_map_base * entry.t_anchor_base, entry))
        })
    }

    /// Robot, objects that are not gone, and their relations.
    pub fn scene_graph(&self) -> SceneGraph {
        let (stamp, t_map_base) =
            self.pose.as_ref().map_or((Timestamp::default(), Pose::identity()), |p| (p.stamp, p.t_map_base));
        SceneGraph::build(stamp, self.map_version, &t_map_base, &self.objects, &self.params.relations)
    }
}
