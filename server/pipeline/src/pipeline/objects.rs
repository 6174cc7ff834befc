//! Objects are looked for around new keyframes, and move with those that saw them.

use super::{NewKeyframe, Pipeline};
use crate::visibility::RangeImage;
use percept_geometry::{KeyframeId, Pose, SensorKind, Timestamp};
use percept_scene::{ObjectChange, Observation, Visibility};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Objects this near to the edge of the searched part of the map may be cut by it, metres.
const SEARCH_EDGE_M: f64 = 1.5;

impl Pipeline {
    /// Looks for objects in the map around a new keyframe.
    pub(super) fn observe(&mut self, keyframe: &NewKeyframe) -> Vec<ObjectChange> {
        let is_sparse = self.sensors.spec(&keyframe.info.sensor).is_some_and(|s| s.kind == SensorKind::Camera);
        if !self.params.detection.enabled || keyframe.scan.planar || is_sparse {
            return vec![];
        }
        let layers = self.map.layers();
        let center = nalgebra::Point3::from(keyframe.info.t_map_base.translation.vector);
        let cloud = layers.cloud.points_within(&center, self.params.detection.range_m);
        // The fused cloud is sound by construction; a detector that refuses it finds nothing.
        let found = self.detector.detect(&cloud).unwrap_or_default();
        let observations: Vec<Observation> = found
            .iter()
            .map(|d| Observation { class: d.class, confidence: d.confidence, bbox: d.bbox, num_points: d.num_points })
            .collect();
        let range_image = RangeImage::new(&keyframe.info.t_map_base, &keyframe.scan);
        let stamp = keyframe.info.stamp;
        // The detector sees all of the map around the robot: what it does not find there is no thing of its own.
        let searched_m = self.params.detection.range_m - SEARCH_EDGE_M;
        let changes = self.tracker.update(stamp, &observations, &|b| match range_image.visibility(b) {
            Visibility::SeenThrough => Visibility::SeenThrough,
            _ if (b.center() - center).norm() < searched_m => Visibility::Refuted,
            unsure => unsure,
        });
        self.objects = Arc::new(self.tracker.objects());
        changes
    }

    /// Objects follow the keyframe nearest in time to when they were last seen.
    pub(super) fn move_objects(&mut self, moved: &BTreeMap<KeyframeId, Pose>) {
        let keyframes = Arc::clone(&self.keyframes);
        let nearest = |stamp: Timestamp| {
            let after = keyframes.partition_point(|k| k.stamp < stamp);
            let around = [after.checked_sub(1), Some(after)].into_iter().flatten().filter_map(|i| keyframes.get(i));
            around.min_by_key(|k| k.stamp.nanos().abs_diff(stamp.nanos())).map(|k| k.id)
        };
        let t_new_old = |last_seen| nearest(last_seen).and_then(|id| moved.get(&id).copied());
        self.tracker.correct(&|_, last_seen| t_new_old(last_seen).unwrap_or_else(Pose::identity));
        self.objects = Arc::new(self.tracker.objects());
    }
}
