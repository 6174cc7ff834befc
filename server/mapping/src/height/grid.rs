//! What a submap holds of heights.

use super::tile::Tile;
use super::{HeightParams, HeightUpdate};
use crate::KeyframeView;
use crate::MappingError;
use crate::error::check_keyframe;
use crate::layer::TileKey;
use percept_geometry::{KeyframeScan, Pose};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Heights in one frame: ground, what stands on it and hangs over it, and where beams passed, so that it can be laid over what
/// earlier submaps hold; [`HeightMap`](super::HeightMap) does. Cell (0, 0) has its lower-left corner at the frame's origin.
///
/// Cloning costs one reference; a clone never sees later changes. A keyframe makes new tiles where it says something, and the rest
/// is shared.
#[derive(Debug, Clone, PartialEq)]
pub struct HeightGrid {
    params: HeightParams,
    pub(super) tiles: Arc<BTreeMap<TileKey, Arc<Tile>>>,
}

impl HeightGrid {
    /// An empty grid.
    ///
    /// # Errors
    /// `InvalidParam`.
    pub fn new(params: HeightParams) -> Result<Self, MappingError> {
        params.validate()?;
        Ok(Self::of_tiles(params, BTreeMap::new()))
    }

    pub(super) fn of_tiles(params: HeightParams, tiles: BTreeMap<TileKey, Arc<Tile>>) -> Self {
        Self { params, tiles: Arc::new(tiles) }
    }

    /// Parameters.
    pub fn params(&self) -> &HeightParams {
        &self.params
    }

    /// Adds what a keyframe saw from `t_map_base`: see [`HeightUpdate::new`].
    ///
    /// # Errors
    /// `PoseNotFinite`; `Scan` if the channels do not fit the points or the height is not finite.
    pub fn integrate(&mut self, t_map_base: &Pose, scan: &KeyframeScan) -> Result<(), MappingError> {
        check_keyframe(t_map_base, scan)?;
        self.apply(&HeightUpdate::new(&self.params, &KeyframeView::new(t_map_base, scan)));
        Ok(())
    }

    /// Adds an update made with this grid's parameters.
    pub fn apply(&mut self, update: &HeightUpdate) {
        let (params, tiles) = (self.params, Arc::make_mut(&mut self.tiles));
        let with = |(key, seen): &(TileKey, _)| {
            let tile = tiles.get(key).map_or_else(|| Tile::EMPTY.with(seen, &params), |tile| tile.with(seen, &params));
            (*key, Arc::new(tile))
        };
        let made: Vec<_> = update.tiles.par_iter().map(with).collect();
        tiles.extend(made);
    }

    /// Takes less memory from now on.
    pub(super) fn pack(&mut self) {
        let packed = self.tiles.iter().map(|(key, tile)| (*key, Arc::new(tile.packed())));
        self.tiles = Arc::new(packed.collect());
    }

    /// Number of cells whose ground was seen.
    pub fn num_ground(&self) -> usize {
        self.tiles.values().map(|tile| tile.iter().filter(|(_, cell)| cell.num > 0).count()).sum()
    }

    /// What its tiles take, bytes.
    pub fn memory_bytes(&self) -> usize {
        self.tiles.values().map(|tile| tile.memory_bytes()).sum()
    }
}
