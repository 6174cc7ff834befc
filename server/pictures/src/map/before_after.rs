//! Two grids of one place: what appeared, what has gone.

use super::{CellLayout, GridView, check_shape};
use crate::PictureError;
use crate::colors::{Color, FREE, GREEN, RED, SKY, UNKNOWN};
use crate::sheet::{Entry, Sheet, Swatch};
use nalgebra::Point2;
use percept_geometry::{Cell, GridGeometry, RgbImage};
use rayon::prelude::*;

/// At or above this a cell is occupied, per cent: as for planning.
const OCCUPIED_FROM: i8 = 60;
/// At or below this it is free; between them nothing is said about it.
const FREE_TO: i8 = 40;
/// The farthest that walls may be off, cells.
const MAX_TOLERANCE_CELLS: f64 = 10.0;

/// Cells that changed, and their area.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Changes {
    /// Free before, occupied after.
    pub num_appeared: usize,
    /// Occupied before, free after.
    pub num_gone: usize,
    /// Unknown before, occupied after: it may have been there all the time.
    pub num_newly_seen: usize,
    /// Area of a cell that was compared, square metres.
    pub cell_area_m2: f64,
}

/// What has become of a cell.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
enum Change {
    Unknown,
    Free,
    Stayed,
    Newly,
    Gone,
    Appeared,
}

impl Change {
    fn color(self) -> Color {
        match self {
            Self::Unknown => UNKNOWN,
            Self::Free => FREE,
            Self::Stayed => [84, 86, 92],
            Self::Newly => SKY,
            Self::Gone => RED,
            Self::Appeared => GREEN,
        }
    }
}

/// Both grids over each other by their geometries, cells of the finer one: green has appeared, red has gone, sky blue was not known
/// before. What lies within `tolerance_m` of something that was there in the other grid has not changed (walls waver by a cell).
/// The counts stand in the picture and come back beside it.
///
/// # Errors
/// `GridTooLarge` also if both together span too much; `ShapeMismatch`, `OutOfRange`.
pub fn before_after<'a, 'b>(
    before: impl Into<GridView<'a>>,
    after: impl Into<GridView<'b>>,
    tolerance_m: f64,
    title: &str,
) -> Result<(RgbImage, Changes), PictureError> {
    let (before, after) = (before.into(), after.into());
    before.check()?;
    after.check()?;
    let (geometry, width, height) = union(&before, &after)?;
    let radius = tolerance_m / geometry.resolution_m;
    if !(0.0..=MAX_TOLERANCE_CELLS).contains(&radius) {
        let requirement = "between 0 and ten cells";
        return Err(PictureError::OutOfRange { field: "tolerance_m", value: tolerance_m, requirement });
    }
    let compared = Compared { before, after, geometry, radius: radius.round() as i64 };
    let cells: Vec<Change> = (0..width * height).into_par_iter().map(|i| compared.at(i % width, i / width)).collect();
    let count = |change: Change| cells.par_iter().filter(|c| **c == change).count();
    let changes = Changes {
        num_appeared: count(Change::Appeared),
        num_gone: count(Change::Gone),
        num_newly_seen: count(Change::Newly),
        cell_area_m2: geometry.resolution_m * geometry.resolution_m,
    };
    let layout = CellLayout::new(geometry, width, height);
    let sheet = sheet(&changes, &cells, title, layout.detail());
    // Of cells that share a pixel, what changed is seen.
    let color = |block: &super::Block| {
        let most = block.cells(width).map(|i| cells[i]).max_by_key(|c| *c as u8);
        most.unwrap_or(Change::Unknown).color()
    };
    let (mut opened, window) = layout.open(sheet, color);
    opened.canvas.clip(None);
    opened.finish(&window);
    Ok((opened.canvas.into_image()?, changes))
}

/// The lattice of the finer grid (of equal ones, that of `after`) around both.
fn union(before: &GridView<'_>, after: &GridView<'_>) -> Result<(GridGeometry, usize, usize), PictureError> {
    let grids: Vec<&GridView<'_>> = [after, before].into_iter().filter(|g| g.width > 0 && g.height > 0).collect();
    let finest = grids.iter().copied().min_by(|a, b| a.geometry.resolution_m.total_cmp(&b.geometry.resolution_m));
    let Some(finest) = finest else { return Ok((after.geometry, 0, 0)) };
    let (resolution, origin) = (finest.geometry.resolution_m, finest.geometry.origin);
    let mut ranges = [(f64::INFINITY, f64::NEG_INFINITY); 2];
    for grid in grids {
        let cells = [grid.width as f64, grid.height as f64];
        for (i, range) in ranges.iter_mut().enumerate() {
            let low = (grid.geometry.origin[i] - origin[i]) / resolution;
            let high = low + cells[i] * grid.geometry.resolution_m / resolution;
            // A thousandth of a cell is rounding, not another column.
            *range = (range.0.min((low + 1e-3).floor()), range.1.max((high - 1e-3).ceil()));
        }
    }
    let size = ranges.map(|(low, high)| (high - low).clamp(0.0, 1e12) as usize);
    let corner = Point2::new(origin.x + ranges[0].0 * resolution, origin.y + ranges[1].0 * resolution);
    let geometry = GridGeometry::new(resolution, corner);
    check_shape(&geometry, size[0], size[1], &[])?;
    Ok((geometry, size[0], size[1]))
}

struct Compared<'a, 'b> {
    before: GridView<'a>,
    after: GridView<'b>,
    geometry: GridGeometry,
    radius: i64,
}

impl Compared<'_, '_> {
    fn at(&self, x: usize, y: usize) -> Change {
        let p = self.geometry.center(Cell::new(x as i32, y as i32));
        let cell = |grid: &GridView<'_>| grid.geometry.cell(&p).map_or((-1, -1), |c| (i64::from(c.x), i64::from(c.y)));
        let (b, a) = (cell(&self.before), cell(&self.after));
        let (before, after) = (self.before.at(b.0, b.1), self.after.at(a.0, a.1));
        let near = |grid: &GridView<'_>, at: (i64, i64)| {
            let cells = (self.radius as f64 * self.geometry.resolution_m / grid.geometry.resolution_m).round() as i64;
            (-cells..=cells).any(|dy| (-cells..=cells).any(|dx| grid.at(at.0 + dx, at.1 + dy) >= OCCUPIED_FROM))
        };
        match (before, after) {
            (OCCUPIED_FROM.., 0..=FREE_TO) if !near(&self.after, a) => Change::Gone,
            (0..=FREE_TO, OCCUPIED_FROM..) if !near(&self.before, b) => Change::Appeared,
            (..0, OCCUPIED_FROM..) if !near(&self.before, b) => Change::Newly,
            (_, OCCUPIED_FROM..) => Change::Stayed,
            (OCCUPIED_FROM.., ..0) => Change::Stayed,
            (..0, ..0) => Change::Unknown,
            _ => Change::Free,
        }
    }
}

fn sheet(changes: &Changes, cells: &[Change], title: &str, detail: String) -> Sheet {
    let entries = [
        (Change::Appeared, "appeared"),
        (Change::Gone, "gone"),
        (Change::Newly, "occupied, new to us"),
        (Change::Stayed, "occupied as before"),
        (Change::Free, "free"),
        (Change::Unknown, "unknown"),
    ];
    let there = entries.into_iter().filter(|(change, _)| cells.contains(change));
    let legend = there.map(|(change, words)| Entry::new(Swatch::Fill(change.color()), words)).collect();
    let said =
        |words: &str, count: usize| format!("{words} {count}, {:.2} m\u{b2}", count as f64 * changes.cell_area_m2);
    let mut notes = vec!["cells and their area:".to_owned()];
    notes.extend([said("appeared", changes.num_appeared), said("gone", changes.num_gone)]);
    if changes.num_newly_seen > 0 {
        notes.push(said("new to us", changes.num_newly_seen));
    }
    Sheet { title: title.to_owned(), detail, legend, notes, ..Sheet::default() }
}
