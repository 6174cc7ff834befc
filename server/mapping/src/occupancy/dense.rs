//! A rectangle of cells in ROS's values.

use crate::MappingError;
use percept_geometry::{Cell, GridGeometry};

/// A rectangle of occupancy: `nav_msgs/OccupancyGrid` without the message.
#[derive(Debug, Clone, PartialEq)]
pub struct DenseGrid {
    /// Origin: lower-left corner of cell (0, 0) of this rectangle, in the map frame.
    pub geometry: GridGeometry,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Row-major `height x width`, row 0 at the smallest y; -1 unknown, else 100 times the probability of being
    /// occupied, rounded.
    pub cells: Vec<i8>,
}

impl DenseGrid {
    /// Checks shape and values.
    ///
    /// # Errors
    /// `GridShape`, `CellValue`, or `InvalidParam` for a resolution that is not positive or an origin not finite.
    pub fn new(geometry: GridGeometry, width: usize, height: usize, cells: Vec<i8>) -> Result<Self, MappingError> {
        let grid = Self { geometry, width, height, cells };
        grid.validate()?;
        Ok(grid)
    }

    /// Checks shape and values.
    ///
    /// # Errors
    /// As [`DenseGrid::new`].
    pub fn validate(&self) -> Result<(), MappingError> {
        let bad = |field, value, remedy| Err(MappingError::InvalidParam { field, value, remedy });
        let resolution = self.geometry.resolution_m;
        if !(resolution.is_finite() && resolution > 0.0) {
            return bad("resolution_m", resolution, "choose a positive number of metres");
        }
        if let Some(&value) = self.geometry.origin.iter().find(|v| !v.is_finite()) {
            return bad("origin", value, "give a finite origin");
        }
        let (width, height) = (self.width, self.height);
        let fits = |n: usize| n <= i32::MAX as usize;
        if width.checked_mul(height) != Some(self.cells.len()) || !fits(width) || !fits(height) {
            return Err(MappingError::GridShape { width, height, cells: self.cells.len() });
        }
        match self.cells.iter().position(|v| !(-1..=100).contains(v)) {
            Some(index) => Err(MappingError::CellValue { index, value: self.cells[index] }),
            None => Ok(()),
        }
    }

    /// Row-major index of a cell of this rectangle; none outside.
    pub fn index(&self, cell: Cell) -> Option<usize> {
        let (x, y) = (usize::try_from(cell.x).ok()?, usize::try_from(cell.y).ok()?);
        (x < self.width && y < self.height).then(|| y * self.width + x)
    }

    /// Value of a cell: `Some(None)` unknown, `Some(Some(0..=100))` known; none outside the rectangle.
    pub fn value(&self, cell: Cell) -> Option<Option<u8>> {
        Some(u8::try_from(self.cells[self.index(cell)?]).ok())
    }
}
