//! Tiles of a distance field, kept as long as what they were computed of.

use crate::layer::TileKey;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

/// A tile of a distance field.
#[derive(Debug, PartialEq)]
pub(super) struct DistanceTile {
    /// Height of the first layer, in cells; 0 in two dimensions.
    pub(super) first_z: i32,
    /// Layer by layer: squared distance in cells, below 0 inside of obstacles.
    pub(super) squares: Vec<i16>,
}

/// Tiles by key, each with the version of the map that it was computed of.
type Kept = BTreeMap<TileKey, (u64, Option<Arc<DistanceTile>>)>;

/// Computed tiles, shared by all moments of a map.
#[derive(Debug, Clone, Default)]
pub(crate) struct DistanceCache(Arc<Mutex<Kept>>);

impl DistanceCache {
    fn with<T>(&self, f: impl FnOnce(&mut Kept) -> T) -> T {
        // Each entry is whole whoever stopped where.
        f(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// The tile of a version, computed if it is not kept; what an older moment reads is not kept in the place of newer ones.
    pub(super) fn tile(
        &self,
        key: TileKey,
        version: u64,
        compute: impl FnOnce() -> Option<DistanceTile>,
    ) -> Option<Arc<DistanceTile>> {
        if let Some((_, tile)) = self.with(|kept| kept.get(&key).filter(|k| k.0 == version).cloned()) {
            return tile;
        }
        let tile = compute().map(Arc::new);
        self.with(|kept| {
            if kept.get(&key).is_none_or(|k| k.0 < version) {
                kept.insert(key, (version, tile.clone()));
            }
        });
        tile
    }

    /// What the tiles take, bytes.
    pub(crate) fn kept_bytes(&self) -> usize {
        self.with(|kept| kept.values().filter_map(|k| k.1.as_ref()).map(|t| 2 * t.squares.len()).sum())
    }

    /// Gives up all of them: they are computed anew when they are read.
    pub(crate) fn forget(&self) {
        self.with(Kept::clear);
    }
}

/// What is computed is no part of what a map is.
impl PartialEq for DistanceCache {
    fn eq(&self, _: &Self) -> bool {
        true
    }
}
