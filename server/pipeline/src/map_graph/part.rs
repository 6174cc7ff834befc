//! A part of the map that hangs on nothing.

use percept_geometry::{Covariance6, KeyframeId, KeyframeScan, Pose, SensorId, Timestamp};
use std::sync::Arc;

/// A keyframe of a part.
#[derive(Debug, Clone)]
pub(super) struct PartKeyframe {
    /// Its number, if the part has been the map.
    pub(super) id: Option<KeyframeId>,
    pub(super) stamp: Timestamp,
    pub(super) sensor: SensorId,
    pub(super) t_part_base: Pose,
    /// Odometry's then; zero where nothing is known of it but where the keyframes of the map lie.
    pub(super) covariance: Covariance6,
    pub(super) scan: Arc<KeyframeScan>,
}

/// A part of the map that hangs on nothing.
#[derive(Debug, Default)]
pub(super) struct Part {
    /// Tells it from others.
    pub(super) number: u64,
    /// In the order of their stamps.
    pub(super) keyframes: Vec<PartKeyframe>,
    /// Base to the part at the frames that are known in it, in the order of their stamps.
    pub(super) frames: Vec<(Timestamp, Pose)>,
}

/// What was asked about where a part lies.
#[derive(Debug, Default)]
pub(super) struct Search {
    /// Whether the answer is still to come.
    pub(super) is_asked: bool,
    /// When it was asked last.
    pub(super) asked_at: Option<Timestamp>,
    /// Whether the answer was that the search goes on.
    pub(super) is_unfinished: bool,
}
