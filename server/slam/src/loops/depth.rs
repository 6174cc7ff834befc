//! Places of a depth camera: by their looks where it has colour ([`super::visual`]), by their shape where it has none
//! ([`super::spatial`]).
//!
//! One view without colour says little: blank corners of rooms fit each other. So a lost robot is looked for by what it has
//! seen on some metres of its way, as with a lidar that sees ahead only; and loops are left to colour: one such view in the
//! map of another visit is now and then off by a decimetre.

use super::spatial::Seen;
use super::visual::VisualPlaces;
use super::{Evidence, KeyframePoses, LoopClosure, PlaceRecognition, Relocalisation};
use percept_geometry::{Covariance6, KeptScan, KeyframeId, KeyframeScan, Pose};
use std::sync::Arc;

/// Place recognition of a depth camera. Keyframes with colour and without are not compared with each other.
pub(super) struct DepthPlaces {
    by_looks: VisualPlaces,
    by_shape: Seen,
}

impl DepthPlaces {
    /// Nothing seen yet. Of keyframes with colour at most so many are known.
    pub(super) fn new(max_keyframes: usize) -> Self {
        Self { by_looks: VisualPlaces::new(max_keyframes), by_shape: Seen::default() }
    }
}

impl PlaceRecognition for DepthPlaces {
    fn insert(
        &mut self,
        id: KeyframeId,
        scan: &KeptScan,
        drift: &Covariance6,
        poses: &KeyframePoses,
    ) -> Vec<LoopClosure> {
        if has_features(scan) {
            return self.by_looks.insert(id, scan, drift, poses);
        }
        self.by_shape.keep(id, scan, poses);
        vec![]
    }

    fn restore(
        &mut self,
        id: KeyframeId,
        scan: &KeptScan,
        drift: &Covariance6,
        poses: &KeyframePoses,
        ties: &[KeyframeId],
    ) {
        if has_features(scan) {
            self.by_looks.restore(id, scan, drift, poses, ties);
        } else {
            self.by_shape.keep(id, scan, poses);
        }
    }

    /// One view is enough only by its looks.
    fn relocalise(&self, scan: &KeyframeScan, poses: &KeyframePoses) -> Option<Relocalisation> {
        scan.features.as_ref()?;
        self.by_looks.relocalise(scan, poses)
    }

    fn relocalise_driven(
        &mut self,
        before: &[(Pose, Arc<KeyframeScan>)],
        scan: &KeyframeScan,
        poses: &KeyframePoses,
    ) -> Option<Relocalisation> {
        match scan.features {
            Some(_) => self.by_looks.relocalise_driven(before, scan, poses),
            None => self.by_shape.relocalise_driven(before, scan, poses),
        }
    }

    fn check(&mut self, scan: &KeyframeScan, t_map_base: &Pose, poses: &KeyframePoses) -> Evidence {
        match scan.features {
            Some(_) => self.by_looks.check(scan, t_map_base, poses),
            None => self.by_shape.check(scan, t_map_base, poses),
        }
    }

    fn forget(&mut self, id: KeyframeId) {
        self.by_looks.forget(id);
        self.by_shape.forget(id);
    }

    fn memory_bytes(&self) -> usize {
        self.by_looks.memory_bytes() + self.by_shape.memory_bytes()
    }
}

fn has_features(scan: &KeptScan) -> bool {
    scan.get().is_some_and(|s| s.features.is_some())
}
