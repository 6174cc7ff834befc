//! The surface of a submap, in blocks that copies share.

use super::block::SurfaceBlock;
use super::{SurfaceParams, SurfaceUpdate};
use crate::KeyframeView;
use crate::MappingError;
use crate::blocks::BlockKey;
use crate::cloud::free::FreeSpace;
use crate::error::check_keyframe;
use percept_geometry::{KeyframeScan, Pose};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Signed distances to the surface in voxels around it, in one frame, unbounded: what a submap holds of the surface.
/// [`SurfaceMap`](super::SurfaceMap) lays those of all submaps over each other.
///
/// A voxel's distance is the mean of what was seen of it, cut off at the truncation distance, negative behind the surface; its
/// weight is the number of looks. Cloning costs two references; a clone never sees later changes, and what is added later
/// copies the blocks that it touches, not the rest.
#[derive(Debug, Clone)]
pub struct SurfaceGrid {
    params: SurfaceParams,
    pub(super) blocks: Arc<BTreeMap<BlockKey, Arc<SurfaceBlock>>>,
    /// What keyframes saw through, which earlier submaps may hold something in.
    pub(super) free: FreeSpace,
    /// Blocks with colours.
    pub(super) num_colored: usize,
}

impl SurfaceGrid {
    /// An empty grid.
    ///
    /// # Errors
    /// `InvalidParam`.
    pub fn new(params: SurfaceParams) -> Result<Self, MappingError> {
        params.validate()?;
        Ok(Self::empty(params))
    }

    pub(super) fn empty(params: SurfaceParams) -> Self {
        Self { params, blocks: Arc::default(), free: FreeSpace::default(), num_colored: 0 }
    }

    pub(super) fn of_blocks(
        params: SurfaceParams,
        blocks: BTreeMap<BlockKey, Arc<SurfaceBlock>>,
        free: FreeSpace,
    ) -> Self {
        let num_colored = blocks.values().filter(|b| b.color.is_some()).count();
        Self { params, blocks: Arc::new(blocks), free, num_colored }
    }

    /// Parameters.
    pub fn params(&self) -> &SurfaceParams {
        &self.params
    }

    /// Adds what a keyframe saw from `t_submap_base`, whether the layer is enabled or not: along each beam that returned, the
    /// voxels around the return; what beams saw through loses weight.
    ///
    /// # Errors
    /// `PoseNotFinite`; `Scan` if the colours are not one a point or the height is not finite.
    pub fn integrate(&mut self, t_submap_base: &Pose, scan: &KeyframeScan) -> Result<(), MappingError> {
        check_keyframe(t_submap_base, scan)?;
        self.apply(&SurfaceUpdate::new(&self.params, &KeyframeView::new(t_submap_base, scan)));
        Ok(())
    }

    /// Adds an update made with this grid's parameters: carves first, then folds in.
    pub(super) fn apply(&mut self, update: &SurfaceUpdate) {
        if update.blocks.is_empty() && update.free.is_empty() {
            return;
        }
        let max_weight = self.params.max_weight;
        let blocks = Arc::make_mut(&mut self.blocks);
        for (key, seen) in &update.free {
            if let Some(block) = blocks.get_mut(key) {
                let own = update.blocks.binary_search_by_key(key, |b| b.0).ok().map(|i| &update.blocks[i].1);
                let is_through = |slot: usize| {
                    seen[slot / 64] >> (slot % 64) & 1 == 1
                        && block.distance[slot] < 0
                        && !own.is_some_and(|own| own.says_anything_of(slot))
                };
                let gone: Vec<usize> = (0..super::block::VOXELS).filter(|slot| is_through(*slot)).collect();
                if !gone.is_empty() {
                    let block = Arc::make_mut(block);
                    gone.into_iter().for_each(|slot| block.carve(slot, 1.0, max_weight));
                }
            }
        }
        self.free.add(&update.free);
        for (key, seen) in &update.blocks {
            let block = Arc::make_mut(blocks.entry(*key).or_insert_with(|| Arc::new(SurfaceBlock::unknown())));
            let had_color = block.color.is_some();
            seen.observations(&update.sensor, *key, &self.params).for_each(|(slot, seen)| {
                block.fold(slot, &seen, max_weight);
            });
            self.num_colored += usize::from(block.color.is_some() && !had_color);
        }
    }

    /// Number of blocks of `8 x 8 x 8` voxels that hold anything of a surface.
    pub fn num_blocks(&self) -> usize {
        self.blocks.len()
    }

    /// Whether nothing is known.
    pub fn is_empty(&self) -> bool {
        self.blocks.is_empty()
    }

    /// What its voxels take, bytes.
    pub fn memory_bytes(&self) -> usize {
        let block = size_of::<BlockKey>() + size_of::<SurfaceBlock>();
        let colors = size_of::<super::block::Colors>();
        self.blocks.len() * block + self.num_colored * colors + self.free.memory_bytes()
    }
}

/// Equal in every voxel.
impl PartialEq for SurfaceGrid {
    fn eq(&self, other: &Self) -> bool {
        self.params == other.params && self.blocks == other.blocks && self.free == other.free
    }
}
