//! The unbounded grid of evidence, in tiles that copies share.

use super::evidence::Evidence;
use super::kinds::Kinds;
use super::mark::Mark;
use super::marks::Marks;
use super::planar::PlanarMarks;
use super::read::{Occupancy, TILE, Visit, locate, overlap};
use super::tile::EvidenceTile;
use super::{DenseGrid, OccupancyParams, ScanUpdate};
use crate::KeyframeView;
use crate::MappingError;
use crate::error::check_keyframe;
use nalgebra::Point2;
use percept_geometry::{Cell, GridGeometry, KeyframeScan, Pose};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Unbounded 2D occupancy in one frame: what was seen in each cell, unknown where no beam has been. It is what a submap
/// holds of the floor; [`OccupancyMap`](super::OccupancyMap) lays those of all submaps over each other.
///
/// Cell (0, 0) has its lower-left corner at the geometry's origin: (0, 0) for grids built here, the rectangle's
/// for imported ones. Cloning costs one reference; a clone never sees later changes.
/// Source: Moravec and Elfes, "High resolution maps from wide angle sonar", 1985; clamping as in Yguel et al. 2007.
#[derive(Debug, Clone)]
pub struct OccupancyGrid {
    params: OccupancyParams,
    geometry: GridGeometry,
    pub(super) tiles: Arc<BTreeMap<(i32, i32), Arc<EvidenceTile>>>,
    /// What lean tiles' numbers mean.
    pub(super) kinds: Arc<Kinds>,
    bounds: Option<(Cell, Cell)>,
}

impl OccupancyGrid {
    /// An empty grid.
    ///
    /// # Errors
    /// `InvalidParam`.
    pub fn new(params: OccupancyParams) -> Result<Self, MappingError> {
        params.validate()?;
        let geometry = GridGeometry::new(params.resolution_m, Point2::origin());
        Ok(Self { params, geometry, tiles: Arc::default(), kinds: Arc::default(), bounds: None })
    }

    /// A grid holding an imported rectangle, cell for cell: its geometry is the rectangle's, whose resolution
    /// replaces that of `params`. Probabilities are clamped to what `params` keeps.
    ///
    /// # Errors
    /// `GridShape`, `CellValue`, `InvalidParam`.
    pub fn from_dense(dense: &DenseGrid, params: OccupancyParams) -> Result<Self, MappingError> {
        dense.validate()?;
        let params = OccupancyParams { resolution_m: dense.geometry.resolution_m, ..params };
        let mut grid = Self { geometry: dense.geometry, ..Self::new(params)? };
        let tiles = Arc::make_mut(&mut grid.tiles);
        for (i, &value) in dense.cells.iter().enumerate().filter(|(_, v)| **v >= 0) {
            let cell = Cell::new((i % dense.width) as i32, (i / dense.width) as i32);
            let p = f64::from(value) / 100.0;
            let log_odds = ((p / (1.0 - p)).ln() as f32).clamp(params.min_log_odds, params.max_log_odds);
            let (key, slot) = locate(cell);
            let tile = Arc::make_mut(tiles.entry(key).or_default());
            tile.cells(&grid.kinds, &params)[slot] = Evidence { log_odds, ..Evidence::none(&params) };
            grow(&mut grid.bounds, cell);
        }
        Ok(grid)
    }

    /// Edge of a tile of the map, cells.
    pub(crate) const TILE_CELLS: i32 = TILE;

    /// Parameters.
    pub fn params(&self) -> &OccupancyParams {
        &self.params
    }

    /// Adds what a keyframe saw from `t_map_base`: see [`ScanUpdate::new`].
    ///
    /// # Errors
    /// `PoseNotFinite`; `Scan` if the channels do not fit the points or the height is not finite.
    pub fn integrate(&mut self, t_map_base: &Pose, scan: &KeyframeScan) -> Result<(), MappingError> {
        check_keyframe(t_map_base, scan)?;
        let update = ScanUpdate::new(&self.params, &self.geometry, &KeyframeView::new(t_map_base, scan));
        self.apply(&update);
        Ok(())
    }

    /// Adds an update made with this grid's parameters and geometry.
    pub fn apply(&mut self, update: &ScanUpdate) {
        match &update.marks {
            _ if update.width == 0 => {}
            Marks::Each(marks) => self.apply_each(update, marks),
            Marks::Planar(marks) => self.apply_planar(marks),
        }
    }

    fn apply_each(&mut self, update: &ScanUpdate, marks: &[Mark]) {
        let last = update.width as i32 - 1;
        let ((tx0, ty0), _) = locate(update.min);
        let ((tx1, ty1), _) = locate(Cell::new(update.min.x + last, update.min.y + last));
        let tiles = Arc::make_mut(&mut self.tiles);
        for key in (ty0..=ty1).flat_map(|ty| (tx0..=tx1).map(move |tx| (tx, ty))) {
            let (x0, x1) = overlap(key.0, update.min.x, update.width);
            let (y0, y1) = overlap(key.1, update.min.y, update.width);
            let row = |y: usize| &marks[y * update.width + x0..y * update.width + x1];
            if (y0..y1).all(|y| row(y).iter().all(|m| *m == Mark::Unseen)) {
                continue;
            }
            let cells = Arc::make_mut(tiles.entry(key).or_default()).cells(&self.kinds, &self.params);
            for y in y0..y1 {
                for (x, mark) in (x0..x1).zip(row(y)).filter(|(_, m)| **m != Mark::Unseen) {
                    let cell = Cell::new(update.min.x + x as i32, update.min.y + y as i32);
                    let evidence = &mut cells[locate(cell).1];
                    evidence.add(*mark, update.planar, &self.params);
                    // Of what beams went over alone nothing is known.
                    if !evidence.log_odds.is_nan() {
                        grow(&mut self.bounds, cell);
                    }
                }
            }
        }
    }

    fn apply_planar(&mut self, marks: &PlanarMarks) {
        let (tiles, kinds, params) = (Arc::make_mut(&mut self.tiles), &mut self.kinds, &self.params);
        for tile in marks.tiles() {
            Arc::make_mut(tiles.entry(tile.key).or_default()).add(kinds, &tile, marks.heights, params);
            for cell in tile.bounds().into_iter().flat_map(|(low, high)| [low, high]) {
                grow(&mut self.bounds, cell);
            }
        }
        for (cell, heights) in &marks.driven {
            let (key, slot) = locate(*cell);
            let tile = Arc::make_mut(tiles.entry(key).or_default());
            if tile.add_at(kinds, slot, Mark::Driven(*heights), params) {
                grow(&mut self.bounds, *cell);
            }
        }
    }

    /// Takes less memory from now on, and more time if another keyframe is added.
    pub fn pack(&mut self) {
        let (params, kinds) = (self.params, std::mem::take(&mut self.kinds));
        let tiles: Vec<_> = self.tiles.iter().map(|(key, tile)| (*key, Arc::clone(tile))).collect();
        let packed = tiles.into_par_iter().map(|(key, tile)| (key, Arc::new(tile.packed(&kinds, &params))));
        self.tiles = Arc::new(packed.collect::<Vec<_>>().into_iter().collect());
    }

    /// What its tiles take, bytes.
    pub fn memory_bytes(&self) -> usize {
        self.tiles.values().map(|t| t.memory_bytes()).sum::<usize>() + self.kinds.memory_bytes()
    }

    /// From tiles of these parameters.
    pub(super) fn of_tiles(params: OccupancyParams, tiles: BTreeMap<(i32, i32), Arc<EvidenceTile>>) -> Self {
        let geometry = GridGeometry::new(params.resolution_m, Point2::origin());
        let (mut bounds, kinds) = (None, Arc::<Kinds>::default());
        for (key, tile) in &tiles {
            for slot in
                (0..(TILE * TILE) as usize).filter(|slot| tile.at(&kinds, *slot).is_some_and(|e| !e.log_odds.is_nan()))
            {
                let (x, y) = ((slot as i32) % TILE, (slot as i32) / TILE);
                grow(&mut bounds, Cell::new(key.0 * TILE + x, key.1 * TILE + y));
            }
        }
        Self { params, geometry, tiles: Arc::new(tiles), kinds, bounds }
    }
}

impl Occupancy for OccupancyGrid {
    fn geometry(&self) -> GridGeometry {
        self.geometry
    }

    fn bounds(&self) -> Option<(Cell, Cell)> {
        self.bounds
    }

    fn visit(&self, low: (i32, i32), high: (i32, i32), visit: Visit<'_>) {
        let inside = |key: &(i32, i32)| key.0 >= low.0 && key.0 <= high.0 && key.1 >= low.1 && key.1 <= high.1;
        for (key, tile) in self.tiles.iter().filter(|(key, _)| inside(key)) {
            visit(*key, &|slot| tile.at(&self.kinds, slot).map_or(f32::NAN, |e| e.log_odds));
        }
    }
}

/// Equal in geometry and in the bytes of every cell.
impl PartialEq for OccupancyGrid {
    fn eq(&self, other: &Self) -> bool {
        self.geometry == other.geometry
            && self.tiles.len() == other.tiles.len()
            && self
                .tiles
                .iter()
                .zip(other.tiles.iter())
                .all(|((ka, a), (kb, b))| ka == kb && a.same_cells(&self.kinds, b, &other.kinds))
    }
}

pub(super) fn grow(bounds: &mut Option<(Cell, Cell)>, cell: Cell) {
    let (min, max) = bounds.get_or_insert((cell, cell));
    *min = Cell::new(min.x.min(cell.x), min.y.min(cell.y));
    *max = Cell::new(max.x.max(cell.x), max.y.max(cell.y));
}
