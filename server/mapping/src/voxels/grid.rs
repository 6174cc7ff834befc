//! The voxels of a submap, in blocks that copies share.

use super::block::{Evidence, LogOdds};
use super::{VoxelParams, VoxelUpdate};
use crate::KeyframeView;
use crate::MappingError;
use crate::blocks::BlockKey;
use crate::error::check_keyframe;
use percept_geometry::{KeyframeScan, Pose};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Unbounded 3D occupancy in one frame: log-odds by voxel, unknown where no beam has been. It is what a submap holds;
/// [`VoxelMap`](super::VoxelMap) lays those of all submaps over each other. Cloning costs one reference; a clone never sees later
/// changes.
///
/// Source: Hornung et al., "OctoMap: An efficient probabilistic 3D mapping framework based on octrees", 2013, in blocks of 8 x 8 x 8
/// instead of a tree.
#[derive(Debug, Clone, PartialEq)]
pub struct VoxelGrid {
    params: VoxelParams,
    log_odds: LogOdds,
    pub(super) blocks: Arc<BTreeMap<BlockKey, Arc<Evidence>>>,
}

impl VoxelGrid {
    /// An empty grid.
    ///
    /// # Errors
    /// `InvalidParam`.
    pub fn new(params: VoxelParams) -> Result<Self, MappingError> {
        params.validate()?;
        Ok(Self::of_blocks(params, BTreeMap::new()))
    }

    pub(super) fn of_blocks(params: VoxelParams, blocks: BTreeMap<BlockKey, Arc<Evidence>>) -> Self {
        Self { params, log_odds: params.log_odds(), blocks: Arc::new(blocks) }
    }

    /// Edge of a tile of the map, voxels.
    pub(crate) const TILE_VOXELS: i32 = 64;

    /// Parameters.
    pub fn params(&self) -> &VoxelParams {
        &self.params
    }

    /// Adds what a keyframe saw from `t_map_base`: see [`VoxelUpdate::new`].
    ///
    /// # Errors
    /// `PoseNotFinite`; `Scan` if the channels do not fit the points or the height is not finite.
    pub fn integrate(&mut self, t_map_base: &Pose, scan: &KeyframeScan) -> Result<(), MappingError> {
        check_keyframe(t_map_base, scan)?;
        self.apply(&VoxelUpdate::new(&self.params, &KeyframeView::new(t_map_base, scan)));
        Ok(())
    }

    /// Adds an update made with this grid's parameters.
    pub fn apply(&mut self, update: &VoxelUpdate) {
        if update.blocks.is_empty() {
            return;
        }
        let blocks = Arc::make_mut(&mut self.blocks);
        for (key, free, hit) in &update.blocks {
            let evidence = blocks.entry(*key).or_insert_with(|| Arc::new(Evidence::none(&self.log_odds)));
            Arc::make_mut(evidence).add(free, hit, &self.log_odds);
        }
    }

    pub(super) fn limits(&self) -> &LogOdds {
        &self.log_odds
    }
}
