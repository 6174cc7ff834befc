//! The unbounded grid of log-odds, in tiles that snapshots share.

use super::update::{Heights, Mark};
use super::{DenseGrid, OccupancyParams, ScanUpdate};
use crate::MappingError;
use crate::error::check_keyframe;
use nalgebra::Point2;
use percept_geometry::{Cell, GridGeometry, KeyframeScan, Pose};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Edge of a tile, cells.
const TILE: i32 = 64;

const TILE_CELLS: usize = (TILE * TILE) as usize;

/// A tile, row-major `TILE x TILE`.
#[derive(Debug, Clone)]
struct Tile {
    /// NaN where nothing was ever seen.
    log_odds: [f32; TILE_CELLS],
    /// The heights at which something was hit here and not freed since, and those at which beams passed: evidence
    /// counts for its own heights. The floor seen under a table does not free its top, nor do the beams of a planar
    /// lidar; and what was free for these can still be hit at another height.
    standing: [Heights; TILE_CELLS],
    passed: [Heights; TILE_CELLS],
}

impl Tile {
    fn update(&mut self, slot: usize, mark: Mark, planar: bool, params: &OccupancyParams) {
        let (standing, passed) = (&mut self.standing[slot], &mut self.passed[slot]);
        let value = &mut self.log_odds[slot];
        let before = if value.is_nan() { 0.0 } else { *value };
        let after = match mark {
            Mark::Unseen => return,
            Mark::Free(heights) => {
                *passed = passed.joined(heights);
                // A planar beam may pass between the legs of what other sensors saw whole.
                let blind = if planar { !standing.within(heights) } else { !standing.meet(heights) };
                if *standing != Heights::NONE && blind {
                    return;
                }
                before + params.free_log_odds
            }
            Mark::Hit(heights) => {
                let news = !passed.meet(heights);
                *standing = standing.joined(heights);
                *passed = passed.without(heights);
                params.hit_log_odds + if news { before.max(params.free_log_odds) } else { before }
            }
        };
        *value = after.clamp(params.min_log_odds, params.max_log_odds);
        if *value <= 0.0 {
            *standing = Heights::NONE;
        }
    }
}

/// Unbounded 2D occupancy in the map frame: log-odds by cell, unknown where no beam has been.
///
/// Cell (0, 0) has its lower-left corner at the geometry's origin: (0, 0) for maps built here, the rectangle's
/// for imported ones. Cloning costs one reference; a clone never sees later changes.
/// Source: Moravec and Elfes, "High resolution maps from wide angle sonar", 1985; clamping as in Yguel et al. 2007.
#[derive(Debug, Clone)]
pub struct OccupancyGrid {
    params: OccupancyParams,
    geometry: GridGeometry,
    tiles: Arc<BTreeMap<(i32, i32), Arc<Tile>>>,
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
        Ok(Self { params, geometry, tiles: Arc::default(), bounds: None })
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
            Arc::make_mut(tiles.entry(key).or_insert_with(unknown_tile)).log_odds[slot] = log_odds;
            grow(&mut grid.bounds, cell);
        }
        Ok(grid)
    }

    /// Parameters.
    pub fn params(&self) -> &OccupancyParams {
        &self.params
    }

    /// The only world-to-cell arithmetic of this grid.
    pub fn geometry(&self) -> &GridGeometry {
        &self.geometry
    }

    /// Adds what a keyframe saw from `t_map_base`: see [`ScanUpdate::new`].
    ///
    /// # Errors
    /// `PoseNotFinite`; `Scan` if the channels do not fit the points or the height is not finite.
    pub fn integrate(&mut self, t_map_base: &Pose, scan: &KeyframeScan) -> Result<(), MappingError> {
        check_keyframe(t_map_base, scan)?;
        let update = ScanUpdate::new(&self.params, &self.geometry, t_map_base, scan);
        self.apply(&update);
        Ok(())
    }

    /// Adds an update made with this grid's parameters and geometry.
    pub fn apply(&mut self, update: &ScanUpdate) {
        if update.width == 0 {
            return;
        }
        let last = update.width as i32 - 1;
        let ((tx0, ty0), _) = locate(update.min);
        let ((tx1, ty1), _) = locate(Cell::new(update.min.x + last, update.min.y + last));
        let tiles = Arc::make_mut(&mut self.tiles);
        for key in (ty0..=ty1).flat_map(|ty| (tx0..=tx1).map(move |tx| (tx, ty))) {
            let (x0, x1) = overlap(key.0, update.min.x, update.width);
            let (y0, y1) = overlap(key.1, update.min.y, update.width);
            let row = |y: usize| &update.marks[y * update.width + x0..y * update.width + x1];
            if (y0..y1).all(|y| row(y).iter().all(|m| *m == Mark::Unseen)) {
                continue;
            }
            let tile = Arc::make_mut(tiles.entry(key).or_insert_with(unknown_tile));
            for y in y0..y1 {
                for (x, mark) in (x0..x1).zip(row(y)).filter(|(_, m)| **m != Mark::Unseen) {
                    let cell = Cell::new(update.min.x + x as i32, update.min.y + y as i32);
                    let slot = locate(cell).1;
                    tile.update(slot, *mark, update.planar, &self.params);
                    grow(&mut self.bounds, cell);
                }
            }
        }
    }

    /// Log-odds of a cell; none where nothing was seen.
    pub fn log_odds(&self, cell: Cell) -> Option<f32> {
        let (key, slot) = locate(cell);
        self.tiles.get(&key).map(|tile| tile.log_odds[slot]).filter(|v| !v.is_nan())
    }

    /// Probability that a cell is occupied; none where nothing was seen.
    pub fn probability(&self, cell: Cell) -> Option<f64> {
        self.log_odds(cell).map(probability)
    }

    /// Smallest and largest column and row with a known cell, both included; none if all is unknown.
    pub fn bounds(&self) -> Option<(Cell, Cell)> {
        self.bounds
    }

    /// What its tiles take, bytes.
    pub fn memory_bytes(&self) -> usize {
        self.tiles.len() * size_of::<Tile>()
    }

    /// Whether nothing is known.
    pub fn is_empty(&self) -> bool {
        self.bounds.is_none()
    }

    /// Number of known cells.
    pub fn num_known(&self) -> usize {
        self.tiles.values().map(|t| t.log_odds.iter().filter(|v| !v.is_nan()).count()).sum()
    }

    /// All that is known, as a rectangle of ROS values (0 x 0 if nothing is).
    ///
    /// # Errors
    /// `RegionTooLarge` if it has more than `max_cells` cells.
    pub fn dense(&self, max_cells: usize) -> Result<DenseGrid, MappingError> {
        match self.bounds {
            Some((min, max)) => self.region(min, max, max_cells),
            None => Ok(DenseGrid { geometry: self.geometry, width: 0, height: 0, cells: Vec::new() }),
        }
    }

    /// The rectangle from cell `min` to cell `max`, both included.
    ///
    /// # Errors
    /// `RegionEmpty`, or `RegionTooLarge` if it has more than `max_cells` cells.
    pub fn region(&self, min: Cell, max: Cell, max_cells: usize) -> Result<DenseGrid, MappingError> {
        let size = |a: i32, b: i32| u64::try_from(i64::from(b) - i64::from(a) + 1).unwrap_or(0);
        let (width, height) = (size(min.x, max.x), size(min.y, max.y));
        if width == 0 || height == 0 {
            return Err(MappingError::RegionEmpty);
        }
        let cells = width.saturating_mul(height);
        if cells > max_cells as u64 {
            return Err(MappingError::RegionTooLarge { cells, limit: max_cells as u64 });
        }
        let (width, height) = (width as usize, height as usize);
        let mut out = vec![-1i8; width * height];
        let (low, high) = (locate(min).0, locate(max).0);
        let inside = |key: &(i32, i32)| key.0 >= low.0 && key.0 <= high.0 && key.1 >= low.1 && key.1 <= high.1;
        for (key, tile) in self.tiles.iter().filter(|(key, _)| inside(key)) {
            let (x0, x1) = overlap(key.0, min.x, width);
            let (y0, y1) = overlap(key.1, min.y, height);
            for y in y0..y1 {
                for x in x0..x1 {
                    let value = tile.log_odds[locate(Cell::new(min.x + x as i32, min.y + y as i32)).1];
                    if !value.is_nan() {
                        out[y * width + x] = (100.0 * probability(value)).round() as i8;
                    }
                }
            }
        }
        let geometry = GridGeometry::new(self.geometry.resolution_m, self.geometry.corner(min));
        Ok(DenseGrid { geometry, width, height, cells: out })
    }
}

/// Equal in geometry and in the bytes of every cell.
impl PartialEq for OccupancyGrid {
    fn eq(&self, other: &Self) -> bool {
        let same = |a: &Tile, b: &Tile| {
            let cells = a.log_odds.iter().zip(&b.log_odds);
            cells.map(|(x, y)| (x.to_bits(), y.to_bits())).all(|(x, y)| x == y)
                && a.standing == b.standing
                && a.passed == b.passed
        };
        self.geometry == other.geometry
            && self.tiles.len() == other.tiles.len()
            && self.tiles.iter().zip(other.tiles.iter()).all(|((ka, a), (kb, b))| ka == kb && same(a, b))
    }
}

fn probability(log_odds: f32) -> f64 {
    1.0 / (1.0 + (-f64::from(log_odds)).exp())
}

fn unknown_tile() -> Arc<Tile> {
    Arc::new(Tile {
        log_odds: [f32::NAN; TILE_CELLS],
        standing: [Heights::NONE; TILE_CELLS],
        passed: [Heights::NONE; TILE_CELLS],
    })
}

/// Tile of a cell, and its place there.
fn locate(cell: Cell) -> ((i32, i32), usize) {
    let slot = cell.y.rem_euclid(TILE) * TILE + cell.x.rem_euclid(TILE);
    ((cell.x.div_euclid(TILE), cell.y.div_euclid(TILE)), slot as usize)
}

/// The part of a window of `size` cells from `min` that lies in a tile, along one axis, as window indices.
fn overlap(tile: i32, min: i32, size: usize) -> (usize, usize) {
    let start = i64::from(tile) * i64::from(TILE) - i64::from(min);
    let end = start + i64::from(TILE);
    (start.clamp(0, size as i64) as usize, end.clamp(0, size as i64) as usize)
}

fn grow(bounds: &mut Option<(Cell, Cell)>, cell: Cell) {
    let (min, max) = bounds.get_or_insert((cell, cell));
    *min = Cell::new(min.x.min(cell.x), min.y.min(cell.y));
    *max = Cell::new(max.x.max(cell.x), max.y.max(cell.y));
}
