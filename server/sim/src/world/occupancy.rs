//! True occupancy of the plane.

use crate::solid::{Shape, Solid};
use crate::texture::Pattern;
use nalgebra::{Point2, Point3, Vector2};
use percept_geometry::{Cell, GridGeometry};

/// Which cells hold something that stands still.
#[derive(Debug, Clone, PartialEq)]
pub struct TrueOccupancy {
    /// Where the grid lies in the world.
    pub geometry: GridGeometry,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// `height x width`, row-major, row 0 at the smallest y: whether anything reaches into the cell.
    pub cells: Vec<bool>,
}

impl TrueOccupancy {
    /// Whether the cell is occupied; none outside of the grid.
    pub fn at(&self, cell: Cell) -> Option<bool> {
        let (x, y) = (usize::try_from(cell.x).ok()?, usize::try_from(cell.y).ok()?);
        (x < self.width && y < self.height).then(|| self.cells[y * self.width + x])
    }

    /// Whether the cell that holds a world point (m) is occupied; none outside of the grid.
    pub fn at_point(&self, p: &Point2<f64>) -> Option<bool> {
        self.at(self.geometry.cell(p)?)
    }

    /// Marks every cell that the solids reach into between the heights of `band`, metres.
    pub(crate) fn of(solids: &[Solid], resolution_m: f64, band: (f64, f64), size: Vector2<f64>) -> Self {
        // One cell of margin around the outer walls.
        let geometry = GridGeometry::new(resolution_m, Point2::new(-resolution_m, -resolution_m));
        let (width, height) =
            ((size.x / resolution_m).ceil() as usize + 2, (size.y / resolution_m).ceil() as usize + 2);
        let mut out = Self { geometry, width, height, cells: vec![false; width * height] };
        for solid in solids {
            let bounds = solid.shape.bounds();
            let level = matches!(solid.material.pattern, Pattern::Floor | Pattern::Ceiling);
            if !level && bounds.max.z > band.0 && bounds.min.z < band.1 {
                out.mark(solid);
            }
        }
        out
    }

    fn mark(&mut self, solid: &Solid) {
        let bounds = solid.world_bounds();
        let (Some(low), Some(high)) = (self.geometry.cell(&bounds.min.xy()), self.geometry.cell(&bounds.max.xy()))
        else {
            return;
        };
        for y in low.y.max(0)..=high.y.min(self.height as i32 - 1) {
            for x in low.x.max(0)..=high.x.min(self.width as i32 - 1) {
                let center = self.geometry.center(Cell::new(x, y));
                if reaches(solid, &center, 0.5 * self.geometry.resolution_m) {
                    self.cells[y as usize * self.width + x as usize] = true;
                }
            }
        }
    }
}

/// Whether the footprint of a solid overlaps the axis-aligned square of this half edge.
fn reaches(solid: &Solid, center: &Point2<f64>, half: f64) -> bool {
    let local = solid.frame.to_local(&Point3::new(center.x, center.y, 0.0)).xy();
    match solid.shape {
        Shape::Box { min, max } => {
            // Separating axes: those of the square, then those of the box.
            let bounds = solid.world_bounds();
            let turned = solid.frame.vector_to_local(&nalgebra::Vector3::x());
            let reach = half * (turned.x.abs() + turned.y.abs());
            center.x + half > bounds.min.x
                && center.x - half < bounds.max.x
                && center.y + half > bounds.min.y
                && center.y - half < bounds.max.y
                && local.x + reach > min.x
                && local.x - reach < max.x
                && local.y + reach > min.y
                && local.y - reach < max.y
        }
        Shape::Cylinder { x, y, radius, .. } | Shape::Capsule { x, y, radius, .. } => {
            let axis = solid.frame.xy_to_world(&Point2::new(x, y));
            let gap = (axis - center).map(|c| (c.abs() - half).max(0.0));
            gap.norm() < radius
        }
    }
}
