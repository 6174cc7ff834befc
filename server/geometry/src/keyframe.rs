//! Keyframes by number, and the correction that moves them: the seam between SLAM and the maps.

use crate::{PointCloud, Pose, SensorId, Timestamp};
use nalgebra::Point3;
use serde::{Deserialize, Serialize};

/// Number of a keyframe in its session, counted from 0 in the order of creation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct KeyframeId(pub u64);

/// What a keyframe saw, as the map layers and a restarted odometry need it: points in base.
#[derive(Debug, Clone, PartialEq)]
pub struct KeyframeScan {
    /// When it was taken.
    pub stamp: Timestamp,
    /// By which sensor.
    pub sensor: SensorId,
    /// Where the beams start: the sensor in base.
    pub t_base_sensor: Pose,
    /// Height of base's origin above the floor, along gravity, metres: 0 for a base on the floor.
    pub base_height_m: f64,
    /// Ends of the beams that returned, in base, metres; colours where the sensor has them.
    pub hits: PointCloud,
    /// Points in base up to which beams without a return saw free space (at most the map's beam range).
    pub misses: Vec<Point3<f32>>,
    /// Whether the beams lie in one plane (a 2D lidar): the height band does not apply to them.
    pub planar: bool,
}

/// New poses for keyframes, found by the back end: `t_map_base` by number. Keyframes not named stay
/// where they are; whatever is anchored to a named one moves with it.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Correction {
    /// Keyframe and its corrected base-to-map pose, ascending by number, each at most once.
    pub t_map_base: Vec<(KeyframeId, Pose)>,
}
