//! The map of one session: keyframes where they are believed to be, and the layers built from them.

use crate::error::check_keyframe;
use crate::{CloudParams, MapLayers, MappingError, OccupancyParams, Revision};
use percept_geometry::{Correction, KeyframeId, KeyframeScan, Pose};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Parameters of every layer.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MapParams {
    /// The 2D grid.
    pub occupancy: OccupancyParams,
    /// The fused cloud.
    pub cloud: CloudParams,
}

impl MapParams {
    /// Checks every field.
    ///
    /// # Errors
    /// `InvalidParam` naming field, value and remedy.
    pub fn validate(&self) -> Result<(), MappingError> {
        self.occupancy.validate()?;
        self.cloud.validate()
    }
}

/// A keyframe of the map.
#[derive(Debug, Clone, PartialEq)]
pub struct MapKeyframe {
    /// Where it is believed to have been.
    pub t_map_base: Pose,
    /// What it saw.
    pub scan: Arc<KeyframeScan>,
}

/// What a correction did.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct CorrectionReport {
    /// Keyframes that have another pose now.
    pub num_moved: usize,
    /// Keyframes named by the correction that this map does not hold.
    pub num_unknown: usize,
}

/// Keyframes with their poses, and the layers that follow from them.
///
/// The layers are always what integrating the keyframes in the order of their numbers gives, at the poses they have
/// now: a correction therefore leaves the same bytes as if the poses had been known from the start, and undoing it
/// restores the bytes from before. After a restart, the map is rebuilt by inserting its keyframes again.
/// Adding the newest keyframe costs one keyframe's work; a correction, or a keyframe out of order, costs all of them:
/// who cannot wait for that has the corrected map built beside this one, a little at a time ([`Map::begin_revision`]).
/// Cloning is cheap.
#[derive(Debug, Clone)]
pub struct Map {
    params: MapParams,
    keyframes: BTreeMap<KeyframeId, MapKeyframe>,
    layers: MapLayers,
}

impl Map {
    /// An empty map, version 0.
    ///
    /// # Errors
    /// `InvalidParam`.
    pub fn new(params: MapParams) -> Result<Self, MappingError> {
        Ok(Self { params, keyframes: BTreeMap::new(), layers: MapLayers::empty(&params)? })
    }

    /// Parameters.
    pub fn params(&self) -> &MapParams {
        &self.params
    }

    /// What its layers and the keyframes that they are made of take, bytes; what both share is counted once.
    pub fn memory_bytes(&self) -> usize {
        let scans: usize = self.keyframes.values().map(|k| size_of::<MapKeyframe>() + k.scan.memory_bytes()).sum();
        self.layers.occupancy.memory_bytes() + self.layers.cloud.memory_bytes() + scans
    }

    /// The keyframes by number.
    pub fn keyframes(&self) -> &BTreeMap<KeyframeId, MapKeyframe> {
        &self.keyframes
    }

    /// The layers as they are now: an immutable clone that shares their storage.
    pub fn layers(&self) -> MapLayers {
        self.layers.clone()
    }

    /// Adds a keyframe.
    ///
    /// # Errors
    /// `DuplicateKeyframe`, `PoseNotFinite`, `Scan`; the map is unchanged then.
    pub fn insert(&mut self, id: KeyframeId, t_map_base: Pose, scan: Arc<KeyframeScan>) -> Result<(), MappingError> {
        check_keyframe(&t_map_base, &scan)?;
        if self.keyframes.contains_key(&id) {
            return Err(MappingError::DuplicateKeyframe { id });
        }
        let newest = self.keyframes.last_key_value().is_none_or(|(last, _)| *last < id);
        let keyframe = MapKeyframe { t_map_base, scan };
        if newest {
            self.layers.add(&self.layers.prepare(&self.params, &keyframe));
            self.layers.version += 1;
            self.keyframes.insert(id, keyframe);
        } else {
            let mut revision = self.begin_revision(&Correction::default(), &[])?;
            revision.insert(id, t_map_base, keyframe.scan)?;
            self.adopt(revision);
        }
        Ok(())
    }

    /// Moves keyframes to their corrected poses, and the layers with them. Nothing changes, nor does the version,
    /// if no keyframe of this map gets another pose.
    ///
    /// # Errors
    /// `PoseNotFinite`; the map is unchanged then.
    pub fn apply(&mut self, correction: &Correction) -> Result<CorrectionReport, MappingError> {
        self.revise(correction, &[])
    }

    /// Moves keyframes and takes others out in one step: the layers are as if those had never been. Numbers that the map
    /// does not hold are left out.
    ///
    /// # Errors
    /// `PoseNotFinite`; the map is unchanged then.
    pub fn revise(&mut self, correction: &Correction, gone: &[KeyframeId]) -> Result<CorrectionReport, MappingError> {
        let revision = self.begin_revision(correction, gone)?;
        let report = *revision.report();
        if revision.changes_anything() {
            self.adopt(revision);
        }
        Ok(report)
    }

    /// The map as it will be with keyframes moved and others taken out, still to be built. Numbers that the map does not
    /// hold are left out.
    ///
    /// # Errors
    /// `PoseNotFinite`.
    pub fn begin_revision(&self, correction: &Correction, gone: &[KeyframeId]) -> Result<Revision, MappingError> {
        Revision::new(self.params, self.keyframes.clone(), correction, gone)
    }

    /// Becomes what a revision of this map has built; what is missing of it is built first. Keyframes that came since the
    /// revision began and were not given to it keep their poses.
    pub fn adopt(&mut self, mut revision: Revision) {
        revision.carry_over(&self.keyframes);
        let version = self.layers.version + 1;
        (self.keyframes, self.layers) = revision.finish();
        self.layers.version = version;
    }
}
