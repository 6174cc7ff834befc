//! The surface as a layer of the map.

use super::tile::{SurfaceTile, TILE_BLOCKS, Under};
use super::{SurfaceGrid, SurfaceParams, SurfaceUpdate, compose, stored};
use crate::KeyframeView;
use crate::blocks::block_box;
use crate::blocks::{BLOCK, BlockKey};
use crate::bytes::{Damaged, Reader};
use crate::layer::{Footprint, Layer, Placement, TileKey, joined};
use percept_geometry::Aabb3;
use std::sync::Arc;

impl Layer for SurfaceGrid {
    type Params = SurfaceParams;
    type Update = SurfaceUpdate;
    type Under = Under;
    type Tile = SurfaceTile;

    fn new(params: &SurfaceParams) -> Self {
        Self::empty(*params)
    }

    fn prepare(params: &SurfaceParams, view: &KeyframeView<'_>) -> SurfaceUpdate {
        if params.enabled { SurfaceUpdate::new(params, view) } else { SurfaceUpdate::nothing() }
    }

    fn touched(params: &SurfaceParams, update: &SurfaceUpdate) -> Aabb3 {
        let keys = update.blocks.iter().map(|b| b.0).chain(update.free.iter().map(|b| b.0));
        keys.fold(Aabb3::empty(), |out, key| joined(&out, &block_box(key, params.voxel_size_m)))
    }

    fn add(&mut self, update: &SurfaceUpdate) {
        self.apply(update);
    }

    fn freeze(&mut self) {}

    fn cell_m(params: &SurfaceParams) -> f64 {
        if params.enabled { params.voxel_size_m } else { 0.0 }
    }

    fn range_max_m(params: &SurfaceParams) -> f64 {
        if params.enabled { params.range_max() } else { 0.0 }
    }

    fn tile_edge_m(params: &SurfaceParams) -> f64 {
        f64::from(TILE_BLOCKS * BLOCK) * params.voxel_size_m
    }

    fn unknown(_: &SurfaceParams, _: TileKey) -> Under {
        Under::new()
    }

    fn overlay(&self, params: &SurfaceParams, place: &Placement, tile: TileKey, under: &mut Under) {
        if params.carve {
            compose::carve(self, place, under);
        }
        compose::lay_over(self, place, tile, under);
    }

    fn finish(_: &SurfaceParams, _: TileKey, under: &Under) -> Option<SurfaceTile> {
        (!under.is_empty()).then(|| SurfaceTile::of(under.iter().map(|(key, b)| (*key, Arc::clone(b))).collect()))
    }

    fn memory_bytes(&self) -> usize {
        self.memory_bytes()
    }

    fn tile_bytes(tile: &SurfaceTile) -> usize {
        tile.memory_bytes()
    }

    fn under_bytes(under: &Under) -> usize {
        under.values().map(|block| size_of::<BlockKey>() + block.memory_bytes()).sum()
    }

    fn footprint(&self, _: &SurfaceParams) -> Footprint {
        let blocks = self.blocks.keys().chain(self.free.blocks.keys());
        Footprint::of(blocks.map(|(x, y, _)| (x.div_euclid(TILE_BLOCKS), y.div_euclid(TILE_BLOCKS))).collect())
    }

    fn encode(&self, out: &mut Vec<u8>) {
        stored::encode(self, out);
    }

    fn decode(params: &SurfaceParams, from: &mut Reader<'_>) -> Result<Self, Damaged> {
        stored::decode(params, from)
    }
}
