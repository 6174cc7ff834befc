//! The surface as triangles.

use super::block::SurfaceBlock;
use super::extract::extract;
use super::mesh_data::MeshData;
use super::piece::{GridEdge, Piece, weld};
use super::tile::TILE_BLOCKS;
use super::tile::{Around, SurfaceTile};
use super::{SurfaceGrid, SurfaceMap};
use crate::MappingError;
use crate::blocks::{BLOCK, BlockKey};
use crate::error::check;
use crate::layer::{Layer, TileKey, tiles_of};
use nalgebra::Point3;
use percept_geometry::Aabb3;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

/// What of a surface is meshed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MeshOptions {
    /// Triangles of which a corner lies in this box, metres; none: all.
    pub region: Option<Aabb3>,
    /// Voxels with a lower weight count as unknown, and what is unknown has no surface; looks, above 0 to 255.
    pub min_weight: f32,
    /// Most triangles of the tiles that the region reaches into.
    pub max_triangles: usize,
}

impl Default for MeshOptions {
    /// Everything that was seen in half a look at least, up to ten million triangles.
    fn default() -> Self {
        Self { region: None, min_weight: 0.5, max_triangles: 10_000_000 }
    }
}

impl MeshOptions {
    fn check(&self) -> Result<(), MappingError> {
        check("min_weight", self.min_weight.into(), f64::MIN_POSITIVE, 255.0, "choose above 0 to 255")?;
        match &self.region {
            Some(region) if region.is_empty() => Err(MappingError::RegionEmpty),
            _ => Ok(()),
        }
    }
}

/// Triangles counted by all who mesh at the same time.
struct Budget {
    taken: AtomicUsize,
    limit: usize,
}

impl Budget {
    /// Blocks that are meshed before they are counted: at most five triangles a voxel each.
    const STEP: usize = 64;

    /// Counts triangles.
    ///
    /// # Errors
    /// `MeshTooLarge`.
    fn take(&self, num_triangles: usize) -> Result<(), MappingError> {
        let taken = self.taken.fetch_add(num_triangles, Ordering::Relaxed).saturating_add(num_triangles);
        if taken > self.limit { Err(MappingError::MeshTooLarge { limit: self.limit }) } else { Ok(()) }
    }
}

impl SurfaceMap {
    /// The surface as triangles, map frame, composed where it is needed. A tile's mesh is kept with it: only tiles that are
    /// other ones than the last time, and those beside them, are meshed again. Neighbouring tiles share the vertices between them:
    /// the mesh has no cracks. Work runs on the current rayon pool.
    ///
    /// # Errors
    /// `RegionEmpty`; `InvalidParam` naming `min_weight`; `MeshTooLarge`.
    pub fn mesh(&self, options: &MeshOptions) -> Result<MeshData, MappingError> {
        options.check()?;
        let edge = SurfaceGrid::tile_edge_m(self.params());
        let keys: Vec<TileKey> = match options.region.as_ref().and_then(|region| tiles_of(edge, region)) {
            None => self.tile_keys().collect(),
            // The triangles of a tile reach a voxel and a half beyond it.
            Some((low, high)) => {
                let one = |key: TileKey, step: i32| (key.0.saturating_add(step), key.1.saturating_add(step));
                self.tile_keys_within(one(low, -2), one(high, 1)).collect()
            }
        };
        let tiles: BTreeMap<TileKey, Arc<SurfaceTile>> = self.tiles(keys.into_iter()).into_iter().collect();
        let is_wanted = |key: &TileKey| {
            let Some(region) = &options.region else { return true };
            let low = |k: i32| f64::from(k) * edge;
            let beyond = 2.0 * self.params().voxel_size_m;
            low(key.0) <= region.max.x
                && low(key.0) + edge + beyond >= region.min.x
                && low(key.1) <= region.max.y
                && low(key.1) + edge + beyond >= region.min.y
        };
        let budget = Budget { taken: AtomicUsize::new(0), limit: options.max_triangles };
        let wanted: Vec<(&TileKey, &Arc<SurfaceTile>)> = tiles.iter().filter(|(key, _)| is_wanted(key)).collect();
        let pieces = wanted
            .into_par_iter()
            .map(|(key, tile)| tile_piece(*key, tile, &tiles, self.params().voxel_size_m, options.min_weight, &budget))
            .collect::<Result<Vec<_>, _>>()?;
        let whole = weld(pieces.iter().map(|p| &**p), |_| false).mesh;
        Ok(match &options.region {
            Some(region) => whole.within(region),
            None => whole,
        })
    }
}

/// The mesh of a tile among others, as it is kept or made anew.
fn tile_piece(
    key: TileKey,
    tile: &Arc<SurfaceTile>,
    tiles: &BTreeMap<TileKey, Arc<SurfaceTile>>,
    voxel_size_m: f64,
    min_weight: f32,
    budget: &Budget,
) -> Result<Arc<Piece>, MappingError> {
    let mut around: [Option<&Arc<SurfaceTile>>; 9] = [None; 9];
    for (i, beside) in around.iter_mut().enumerate() {
        *beside = tiles.get(&(key.0 + i as i32 % 3 - 1, key.1 + i as i32 / 3 - 1));
    }
    // All but the tile itself.
    let stamp: Around = std::array::from_fn(|i| around[if i < 4 { i } else { i + 1 }].map(Arc::downgrade));
    if let Some(piece) = tile.meshed(min_weight, &stamp) {
        budget.take(piece.mesh.triangles.len())?;
        return Ok(piece);
    }
    let find = |block: BlockKey| {
        let step = |block: i32, tile: i32| block.div_euclid(TILE_BLOCKS) - tile + 1;
        let at = step(block.1, key.1) * 3 + step(block.0, key.0);
        around.get(at as usize).copied().flatten().and_then(|tile| tile.block(&block))
    };
    let keys: Vec<BlockKey> = tile.blocks().iter().map(|b| b.0).collect();
    let pieces = pieces_of(&keys, &find, voxel_size_m, min_weight, budget)?;
    let is_rim = |(voxel, axis): &GridEdge| {
        (0..2).any(|i| i != usize::from(*axis) && voxel[i].rem_euclid(TILE_BLOCKS * BLOCK) == 0)
    };
    let piece = Arc::new(weld(pieces.iter(), is_rim));
    tile.keep(min_weight, stamp, Arc::clone(&piece));
    Ok(piece)
}

/// The mesh of each of some blocks, in order; those without are left out.
fn pieces_of<'a>(
    keys: &[BlockKey],
    find: &(impl Fn(BlockKey) -> Option<&'a SurfaceBlock> + Sync),
    voxel_size_m: f64,
    min_weight: f32,
    budget: &Budget,
) -> Result<Vec<Piece>, MappingError> {
    let chunks = keys.par_chunks(Budget::STEP).map(|chunk| {
        let mut pieces = vec![];
        for key in chunk {
            let piece = extract(*key, min_weight, voxel_size_m, find);
            if !piece.mesh.triangles.is_empty() {
                pieces.push(piece);
            }
        }
        budget.take(pieces.iter().map(|p| p.mesh.triangles.len()).sum())?;
        Ok::<_, MappingError>(pieces)
    });
    Ok(chunks.collect::<Result<Vec<_>, _>>()?.into_iter().flatten().collect())
}

impl SurfaceGrid {
    /// The surface of this part alone as triangles, its own frame. Work runs on the current rayon pool.
    ///
    /// # Errors
    /// As [`SurfaceMap::mesh`].
    pub fn mesh(&self, options: &MeshOptions) -> Result<MeshData, MappingError> {
        options.check()?;
        let edge = f64::from(BLOCK) * self.params().voxel_size_m;
        let is_wanted = |key: &&BlockKey| {
            let Some(region) = &options.region else { return true };
            let low = Point3::new(key.0, key.1, key.2).map(|v| f64::from(v) * edge);
            (0..3).all(|i| low[i] <= region.max[i] && low[i] + 1.25 * edge >= region.min[i])
        };
        let keys: Vec<BlockKey> = self.blocks.keys().filter(is_wanted).copied().collect();
        let find = |key: BlockKey| self.blocks.get(&key).map(|b| &**b);
        let budget = Budget { taken: AtomicUsize::new(0), limit: options.max_triangles };
        let pieces = pieces_of(&keys, &find, self.params().voxel_size_m, options.min_weight, &budget)?;
        let whole = weld(pieces.iter(), |_| false).mesh;
        Ok(match &options.region {
            Some(region) => whole.within(region),
            None => whole,
        })
    }
}
