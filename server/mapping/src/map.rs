//! The map of one session: keyframes where they are believed to be, and the layers built from them.

use crate::error::{check_keyframe, check_pose};
use crate::occupancy::ScanUpdate;
use crate::{CloudParams, FusedCloud, MappingError, OccupancyGrid, OccupancyParams, cloud::CloudUpdate};
use percept_geometry::{Correction, KeyframeId, KeyframeScan, Pose};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Keyframes prepared at once when the layers are rebuilt: bounds the memory that takes.
const REBUILD_CHUNK: usize = 8;

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

/// An immutable picture of the layers; cloning costs two references.
#[derive(Debug, Clone, PartialEq)]
pub struct MapLayers {
    /// Rises with every change of the map; never falls, not even when a correction is undone.
    pub version: u64,
    /// Free, occupied, unknown.
    pub occupancy: OccupancyGrid,
    /// Coloured points.
    pub cloud: FusedCloud,
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
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
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
/// Adding the newest keyframe costs one keyframe's work; a correction, or a keyframe out of order, costs all of them
/// (prepared in parallel). Cloning is cheap: to correct a large map without holding up ingest, correct a clone.
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
        let layers = empty_layers(&params, 0)?;
        Ok(Self { params, keyframes: BTreeMap::new(), layers })
    }

    /// Parameters.
    pub fn params(&self) -> &MapParams {
        &self.params
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
            let update = self.prepare(&keyframe);
            self.add(&update);
            self.layers.version += 1;
            self.keyframes.insert(id, keyframe);
        } else {
            self.keyframes.insert(id, keyframe);
            self.rebuild()?;
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
        correction.t_map_base.iter().try_for_each(|(_, pose)| check_pose(pose))?;
        let mut report = CorrectionReport { num_moved: 0, num_unknown: 0 };
        for (id, pose) in &correction.t_map_base {
            match self.keyframes.get_mut(id) {
                None => report.num_unknown += 1,
                Some(keyframe) if keyframe.t_map_base != *pose => {
                    keyframe.t_map_base = *pose;
                    report.num_moved += 1;
                }
                Some(_) => {}
            }
        }
        let before = self.keyframes.len();
        gone.iter().for_each(|id| drop(self.keyframes.remove(id)));
        if report.num_moved > 0 || self.keyframes.len() != before {
            self.rebuild()?;
        }
        Ok(report)
    }

    fn rebuild(&mut self) -> Result<(), MappingError> {
        self.layers = empty_layers(&self.params, self.layers.version + 1)?;
        let keyframes: Vec<MapKeyframe> = self.keyframes.values().cloned().collect();
        for chunk in keyframes.chunks(REBUILD_CHUNK) {
            let updates: Vec<_> = chunk.par_iter().map(|k| self.prepare(k)).collect();
            updates.iter().for_each(|update| self.add(update));
        }
        Ok(())
    }

    fn prepare(&self, keyframe: &MapKeyframe) -> (ScanUpdate, CloudUpdate) {
        let MapKeyframe { t_map_base, scan } = keyframe;
        let geometry = self.layers.occupancy.geometry();
        (
            ScanUpdate::new(&self.params.occupancy, geometry, t_map_base, scan),
            CloudUpdate::new(&self.params.cloud, t_map_base, scan),
        )
    }

    fn add(&mut self, (occupancy, cloud): &(ScanUpdate, CloudUpdate)) {
        self.layers.occupancy.apply(occupancy);
        self.layers.cloud.apply(cloud);
    }
}

fn empty_layers(params: &MapParams, version: u64) -> Result<MapLayers, MappingError> {
    Ok(MapLayers { version, occupancy: OccupancyGrid::new(params.occupancy)?, cloud: FusedCloud::new(params.cloud)? })
}
