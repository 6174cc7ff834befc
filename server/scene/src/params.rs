//! How objects are followed.

use crate::{SceneError, within};
use serde::{Deserialize, Serialize};

/// How objects are followed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrackerParams {
    /// Overlap (intersection over union, 0..1) from which a detection may belong to an object of any class.
    pub min_iou: f64,
    /// Distance of centres up to which boxes that do not overlap may be one object, metres, positive.
    pub association_distance_m: f64,
    /// Largest ratio of sizes of boxes that do not overlap and are one object; at least 1.
    pub max_size_ratio: f64,
    /// Observations after which a thing is listed, of those in which beams end at it; at least 1. More suppress chance detections, and
    /// delay.
    pub confirm_observations: u64,
    /// A thing not yet listed is dropped when not seen for this long, seconds.
    pub tentative_timeout_s: f64,
    /// Updates in a row that see through an object's place before it is gone; at least 1.
    pub gone_observations: u32,
    /// Time since an object was last detected before it can be gone, seconds: detectors miss a frame or two.
    pub gone_after_s: f64,
    /// Distance from its place at which an object that also left its old box is moving, metres, positive.
    pub moving_distance_m: f64,
    /// A moving object that stays within that distance for this long has stopped, seconds.
    pub settle_s: f64,
    /// A moving object out of sight is expected to go on for this long, seconds; it is gone `gone_after_s` later.
    pub coast_s: f64,
    /// Overlap from which two resting objects, not both detected in this update, are one and the same; 0..1.
    pub merge_iou: f64,
    /// Updates in a row in which an object is only seen as a part of a larger one before it becomes that; at least 1.
    pub swallow_observations: u32,
    /// Number of observations that count together for the class; at least 1. More is slower and surer.
    pub class_memory: f64,
    /// Limit of things followed. At the limit the gone are forgotten first; then nothing new is taken up.
    pub max_objects: usize,
}

impl Default for TrackerParams {
    fn default() -> Self {
        Self {
            min_iou: 0.1,
            association_distance_m: 0.5,
            max_size_ratio: 2.5,
            confirm_observations: 2,
            tentative_timeout_s: 5.0,
            gone_observations: 3,
            gone_after_s: 1.0,
            moving_distance_m: 0.3,
            settle_s: 2.0,
            coast_s: 1.0,
            merge_iou: 0.4,
            swallow_observations: 5,
            class_memory: 3.0,
            max_objects: 10_000,
        }
    }
}

impl TrackerParams {
    /// Checks the bounds.
    ///
    /// # Errors
    /// `InvalidParam` naming field, value and what it has to be.
    pub fn validate(&self) -> Result<(), SceneError> {
        let (tiny, huge) = (1e-6, 1e6);
        let (share, positive) = ("above 0 and at most 1", "positive and at most 1e6");
        let (counted, waited) = ("at least 1", "from 0 to 1e6");
        within("min_iou", self.min_iou, tiny, 1.0, share)?;
        within("association_distance_m", self.association_distance_m, tiny, huge, positive)?;
        within("max_size_ratio", self.max_size_ratio, 1.0, huge, counted)?;
        within("confirm_observations", self.confirm_observations as f64, 1.0, huge, counted)?;
        within("tentative_timeout_s", self.tentative_timeout_s, 0.0, huge, waited)?;
        within("gone_observations", f64::from(self.gone_observations), 1.0, huge, counted)?;
        within("gone_after_s", self.gone_after_s, 0.0, huge, waited)?;
        within("moving_distance_m", self.moving_distance_m, tiny, huge, positive)?;
        within("settle_s", self.settle_s, 0.0, huge, waited)?;
        within("coast_s", self.coast_s, 0.0, huge, waited)?;
        within("merge_iou", self.merge_iou, tiny, 1.0, share)?;
        within("swallow_observations", f64::from(self.swallow_observations), 1.0, huge, counted)?;
        within("class_memory", self.class_memory, 1.0, huge, counted)?;
        within("max_objects", self.max_objects as f64, 1.0, huge, counted)
    }
}
