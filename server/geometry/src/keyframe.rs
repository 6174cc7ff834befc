//! Keyframes by number, and the correction that moves them: the seam between SLAM and the maps.

use crate::{CameraIntrinsics, PointCloud, Pose, SensorId, Timestamp};
use nalgebra::{Point2, Point3};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

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
    /// What a colour camera saw that can be told apart; none for other sensors. Shared, not copied.
    pub features: Option<Arc<KeyframeFeatures>>,
}

impl KeyframeScan {
    /// What it takes, bytes.
    pub fn memory_bytes(&self) -> usize {
        let features = self.features.as_ref().map_or(0, |f| f.features.len() * size_of::<KeyframeFeature>());
        size_of::<Self>() + self.hits.memory_bytes() + self.misses.len() * size_of::<Point3<f32>>() + features
    }
}

/// How the distinct places of an image are found, and so what the bits of their descriptors mean.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FeatureMethod {
    /// Corners, and 256 comparisons of brightness around each.
    #[default]
    Orb,
    /// Blobs of any size, and two bits for each of the 128 numbers that describe one: steadier, and eight times slower.
    Sift,
}

/// Distinct places of a keyframe's image, for finding the place again.
#[derive(Debug, Clone, PartialEq)]
pub struct KeyframeFeatures {
    /// How they were found: those of different methods have nothing to do with each other.
    pub method: FeatureMethod,
    /// Of the image that `KeyframeScan::hits` were measured in; its lens undone, so without distortion.
    pub camera: CameraIntrinsics,
    /// The most distinct first (of ORB's: of each size); at most [`KeyframeFeatures::LIMIT`].
    pub features: Vec<KeyframeFeature>,
}

impl KeyframeFeatures {
    /// Most features of a keyframe.
    pub const LIMIT: usize = 500;
}

/// A distinct place of an image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KeyframeFeature {
    /// 256 bits, as [`KeyframeFeatures::method`] says; compared by the number of bits that differ.
    pub descriptor: [u64; 4],
    /// In base, metres; NaN where there is no depth.
    pub p_base: Point3<f32>,
    /// Column and row in the colour image, pixels.
    pub pixel: Point2<f32>,
}

/// New poses for keyframes, found by the back end: `t_map_base` by number. Keyframes not named stay
/// where they are; whatever is anchored to a named one moves with it.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Correction {
    /// Keyframe and its corrected base-to-map pose, ascending by number, each at most once.
    pub t_map_base: Vec<(KeyframeId, Pose)>,
}

impl Correction {
    /// Both in one: where both move a keyframe, this one does.
    pub fn after(self, earlier: Option<Self>) -> Self {
        let mut poses: std::collections::BTreeMap<_, _> = earlier.into_iter().flat_map(|c| c.t_map_base).collect();
        poses.extend(self.t_map_base);
        Self { t_map_base: poses.into_iter().collect() }
    }
}
