//! Heights of the whole map: submaps laid over each other.

use super::cell::Pass;
use super::storeys::Storeys;
use super::tile::{CELLS, Tile};
use super::{HeightGrid, HeightParams, HeightTile, HeightUpdate};
use crate::KeyframeView;
use crate::bytes::{Damaged, Reader, put_i32, put_u32};
use crate::composed::Composed;
use crate::layer::{Footprint, Layer, Placement, TileKey};
use crate::occupancy::{TILE, locate};
use nalgebra::{Point2, Point3};
use percept_geometry::{Aabb3, Cell as At, GridGeometry};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Tiles of a stored part; bounds what damaged bytes may ask for.
const MAX_TILES: usize = 1 << 20;

/// Heights of the whole map, unbounded. Cell (0, 0) has its lower-left corner at the map's origin.
///
/// Submaps that lie on the map's cells are fused cell by cell; one that was moved is read at the centres of the map's cells on
/// its floor, its heights moved and tilted with it.
pub type HeightMap = Composed<HeightGrid>;

impl Layer for HeightGrid {
    type Params = HeightParams;
    type Update = HeightUpdate;
    type Under = Storeys;
    type Tile = HeightTile;

    fn new(params: &HeightParams) -> Self {
        Self::of_tiles(*params, BTreeMap::new())
    }

    fn prepare(params: &HeightParams, view: &KeyframeView<'_>) -> HeightUpdate {
        HeightUpdate::new(params, view)
    }

    fn touched(_: &HeightParams, update: &HeightUpdate) -> Aabb3 {
        update.bounds
    }

    fn add(&mut self, update: &HeightUpdate) {
        self.apply(update);
    }

    fn freeze(&mut self) {
        self.pack();
    }

    fn cell_m(params: &HeightParams) -> f64 {
        if params.enabled { params.resolution_m } else { 0.0 }
    }

    fn range_max_m(params: &HeightParams) -> f64 {
        if params.enabled { params.range_max() } else { 0.0 }
    }

    fn tile_edge_m(params: &HeightParams) -> f64 {
        f64::from(TILE) * params.resolution_m
    }

    fn unknown(_: &HeightParams, _: TileKey) -> Storeys {
        Storeys::default()
    }

    fn overlay(&self, params: &HeightParams, place: &Placement, tile: TileKey, under: &mut Storeys) {
        if place.is_aligned() {
            let Some(own) = self.tiles.get(&tile) else { return };
            if under.is_empty() {
                return own.iter().for_each(|(slot, cell)| under.overlay(slot, Some(cell), &Pass::NONE, params));
            }
            return (0..CELLS).for_each(|slot| under.overlay(slot, own.at(slot), own.pass(slot), params));
        }
        let (geometry, in_submap) = (geometry(params), place.floor_in_submap());
        let mut at: Option<(TileKey, Option<&Arc<Tile>>)> = None;
        for slot in 0..CELLS {
            let cell = At::new(tile.0 * TILE + slot as i32 % TILE, tile.1 * TILE + slot as i32 / TILE);
            let p = in_submap(geometry.center(cell));
            let Some((key, own)) = geometry.cell(&p).map(locate) else { continue };
            let found = match at {
                Some((last, found)) if last == key => found,
                _ => at.insert((key, self.tiles.get(&key))).1,
            };
            let Some(found) = found else { continue };
            let up = |z: f32| (place.t_map_submap * Point3::new(p.x, p.y, z.into())).z - f64::from(z);
            let (cell, pass) = (found.at(own), found.pass(own));
            let cell = cell.map(|c| c.raised(up(c.z), params));
            under.overlay(slot, cell.as_ref(), &pass.raised(up(pass.z), params), params);
        }
    }

    fn finish(_: &HeightParams, tile: TileKey, under: &Storeys) -> Option<HeightTile> {
        under.tile(tile)
    }

    fn memory_bytes(&self) -> usize {
        Self::memory_bytes(self)
    }

    fn tile_bytes(tile: &HeightTile) -> usize {
        tile.memory_bytes()
    }

    fn under_bytes(under: &Storeys) -> usize {
        under.memory_bytes()
    }

    fn footprint(&self, _: &HeightParams) -> Footprint {
        Footprint::of(self.tiles.keys().copied().collect())
    }

    fn encode(&self, out: &mut Vec<u8>) {
        put_u32(out, self.tiles.len() as u32);
        for (key, tile) in self.tiles.iter() {
            put_i32(out, key.0);
            put_i32(out, key.1);
            tile.encode(out);
        }
    }

    fn decode(params: &HeightParams, from: &mut Reader<'_>) -> Result<Self, Damaged> {
        let mut tiles = BTreeMap::new();
        for _ in 0..from.count(MAX_TILES)? {
            let key = (from.i32()?, from.i32()?);
            tiles.insert(key, Arc::new(Tile::decode(from)?));
        }
        Ok(Self::of_tiles(*params, tiles))
    }
}

pub(super) fn geometry(params: &HeightParams) -> GridGeometry {
    GridGeometry::new(params.resolution_m, Point2::origin())
}
