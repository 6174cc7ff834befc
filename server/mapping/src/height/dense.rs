//! A rectangle of heights.

use super::compose::geometry;
use super::{HeightCell, HeightMap};
use crate::MappingError;
use crate::occupancy::{locate, overlap};
use percept_geometry::{Cell, GridGeometry};

/// Which storey is read of a cell that has several.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Storey {
    /// The lowest.
    Lowest,
    /// The highest.
    Highest,
    /// That whose ground is nearest to where a robot stands, if it is near enough.
    Near {
        /// Height, map frame, metres.
        z_m: f64,
        /// Ground that is higher or lower by more is not read, metres: hills rise by so much, and storeys are farther apart.
        within_m: f64,
    },
}

/// A rectangle of heights of one storey a cell.
#[derive(Debug, Clone, PartialEq)]
pub struct DenseHeights {
    /// Origin: lower-left corner of cell (0, 0) of this rectangle, in the map frame.
    pub geometry: GridGeometry,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Height of the ground, row-major `height x width`, row 0 at the smallest y, map frame, metres; NaN where it was not seen.
    pub ground_m: Vec<f32>,
    /// Its standard deviation, in the same order, metres; NaN where it was not seen.
    pub sigma_m: Vec<f32>,
    /// Highest of what stands on the ground, no higher than the robot's clearance, in the same order, map frame, metres; NaN for nothing.
    pub top_m: Vec<f32>,
    /// Lowest of what hangs above the robot's clearance, in the same order, map frame, metres; NaN for nothing.
    pub overhang_m: Vec<f32>,
    /// Keyframes that saw the ground, in the same order.
    pub num_keyframes: Vec<u16>,
    /// Where a drop was seen instead of ground, in the same order.
    pub is_drop: Vec<bool>,
}

impl Storey {
    fn of<'a>(self, mut storeys: impl Iterator<Item = &'a HeightCell>) -> Option<&'a HeightCell> {
        match self {
            Self::Lowest => storeys.next(),
            Self::Highest => storeys.last(),
            Self::Near { z_m, within_m } => {
                let off = |cell: &HeightCell| (f64::from(cell.level_m) - z_m).abs();
                storeys.filter(|cell| off(cell) <= within_m).min_by(|a, b| off(a).total_cmp(&off(b)))
            }
        }
    }
}

impl DenseHeights {
    fn unknown(geometry: GridGeometry, width: usize, height: usize) -> Self {
        let nothing = || vec![f32::NAN; width * height];
        Self {
            geometry,
            width,
            height,
            ground_m: nothing(),
            sigma_m: nothing(),
            top_m: nothing(),
            overhang_m: nothing(),
            num_keyframes: vec![0; width * height],
            is_drop: vec![false; width * height],
        }
    }

    fn set(&mut self, index: usize, cell: &HeightCell) {
        self.ground_m[index] = cell.ground_m;
        self.sigma_m[index] = cell.sigma_m;
        self.top_m[index] = cell.top_m;
        self.overhang_m[index] = cell.overhang_m;
        self.num_keyframes[index] = cell.num_keyframes;
        self.is_drop[index] = cell.is_drop;
    }

    /// Row-major index of a cell of this rectangle; none outside.
    pub fn index(&self, cell: Cell) -> Option<usize> {
        let (x, y) = (usize::try_from(cell.x).ok()?, usize::try_from(cell.y).ok()?);
        (x < self.width && y < self.height).then(|| y * self.width + x)
    }
}

impl HeightMap {
    /// The only world-to-cell arithmetic of this map.
    pub fn geometry(&self) -> GridGeometry {
        geometry(self.params())
    }

    /// Smallest and largest column and row with a known cell, both included; none if nothing is known.
    pub fn bounds(&self) -> Option<(Cell, Cell)> {
        let tiles = self.tiles(self.tile_keys());
        tiles.iter().map(|(_, tile)| tile.bounds).reduce(|a, b| {
            let min = Cell::new(a.0.x.min(b.0.x), a.0.y.min(b.0.y));
            (min, Cell::new(a.1.x.max(b.1.x), a.1.y.max(b.1.y)))
        })
    }

    /// All that is known (0 x 0 if nothing is).
    ///
    /// # Errors
    /// `RegionTooLarge` if it has more than `max_cells` cells.
    pub fn dense(&self, storey: Storey, max_cells: usize) -> Result<DenseHeights, MappingError> {
        match self.bounds() {
            Some((min, max)) => self.region(min, max, storey, max_cells),
            None => Ok(DenseHeights::unknown(self.geometry(), 0, 0)),
        }
    }

    /// The rectangle from cell `min` to cell `max`, both included.
    ///
    /// # Errors
    /// `RegionEmpty`, or `RegionTooLarge` if it has more than `max_cells` cells.
    pub fn region(&self, min: Cell, max: Cell, storey: Storey, max_cells: usize) -> Result<DenseHeights, MappingError> {
        let size = |a: i32, b: i32| u64::try_from(i64::from(b) - i64::from(a) + 1).unwrap_or(0);
        let (width, height) = (size(min.x, max.x), size(min.y, max.y));
        if width == 0 || height == 0 {
            return Err(MappingError::RegionEmpty);
        }
        let cells = width.saturating_mul(height);
        if cells > max_cells as u64 {
            return Err(MappingError::RegionTooLarge { cells, limit: max_cells as u64 });
        }
        let geometry = GridGeometry::new(self.geometry().resolution_m, self.geometry().corner(min));
        let mut out = DenseHeights::unknown(geometry, width as usize, height as usize);
        for (key, tile) in self.tiles(self.tile_keys_within(locate(min).0, locate(max).0)) {
            let (x0, x1) = overlap(key.0, min.x, out.width);
            let (y0, y1) = overlap(key.1, min.y, out.height);
            for (x, y) in (y0..y1).flat_map(|y| (x0..x1).map(move |x| (x, y))) {
                let slot = locate(Cell::new(min.x + x as i32, min.y + y as i32)).1;
                if let Some(cell) = storey.of(tile.storeys(slot)) {
                    out.set(y * out.width + x, cell);
                }
            }
        }
        Ok(out)
    }
}
