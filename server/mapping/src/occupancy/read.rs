//! How grids of occupancy are read, whatever they are made of.

use super::DenseGrid;
use crate::MappingError;
use percept_geometry::{Cell, GridGeometry};

/// Edge of a tile, cells.
pub(crate) const TILE: i32 = 64;

/// Is shown a tile's column and row, and the log-odds of its cells by slot.
pub type Visit<'a> = &'a mut dyn FnMut((i32, i32), &dyn Fn(usize) -> f32);

/// Reads an unbounded 2D grid of occupancy: one submap's, or that of a whole map.
pub trait Occupancy {
    /// The only world-to-cell arithmetic of this grid.
    fn geometry(&self) -> GridGeometry;

    /// Smallest and largest column and row with a known cell, both included; none if all is unknown.
    fn bounds(&self) -> Option<(Cell, Cell)>;

    /// Shows the tiles from `low` to `high`, both included, in which something may be known: the tile's column and row,
    /// and the log-odds of each of its cells by slot (row-major `64 x 64`), NaN where nothing was seen.
    fn visit(&self, low: (i32, i32), high: (i32, i32), visit: Visit<'_>);

    /// Log-odds of a cell; none where nothing was seen.
    fn log_odds(&self, cell: Cell) -> Option<f32> {
        let (key, slot) = locate(cell);
        let mut out = f32::NAN;
        self.visit(key, key, &mut |_, at| out = at(slot));
        Some(out).filter(|v| !v.is_nan())
    }

    /// Probability that a cell is occupied; none where nothing was seen.
    fn probability(&self, cell: Cell) -> Option<f64> {
        self.log_odds(cell).map(probability)
    }

    /// Whether nothing is known.
    fn is_empty(&self) -> bool {
        self.bounds().is_none()
    }

    /// Number of known cells.
    fn num_known(&self) -> usize {
        let Some((min, max)) = self.bounds() else { return 0 };
        let mut known = 0;
        self.visit(locate(min).0, locate(max).0, &mut |_, at| {
            known += (0..(TILE * TILE) as usize).filter(|slot| !at(*slot).is_nan()).count();
        });
        known
    }

    /// All that is known, as a rectangle of ROS values (0 x 0 if nothing is).
    ///
    /// # Errors
    /// `RegionTooLarge` if it has more than `max_cells` cells.
    fn dense(&self, max_cells: usize) -> Result<DenseGrid, MappingError> {
        match self.bounds() {
            Some((min, max)) => self.region(min, max, max_cells),
            None => Ok(DenseGrid { geometry: self.geometry(), width: 0, height: 0, cells: Vec::new() }),
        }
    }

    /// The rectangle from cell `min` to cell `max`, both included.
    ///
    /// # Errors
    /// `RegionEmpty`, or `RegionTooLarge` if it has more than `max_cells` cells.
    fn region(&self, min: Cell, max: Cell, max_cells: usize) -> Result<DenseGrid, MappingError> {
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
        self.visit(locate(min).0, locate(max).0, &mut |key, at| {
            let (x0, x1) = overlap(key.0, min.x, width);
            let (y0, y1) = overlap(key.1, min.y, height);
            for y in y0..y1 {
                for x in x0..x1 {
                    let value = at(locate(Cell::new(min.x + x as i32, min.y + y as i32)).1);
                    if !value.is_nan() {
                        out[y * width + x] = (100.0 * probability(value)).round() as i8;
                    }
                }
            }
        });
        let geometry = GridGeometry::new(self.geometry().resolution_m, self.geometry().corner(min));
        Ok(DenseGrid { geometry, width, height, cells: out })
    }
}

fn probability(log_odds: f32) -> f64 {
    1.0 / (1.0 + (-f64::from(log_odds)).exp())
}

/// Tile of a cell, and its place there.
pub(crate) fn locate(cell: Cell) -> ((i32, i32), usize) {
    let slot = cell.y.rem_euclid(TILE) * TILE + cell.x.rem_euclid(TILE);
    ((cell.x.div_euclid(TILE), cell.y.div_euclid(TILE)), slot as usize)
}

/// The part of a window of `size` cells from `min` that lies in a tile, along one axis, as window indices.
pub(crate) fn overlap(tile: i32, min: i32, size: usize) -> (usize, usize) {
    let start = i64::from(tile) * i64::from(TILE) - i64::from(min);
    let end = start + i64::from(TILE);
    (start.clamp(0, size as i64) as usize, end.clamp(0, size as i64) as usize)
}
