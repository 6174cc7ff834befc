//! The occupancy of the whole map: submaps' evidence laid over each other.

use super::evidence::State;
use super::grid::grow;
use super::read::{Occupancy, TILE, Visit, locate};
use super::tile::EvidenceTile;
use super::{OccupancyGrid, OccupancyParams, ScanUpdate};
use crate::KeyframeView;
use crate::bytes::{Damaged, Reader, put_i32, put_u32};
use crate::composed::Composed;
use crate::layer::{Footprint, Layer, Placement, TileKey};
use nalgebra::{Point2, Point3};
use percept_geometry::{Aabb3, Cell, GridGeometry};
use std::collections::BTreeMap;
use std::sync::Arc;

const CELLS: usize = (TILE * TILE) as usize;
/// Tiles of a stored part; bounds what damaged bytes may ask for.
const MAX_TILES: usize = 1 << 20;

/// Unbounded 2D occupancy of the whole map: log-odds by cell, unknown where no beam has been.
///
/// Cell (0, 0) has its lower-left corner at the map's origin. A submap that was moved is read at the centres of the map's
/// cells.
/// Source: Moravec and Elfes, "High resolution maps from wide angle sonar", 1985; clamping as in Yguel et al. 2007; maps of
/// submaps as in Hess et al., "Real-time loop closure in 2D LIDAR SLAM", 2016.
pub type OccupancyMap = Composed<OccupancyGrid>;

/// A tile of the map, row-major `64 x 64`.
#[derive(Debug, Clone)]
pub struct OccupancyTile {
    /// NaN where nothing was ever seen.
    log_odds: Vec<f32>,
    bounds: (Cell, Cell),
}

impl PartialEq for OccupancyTile {
    fn eq(&self, other: &Self) -> bool {
        self.log_odds.iter().map(|v| v.to_bits()).eq(other.log_odds.iter().map(|v| v.to_bits()))
    }
}

impl OccupancyTile {
    /// Log-odds of being occupied, row-major `64 x 64`, row 0 at the smallest y; NaN where nothing was seen.
    pub fn log_odds(&self) -> &[f32] {
        &self.log_odds
    }
}

impl Layer for OccupancyGrid {
    type Params = OccupancyParams;
    type Update = ScanUpdate;
    type Under = Vec<State>;
    type Tile = OccupancyTile;

    fn new(params: &OccupancyParams) -> Self {
        Self::of_tiles(*params, BTreeMap::new())
    }

    fn prepare(params: &OccupancyParams, view: &KeyframeView<'_>) -> ScanUpdate {
        ScanUpdate::new(params, &geometry(params), view)
    }

    fn touched(params: &OccupancyParams, update: &ScanUpdate) -> Aabb3 {
        let mut out = Aabb3::empty();
        if update.width > 0 {
            let last = update.width as i32 - 1;
            let (low, high) = (update.min, Cell::new(update.min.x + last, update.min.y + last));
            [low, high].map(|c| geometry(params).center(c)).iter().for_each(|p| out.grow(&Point3::new(p.x, p.y, 0.0)));
        }
        out
    }

    fn add(&mut self, update: &ScanUpdate) {
        self.apply(update);
    }

    fn freeze(&mut self) {
        self.pack();
    }

    fn cell_m(params: &OccupancyParams) -> f64 {
        params.resolution_m
    }

    fn range_max_m(params: &OccupancyParams) -> f64 {
        params.range_max()
    }

    fn tile_edge_m(params: &OccupancyParams) -> f64 {
        f64::from(TILE) * params.resolution_m
    }

    fn unknown(_: &OccupancyParams, _: TileKey) -> Vec<State> {
        vec![State::UNKNOWN; CELLS]
    }

    fn overlay(&self, params: &OccupancyParams, place: &Placement, tile: TileKey, under: &mut Vec<State>) {
        if place.is_aligned() {
            let Some(own) = self.tiles.get(&tile) else { return };
            let cells = under.iter_mut().enumerate();
            cells.for_each(|(slot, state)| own.at(&self.kinds, slot).iter().for_each(|e| state.overlay(e, params)));
            return;
        }
        let (geometry, in_submap) = (geometry(params), place.floor_in_submap());
        let mut at: Option<(TileKey, Option<&Arc<EvidenceTile>>)> = None;
        for (slot, state) in under.iter_mut().enumerate() {
            let cell = Cell::new(tile.0 * TILE + slot as i32 % TILE, tile.1 * TILE + slot as i32 / TILE);
            let Some((key, own)) = geometry.cell(&in_submap(geometry.center(cell))).map(locate) else { continue };
            let found = match at {
                Some((last, found)) if last == key => found,
                _ => at.insert((key, self.tiles.get(&key))).1,
            };
            if let Some(evidence) = found.and_then(|t| t.at(&self.kinds, own)) {
                state.overlay(evidence, params);
            }
        }
    }

    fn finish(_: &OccupancyParams, tile: TileKey, under: &Vec<State>) -> Option<OccupancyTile> {
        let mut bounds = None;
        for slot in (0..CELLS).filter(|slot| !under[*slot].log_odds.is_nan()) {
            grow(&mut bounds, Cell::new(tile.0 * TILE + slot as i32 % TILE, tile.1 * TILE + slot as i32 / TILE));
        }
        Some(OccupancyTile { bounds: bounds?, log_odds: under.iter().map(|s| s.log_odds).collect() })
    }

    fn memory_bytes(&self) -> usize {
        Self::memory_bytes(self)
    }

    fn tile_bytes(tile: &OccupancyTile) -> usize {
        size_of_val(&tile.log_odds[..])
    }

    fn under_bytes(under: &Vec<State>) -> usize {
        size_of_val(&under[..])
    }

    fn footprint(&self, _: &OccupancyParams) -> Footprint {
        Footprint::of(self.tiles.keys().copied().collect())
    }

    fn encode(&self, out: &mut Vec<u8>) {
        put_u32(out, self.tiles.len() as u32);
        for (key, tile) in self.tiles.iter() {
            put_i32(out, key.0);
            put_i32(out, key.1);
            tile.encode(&self.kinds, self.params(), out);
        }
    }

    fn decode(params: &OccupancyParams, from: &mut Reader<'_>) -> Result<Self, Damaged> {
        let mut tiles = BTreeMap::new();
        for _ in 0..from.count(MAX_TILES)? {
            let key = (from.i32()?, from.i32()?);
            tiles.insert(key, Arc::new(EvidenceTile::decode(from)?));
        }
        Ok(Self::of_tiles(*params, tiles))
    }
}

fn geometry(params: &OccupancyParams) -> GridGeometry {
    GridGeometry::new(params.resolution_m, Point2::origin())
}

impl OccupancyMap {
    /// Log-odds of being occupied at a point of the map; none where nothing was seen, or no cell has a number.
    pub fn log_odds_at(&self, p: &Point2<f64>) -> Option<f32> {
        let (key, slot) = locate(geometry(self.params()).cell(p)?);
        self.tile(key).map(|t| t.log_odds[slot]).filter(|v| !v.is_nan())
    }
}

impl Occupancy for OccupancyMap {
    fn geometry(&self) -> GridGeometry {
        geometry(self.params())
    }

    fn bounds(&self) -> Option<(Cell, Cell)> {
        let mut out = None;
        for (_, tile) in self.tiles(self.tile_keys()) {
            grow(&mut out, tile.bounds.0);
            grow(&mut out, tile.bounds.1);
        }
        out
    }

    fn visit(&self, low: TileKey, high: TileKey, visit: Visit<'_>) {
        for (key, tile) in self.tiles(self.tile_keys_within(low, high)) {
            visit(key, &|slot| tile.log_odds[slot]);
        }
    }
}
