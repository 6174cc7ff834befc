//! The scene: objects that are looked for in the map around new keyframes, followed through time, and moved with the map.

use crate::visibility::RangeImage;
use crate::{Chunks, DetectionSettings, KeyframeInfo, NewKeyframe, ParamsError, PipelineParams};
use percept_geometry::{KeyframeId, Pose, Timestamp};
use percept_mapping::MapLayers;
use percept_perception::detection::Detector;
use percept_scene::{Object, ObjectChange, Observation, Tracker, Visibility};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Objects this near to the edge of the searched part of the map may be cut by it, metres.
const SEARCH_EDGE_M: f64 = 1.5;

/// Detector, tracker, objects.
pub(crate) struct Scene {
    settings: DetectionSettings,
    detector: Detector,
    tracker: Tracker,
    objects: Arc<Vec<Object>>,
}

impl Scene {
    /// Without objects.
    ///
    /// # Errors
    /// A parameter out of bounds.
    pub(crate) fn new(params: &PipelineParams) -> Result<Self, ParamsError> {
        Ok(Self {
            settings: params.detection.clone(),
            detector: detector(&params.detection)?,
            tracker: Tracker::new(params.tracker.clone()).map_err(|e| ParamsError::of("tracker", e))?,
            objects: Arc::default(),
        })
    }

    /// Looks for objects and follows them by other parameters from now on.
    ///
    /// # Errors
    /// A parameter out of bounds; nothing was changed.
    pub(crate) fn set_params(&mut self, params: &PipelineParams) -> Result<(), ParamsError> {
        let detector = detector(&params.detection)?;
        self.tracker.set_params(params.tracker.clone()).map_err(|e| ParamsError::of("tracker", e))?;
        (self.settings, self.detector) = (params.detection.clone(), detector);
        Ok(())
    }

    /// Confirmed objects by id, those gone included.
    pub(crate) fn objects(&self) -> Arc<Vec<Object>> {
        Arc::clone(&self.objects)
    }

    /// Number that the next object gets.
    pub(crate) fn next_object_id(&self) -> u64 {
        self.tracker.next_id()
    }

    /// Brings back objects that were stored.
    pub(crate) fn restore(&mut self, params: &PipelineParams, objects: &[Object], next_object_id: u64) {
        if let Ok(tracker) = Tracker::restore(params.tracker.clone(), objects, next_object_id) {
            self.tracker = tracker;
        }
        self.objects = Arc::new(self.tracker.objects());
    }

    /// Looks for objects in the map around a new keyframe. `is_sparse`: its sensor sees too little for that, a camera alone.
    pub(crate) fn observe(&mut self, layers: &MapLayers, keyframe: &NewKeyframe, is_sparse: bool) -> Vec<ObjectChange> {
        if !self.settings.enabled || keyframe.scan.planar || is_sparse {
            return vec![];
        }
        let center = nalgebra::Point3::from(keyframe.info.t_map_base.translation.vector);
        let cloud = layers.cloud.points_within(&center, self.settings.range_m);
        // The fused cloud is sound by construction; a detector that refuses it finds nothing.
        let found = self.detector.detect(&cloud).unwrap_or_default();
        let observations: Vec<Observation> = found
            .iter()
            .map(|d| Observation { class: d.class, confidence: d.confidence, bbox: d.bbox, num_points: d.num_points })
            .collect();
        let range_image = RangeImage::new(&keyframe.info.t_map_base, &keyframe.scan);
        let stamp = keyframe.info.stamp;
        // The detector sees all of the map around the robot: what it does not find there is no thing of its own.
        let searched_m = self.settings.range_m - SEARCH_EDGE_M;
        let changes = self.tracker.update(stamp, &observations, &|b| match range_image.visibility(b) {
            Visibility::SeenThrough => Visibility::SeenThrough,
            _ if (b.center() - center).norm() < searched_m => Visibility::Refuted,
            unsure => unsure,
        });
        self.objects = Arc::new(self.tracker.objects());
        changes
    }

    /// Keyframes moved, by `t_new_old` in the map: each object follows the one nearest in time to when it was last seen.
    pub(crate) fn follow(&mut self, keyframes: &Chunks<KeyframeInfo>, t_new_old: &BTreeMap<KeyframeId, Pose>) {
        let nearest = |stamp: Timestamp| {
            let after = keyframes.partition_point(|k| k.stamp < stamp);
            let around = [after.checked_sub(1), Some(after)].into_iter().flatten().filter_map(|i| keyframes.get(i));
            around.min_by_key(|k| k.stamp.nanos().abs_diff(stamp.nanos())).map(|k| k.id)
        };
        let moved_by = |last_seen| nearest(last_seen).and_then(|id| t_new_old.get(&id).copied());
        self.tracker.correct(&|_, last_seen| moved_by(last_seen).unwrap_or_else(Pose::identity));
        self.objects = Arc::new(self.tracker.objects());
    }
}

fn detector(settings: &DetectionSettings) -> Result<Detector, ParamsError> {
    Detector::new(settings.detector).map_err(|e| ParamsError::of("detection.detector", e))
}
