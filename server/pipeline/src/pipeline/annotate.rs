//! What people say of objects.

use super::Pipeline;
use crate::scene::detector;
use crate::{MapChange, Preset, Snapshot};
use percept_geometry::ObjectClass;
use percept_perception::detection::{ClassExample, ImageDetectors};
use percept_scene::overlap::iou;
use percept_scene::{Correction, CorrectionError, ObjectId};
use std::sync::Arc;

/// Overlap from which what is found in the map is the object that a person speaks of: its box is a mean of many looks.
const SAME: f64 = 0.3;

impl Pipeline {
    /// Does as a person says of an object.
    ///
    /// # Errors
    /// [`CorrectionError`]; nothing was changed.
    pub fn annotate(&mut self, id: ObjectId, correction: Correction) -> Result<MapChange, CorrectionError> {
        let objects = self.scene.annotate(id, correction)?;
        Ok(MapChange { objects, ..MapChange::default() })
    }

    /// May use these learned detectors: `detection.learned` names one.
    pub fn set_image_detectors(&mut self, detectors: ImageDetectors) {
        self.scene.set_image_detectors(detectors);
    }

    /// Knows the classes of these examples beside the built-in ones, from the next search on.
    pub fn set_class_examples(&mut self, examples: Arc<Vec<ClassExample>>) {
        self.scene.set_examples(&self.params, examples);
    }
}

impl Snapshot {
    /// What an object looks like in the map as it is now, as an example of a class. None if it is not found there: it is gone, or was
    /// moved, or a detector of another kind has found it, as outdoors.
    pub fn class_example(&self, id: ObjectId, class: ObjectClass) -> Option<ClassExample> {
        if self.params.preset == Preset::Outdoor {
            return None;
        }
        let object = self.tracked.iter().find(|o| o.id == id)?;
        let around = self.layers.cloud.points_within(&object.bbox.center(), self.params.detection.range_m);
        let found = detector(&self.params, &[]).ok()?.detect(&around).ok()?;
        let overlap = |b| iou(b, &object.bbox);
        let best = found.iter().max_by(|a, b| overlap(&a.bbox).total_cmp(&overlap(&b.bbox)))?;
        (overlap(&best.bbox) >= SAME).then_some(ClassExample { class, descriptor: best.descriptor })
    }
}
