//! A composed tile, and the mesh of it that was asked for last.

use super::block::SurfaceBlock;
use super::piece::Piece;
use crate::blocks::BlockKey;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError, Weak};

/// Edge of a tile of the map, blocks.
pub(super) const TILE_BLOCKS: i32 = 8;

/// A tile while it is composed: blocks of the map, shared with the parts that they come from as long as one part says all.
pub(super) type Under = BTreeMap<BlockKey, Arc<SurfaceBlock>>;

/// A tile of the map: a column of all heights. Equal if its voxels are.
#[derive(Debug)]
pub struct SurfaceTile {
    /// Ascending.
    blocks: Vec<(BlockKey, Arc<SurfaceBlock>)>,
    meshed: Mutex<Option<Meshed>>,
}

/// The tile's mesh, and what it was made of.
#[derive(Debug)]
struct Meshed {
    min_weight: f32,
    around: Around,
    piece: Arc<Piece>,
}

/// A tile's eight neighbours. A tile that is composed anew is another one, and a weak reference keeps its address from being
/// given to that.
pub(super) type Around = [Option<Weak<SurfaceTile>>; 8];

impl SurfaceTile {
    /// Of blocks in order.
    pub(super) fn of(blocks: Vec<(BlockKey, Arc<SurfaceBlock>)>) -> Self {
        Self { blocks, meshed: Mutex::default() }
    }

    pub(super) fn blocks(&self) -> &[(BlockKey, Arc<SurfaceBlock>)] {
        &self.blocks
    }

    pub(super) fn block(&self, key: &BlockKey) -> Option<&SurfaceBlock> {
        let at = self.blocks.binary_search_by_key(key, |b| b.0).ok()?;
        Some(&self.blocks[at].1)
    }

    /// Its mesh, if it was made of this tile beside these neighbours.
    pub(super) fn meshed(&self, min_weight: f32, around: &Around) -> Option<Arc<Piece>> {
        let meshed = self.meshed.lock().unwrap_or_else(PoisonError::into_inner);
        let is_same = |a: &Option<Weak<Self>>, b: &Option<Weak<Self>>| match (a, b) {
            (Some(a), Some(b)) => a.ptr_eq(b),
            (None, None) => true,
            _ => false,
        };
        let is_current =
            |m: &&Meshed| m.min_weight == min_weight && m.around.iter().zip(around).all(|(a, b)| is_same(a, b));
        meshed.as_ref().filter(is_current).map(|m| Arc::clone(&m.piece))
    }

    /// Keeps its mesh.
    pub(super) fn keep(&self, min_weight: f32, around: Around, piece: Arc<Piece>) {
        *self.meshed.lock().unwrap_or_else(PoisonError::into_inner) = Some(Meshed { min_weight, around, piece });
    }

    /// What it takes, its mesh included, bytes; blocks that it shares with a submap count here as well.
    pub(super) fn memory_bytes(&self) -> usize {
        let meshed = self.meshed.lock().unwrap_or_else(PoisonError::into_inner);
        let blocks: usize = self.blocks.iter().map(|(_, b)| size_of::<BlockKey>() + b.memory_bytes()).sum();
        blocks + meshed.as_ref().map_or(0, |m| m.piece.memory_bytes())
    }

    /// Number of blocks of `8 x 8 x 8` voxels.
    pub fn num_blocks(&self) -> usize {
        self.blocks.len()
    }
}

impl PartialEq for SurfaceTile {
    fn eq(&self, other: &Self) -> bool {
        self.blocks == other.blocks
    }
}
