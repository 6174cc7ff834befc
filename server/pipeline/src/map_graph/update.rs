//! What leaves the map graph: keyframes as they are stored, and what changed in the map.

use crate::{KeyframeInfo, Merged, TrajectoryEntry};
use percept_geometry::{KeyframeId, KeyframeScan, Pose};
use percept_scene::ObjectChange;
use percept_slam::{Loop, LoopId};
use std::collections::BTreeMap;
use std::sync::Arc;

/// A keyframe as it is stored.
#[derive(Debug, Clone)]
pub struct NewKeyframe {
    /// Number, stamp, sensor, pose in the map.
    pub info: KeyframeInfo,
    /// Base to odom at the keyframe.
    pub t_odom_base: Pose,
    /// Whether nothing measured ties it to the keyframe before: the robot was lost in between.
    pub after_gap: bool,
    /// What it saw.
    pub scan: Arc<KeyframeScan>,
}

/// What changed in the map.
#[derive(Debug, Clone, Default)]
pub struct MapChange {
    /// Loops that were found or changed their state.
    pub loops: Vec<Loop>,
    /// Loops that went with keyframes that others stand for.
    pub dissolved: Vec<LoopId>,
    /// Keyframes that a correction moved, each once, with their new poses, base to map.
    pub corrected: BTreeMap<KeyframeId, Pose>,
    /// Keyframes that others stand for from now on, or through yet others than before.
    pub merged: Vec<(KeyframeInfo, Merged)>,
    /// What changed about objects, but for where they are by corrections.
    pub objects: Vec<ObjectChange>,
}

impl MapChange {
    /// Adds what changed after that.
    pub(crate) fn extend(&mut self, later: Self) {
        self.loops.extend(later.loops);
        self.dissolved.extend(later.dissolved);
        // Who moved twice is where it moved last.
        self.corrected.extend(later.corrected);
        self.merged.extend(later.merged);
        self.objects.extend(later.objects);
    }
}

/// What an operation on the map graph did.
#[derive(Debug, Default)]
pub(crate) struct MapUpdate {
    pub(crate) change: MapChange,
    /// By what keyframes were moved in the map, each time that they were: new from old.
    pub(crate) moved: Vec<BTreeMap<KeyframeId, Pose>>,
    /// Keyframes of a part that joined the map, or became it.
    pub(crate) joined: Vec<NewKeyframe>,
    /// Entries of the trajectory that are known better, ascending.
    pub(crate) mended: Vec<TrajectoryEntry>,
}
