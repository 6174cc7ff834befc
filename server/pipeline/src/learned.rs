//! What a learned detector sees in the colour image of a keyframe: boxes in the image, lifted to boxes in space by its depth, beside
//! what is found in the map.

use percept_geometry::{ObjectClass, OrientedBox3, Pose};
use percept_perception::detection::{ImageDetector, ImageDetectors, LiftParams, Lifter};
use percept_scene::Observation;
use percept_scene::overlap::{iou, upright};
use percept_slam::{DepthScan, Scan};
use std::sync::Arc;

/// Overlap in space from which what the detector sees is what was found in the map. A monitor on a table is not the table.
const SAME: f64 = 0.3;

/// An image to be looked at.
pub(crate) struct LearnedLook {
    detector: Arc<dyn ImageDetector>,
    of: DepthScan,
}

impl LearnedLook {
    /// None if no detector of that name is there, or there is no image with depth.
    pub(crate) fn of(detectors: &ImageDetectors, name: &str, scan: &Scan) -> Option<Self> {
        match scan {
            Scan::Depth(of) if of.color.is_some() => Some(Self { detector: detectors.get(name)?, of: of.clone() }),
            _ => None,
        }
    }

    /// Names what was found, and adds what was not; by a robot at `t_map_base`.
    pub(crate) fn add_to(&self, observations: &mut Vec<Observation>, t_map_base: &Pose) {
        let Some(image) = &self.of.color else { return };
        let t_map_camera = t_map_base * self.of.t_base_sensor;
        // A detector that fails sees nothing; one whose answers are broken was refused when it was loaded.
        let Ok(found) = self.detector.detect(image) else { return };
        if found.is_empty() {
            return;
        }
        let Ok(lifter) = Lifter::new(&self.of.depth, &self.of.intrinsics, &t_map_camera, &LiftParams::default()) else {
            return;
        };
        let num_before = observations.len();
        let mut named = vec![false; num_before];
        for seen in &found {
            let (Ok(class), Ok(lifted)) = (ObjectClass::parse(&seen.label), lifter.lift(&seen.bbox)) else { continue };
            let bbox = upright(&lifted.bbox);
            let overlap = |i: &usize| iou(&observations[*i].bbox, &bbox);
            let best = (0..num_before).filter(|i| !named[*i]).max_by(|a, b| overlap(a).total_cmp(&overlap(b)));
            if let Some(i) = best.filter(|i| overlap(i) >= SAME) {
                named[i] = true;
                (observations[i].class, observations[i].confidence) = (class, seen.score);
            } else {
                observations.push(Self::alone(class, seen.score, bbox, lifted.num_points));
            }
        }
    }

    fn alone(class: ObjectClass, confidence: f64, bbox: OrientedBox3, num_points: usize) -> Observation {
        Observation { class, confidence, bbox, num_points, is_moving: false, is_seen: true }
    }
}
