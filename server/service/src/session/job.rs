//! What is to be stored of a frame.

use super::meta::SessionMeta;
use super::records::FrameCounts;
use crate::observe;
use percept_geometry::{KeyframeId, Pose, SensorId, Timestamp};
use percept_pipeline::{KeyframeInfo, Loop, LoopId, Merged, NewKeyframe, TrajectoryEntry};
use percept_scene::Object;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Instant;

/// What one frame, or a change of the map without one, left behind.
#[derive(Default)]
pub(crate) struct Job {
    /// When the frame came.
    pub(crate) received: Option<Instant>,
    /// The map's version that callers are told of by now.
    pub(crate) map_version: u64,
    /// What was counted of sensors, as far as it is another by now.
    pub(crate) frame_counts: BTreeMap<SensorId, FrameCounts>,
    /// Whose frame it was, and when.
    pub(crate) frame: Option<(SensorId, Timestamp)>,
    pub(crate) entry: Option<TrajectoryEntry>,
    /// Entries of earlier frames that are now known better.
    pub(crate) mended: Vec<TrajectoryEntry>,
    /// New keyframes, by number.
    pub(crate) keyframes: Vec<NewKeyframe>,
    /// Loops that were found or changed their state.
    pub(crate) loops: Vec<Loop>,
    /// All objects and the number that the next one gets, if any changed.
    pub(crate) objects: Option<(Arc<Vec<Object>>, u64)>,
    /// Keyframes that a correction moved.
    pub(crate) corrected: BTreeMap<KeyframeId, Pose>,
    /// Keyframes that others stand for from now on.
    pub(crate) merged: Vec<(KeyframeInfo, Merged)>,
    /// Loops that went with them.
    pub(crate) dissolved: Vec<LoopId>,
    /// Where the robot starts in a map that was given with this, base to map, if that was told.
    pub(crate) start: Option<Pose>,
    /// What is declared and set, if that changed.
    pub(crate) meta: Option<Box<SessionMeta>>,
    /// Counted while it waits; set when it is queued.
    pub(crate) backlog: Option<observe::Held>,
}
