//! A grid of occupancy, whoever holds it.

use crate::{MAX_CELLS, PictureError};
use percept_formats::GridMap;
use percept_geometry::GridGeometry;
use percept_mapping::DenseGrid;

/// A rectangle of cells, borrowed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GridView<'a> {
    /// Cell (0, 0)'s lower left corner in the map frame, and the edge of a cell.
    pub geometry: GridGeometry,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// `H x W`, row-major, row 0 at the smallest y: -1 unknown, 0 free to 100 occupied.
    pub cells: &'a [i8],
}

impl<'a> From<&'a DenseGrid> for GridView<'a> {
    fn from(grid: &'a DenseGrid) -> Self {
        Self { geometry: grid.geometry, width: grid.width, height: grid.height, cells: &grid.cells }
    }
}

impl<'a> From<&'a GridMap> for GridView<'a> {
    fn from(grid: &'a GridMap) -> Self {
        Self { geometry: grid.geometry, width: grid.width, height: grid.height, cells: &grid.cells }
    }
}

impl GridView<'_> {
    /// Checks shape and numbers.
    ///
    /// # Errors
    /// `GridTooLarge`, `ShapeMismatch`, `OutOfRange`.
    pub(crate) fn check(&self) -> Result<(), PictureError> {
        check_shape(&self.geometry, self.width, self.height, &[("cells", self.cells.len())])
    }

    /// The cell at a column and row; unknown beyond the border.
    pub(crate) fn at(&self, x: i64, y: i64) -> i8 {
        let inside = x >= 0 && y >= 0 && x < self.width as i64 && y < self.height as i64;
        if inside { self.cells[y as usize * self.width + x as usize] } else { -1 }
    }
}

/// Whether buffers hold a value for each cell, and the geometry has numbers that can be drawn.
pub(crate) fn check_shape(
    geometry: &GridGeometry,
    width: usize,
    height: usize,
    buffers: &[(&'static str, usize)],
) -> Result<(), PictureError> {
    let cells = width.checked_mul(height).filter(|cells| *cells <= MAX_CELLS);
    // A strip that is long and narrow has few cells, and yet no sensible picture.
    let Some(cells) = cells.filter(|_| width.max(height) <= MAX_CELLS >> 8) else {
        return Err(PictureError::GridTooLarge { width, height });
    };
    if let Some(&(field, actual)) = buffers.iter().find(|(_, actual)| *actual != cells) {
        return Err(PictureError::ShapeMismatch { field, expected: cells, actual });
    }
    let resolution = geometry.resolution_m;
    if !(resolution.is_finite() && (1e-6..=1e6).contains(&resolution)) {
        let requirement = "between 1e-6 and 1e6";
        return Err(PictureError::OutOfRange { field: "resolution_m", value: resolution, requirement });
    }
    match [geometry.origin.x, geometry.origin.y].into_iter().find(|v| v.is_nan() || v.abs() > 1e9) {
        Some(value) => Err(PictureError::OutOfRange { field: "origin", value, requirement: "within 1e9 of zero" }),
        None => Ok(()),
    }
}
