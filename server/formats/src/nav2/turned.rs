//! A map with a turned origin, laid out along the axes of its frame.

use super::GridMap;
use crate::{FormatError, Limits};
use nalgebra::{Point2, Rotation2, Vector2};
use percept_geometry::GridGeometry;

/// Places within a cell that are looked up, cells: no wall of one cell slips between them, whatever the angle.
const PLACES: [(f64, f64); 4] = [(0.25, 0.25), (0.75, 0.25), (0.25, 0.75), (0.75, 0.75)];

/// The smallest map along the axes that holds `map`, turned by `yaw_rad` about its lower-left corner.
///
/// A cell takes the largest value that lies at one of four places in it; where there is none it is unknown.
pub(super) fn along_axes(map: &GridMap, yaw_rad: f64, limits: &Limits) -> Result<GridMap, FormatError> {
    let turn = Rotation2::new(yaw_rad);
    let (w, h) = (map.width as f64, map.height as f64);
    let corners = [(0.0, 0.0), (w, 0.0), (0.0, h), (w, h)].map(|(x, y)| turn * Point2::new(x, y));
    let [low, high] = [Point2::inf, Point2::sup].map(|f| corners[1..].iter().fold(corners[0], |a, b| f(&a, b)));
    // A quarter of a turn is not to grow the map by its rounding.
    let size = (high - low).map(|v| (v - 1e-6).ceil().max(0.0));
    let num_cells = limits.pixels(size.x as u64, size.y as u64)?;
    let (width, height) = (size.x as usize, size.y as usize);
    let back = turn.inverse();
    let value = |x: f64, y: f64| {
        let p = back * (low + Vector2::new(x, y));
        let inside = (0.0..w).contains(&p.x) && (0.0..h).contains(&p.y);
        if inside { map.cells[p.y as usize * map.width + p.x as usize] } else { -1 }
    };
    let mut cells = Vec::with_capacity(num_cells);
    for y in 0..height {
        cells.extend((0..width).map(|x| {
            let values = PLACES.map(|(dx, dy)| value(x as f64 + dx, y as f64 + dy));
            values.into_iter().fold(-1, i8::max)
        }));
    }
    let origin = map.geometry.origin + low.coords * map.geometry.resolution_m;
    Ok(GridMap { geometry: GridGeometry::new(map.geometry.resolution_m, origin), width, height, cells })
}
