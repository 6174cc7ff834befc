//! A session as it was stored.

use crate::{Merged, TrajectoryEntry};
use percept_geometry::{KeyframeScan, Pose, SensorId, Timestamp};
use percept_scene::Object;
use percept_slam::Loop;
use std::collections::BTreeMap;
use std::sync::Arc;

/// A keyframe as it was stored.
#[derive(Debug, Clone)]
pub struct RestoredKeyframe {
    /// Base to map, corrected.
    pub t_map_base: Pose,
    /// Base to odom at the keyframe.
    pub t_odom_base: Pose,
    /// Whether nothing measured ties it to the keyframe before.
    pub after_gap: bool,
    /// What it saw, or what stands for it.
    pub content: RestoredContent,
}

/// What is left of a stored keyframe.
#[derive(Debug, Clone)]
pub enum RestoredContent {
    /// All.
    Scan(Arc<KeyframeScan>),
    /// Where it was, and when.
    Merged {
        /// Stamp, session's clock.
        stamp: Timestamp,
        /// Sensor.
        sensor: SensorId,
        /// What stands for it.
        merged: Merged,
    },
}

impl RestoredKeyframe {
    pub(crate) fn scan(&self) -> Option<&Arc<KeyframeScan>> {
        match &self.content {
            RestoredContent::Scan(scan) => Some(scan),
            RestoredContent::Merged { .. } => None,
        }
    }

    pub(crate) fn sensor(&self) -> &SensorId {
        match &self.content {
            RestoredContent::Scan(scan) => &scan.sensor,
            RestoredContent::Merged { sensor, .. } => sensor,
        }
    }
}

/// A session as it was stored.
#[derive(Debug, Clone, Default)]
pub struct Restored {
    /// Keyframes from number 0 on.
    pub keyframes: Vec<RestoredKeyframe>,
    /// Registered frames, oldest first.
    pub trajectory: Vec<TrajectoryEntry>,
    /// Loops, in the order of finding.
    pub loops: Vec<Loop>,
    /// Number that the next loop gets.
    pub next_loop_id: u64,
    /// Objects, those gone included.
    pub objects: Vec<Object>,
    /// Number that the next object gets.
    pub next_object_id: u64,
    /// Where a robot that has not come yet starts in a map that was given, base to map, if that was told.
    pub start: Option<Pose>,
    /// Newest accepted stamp of each sensor, its own clock.
    pub last_stamps: BTreeMap<SensorId, Timestamp>,
    /// No version of the map that somebody was told of is newer: all of the map is, from now on.
    pub map_version: u64,
}
