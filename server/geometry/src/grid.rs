//! Cells and voxels: the only place where world coordinates become indices.

use nalgebra::{Point2, Point3};
use serde::{Deserialize, Serialize};

/// A cell of a 2D grid: `x` is the column, `y` the row; row 0 is at the smallest y.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct Cell {
    /// Column.
    pub x: i32,
    /// Row.
    pub y: i32,
}

impl Cell {
    /// Column `x`, row `y`.
    pub const fn new(x: i32, y: i32) -> Self {
        Self { x, y }
    }
}

/// A voxel of a 3D grid.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Voxel {
    /// Index along x.
    pub x: i32,
    /// Index along y.
    pub y: i32,
    /// Index along z.
    pub z: i32,
}

impl Voxel {
    /// Indices along x, y, z.
    pub const fn new(x: i32, y: i32, z: i32) -> Self {
        Self { x, y, z }
    }

    /// The voxel of edge `size` (m) that holds `p`; none if `p` is not finite or out of the range of `i32`.
    #[inline]
    pub fn containing(p: &Point3<f64>, size: f64) -> Option<Self> {
        Some(Self { x: index(p.x / size)?, y: index(p.y / size)?, z: index(p.z / size)? })
    }

    /// Centre of the voxel of edge `size` (m).
    #[inline]
    pub fn center(self, size: f64) -> Point3<f64> {
        Point3::new(
            (f64::from(self.x) + 0.5) * size,
            (f64::from(self.y) + 0.5) * size,
            (f64::from(self.z) + 0.5) * size,
        )
    }
}

/// The floor as an index. `f64::floor` is a call to the C library on processors that are not known to have the instruction, and
/// this is the innermost step of walks along beams: cutting off and stepping down does the same.
#[inline]
fn index(value: f64) -> Option<i32> {
    let cut = value as i64;
    let floor = cut - i64::from((cut as f64) > value);
    if value.is_nan() { None } else { i32::try_from(floor).ok() }
}

/// Where a 2D grid lies in its frame: cell (0, 0)'s lower-left corner and the edge length.
///
/// Grids are aligned with their frame's axes. `x -> column`, `y -> row`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct GridGeometry {
    /// Edge of a cell, metres.
    pub resolution_m: f64,
    /// Lower-left corner of cell (0, 0), metres.
    pub origin: Point2<f64>,
}

impl GridGeometry {
    /// A grid whose cell (0, 0) has its lower-left corner at `origin` (m).
    pub fn new(resolution_m: f64, origin: Point2<f64>) -> Self {
        Self { resolution_m, origin }
    }

    /// The cell that holds `p`; none if `p` is not finite or beyond the range of `i32`.
    pub fn cell(&self, p: &Point2<f64>) -> Option<Cell> {
        Some(Cell {
            x: index((p.x - self.origin.x) / self.resolution_m)?,
            y: index((p.y - self.origin.y) / self.resolution_m)?,
        })
    }

    /// Centre of a cell, metres.
    pub fn center(&self, cell: Cell) -> Point2<f64> {
        Point2::new(
            self.origin.x + (f64::from(cell.x) + 0.5) * self.resolution_m,
            self.origin.y + (f64::from(cell.y) + 0.5) * self.resolution_m,
        )
    }

    /// Lower-left corner of a cell, metres.
    pub fn corner(&self, cell: Cell) -> Point2<f64> {
        Point2::new(
            self.origin.x + f64::from(cell.x) * self.resolution_m,
            self.origin.y + f64::from(cell.y) * self.resolution_m,
        )
    }
}

/// Every cell that the segment from `a` to `b` passes through, from the cell of `a` to the cell of `b`,
/// both included, each one once, neighbours sharing an edge.
///
/// Source: Amanatides and Woo, "A fast voxel traversal algorithm for ray tracing", 1987. Empty if an end
/// is not finite or beyond the range of the indices.
pub fn walk(geometry: &GridGeometry, a: &Point2<f64>, b: &Point2<f64>, mut visit: impl FnMut(Cell)) {
    walk_while(geometry, a, b, |cell| {
        visit(cell);
        true
    });
}

/// Cells as [`walk`] visits them, up to the first for which `visit` returns false.
pub fn walk_while(geometry: &GridGeometry, a: &Point2<f64>, b: &Point2<f64>, mut visit: impl FnMut(Cell) -> bool) {
    let (Some(start), Some(end)) = (geometry.cell(a), geometry.cell(b)) else { return };
    let direction = b - a;
    let axis = |p: f64, origin: f64, d: f64, cell: i32| {
        if d == 0.0 {
            return (f64::INFINITY, f64::INFINITY);
        }
        let border = origin + (f64::from(cell) + if d > 0.0 { 1.0 } else { 0.0 }) * geometry.resolution_m;
        ((border - p) / d, geometry.resolution_m / d.abs())
    };
    let (mut t_x, dt_x) = axis(a.x, geometry.origin.x, direction.x, start.x);
    let (mut t_y, dt_y) = axis(a.y, geometry.origin.y, direction.y, start.y);
    let (step_x, step_y) = (if direction.x > 0.0 { 1 } else { -1 }, if direction.y > 0.0 { 1 } else { -1 });
    let (mut left_x, mut left_y) = (start.x.abs_diff(end.x), start.y.abs_diff(end.y));
    let mut cell = start;
    if !visit(cell) {
        return;
    }
    // Counting the steps down ends exactly in the cell of `b`, whatever the rounding of t.
    while left_x + left_y > 0 {
        if left_y == 0 || (left_x > 0 && t_x < t_y) {
            cell.x += step_x;
            t_x += dt_x;
            left_x -= 1;
        } else {
            cell.y += step_y;
            t_y += dt_y;
            left_y -= 1;
        }
        if !visit(cell) {
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_walk_is_connected_and_stays_on_the_segment(
            ax in -5.0..5.0f64, ay in -5.0..5.0f64, bx in -5.0..5.0f64, by in -5.0..5.0f64,
        ) {
            let g = GridGeometry::new(0.1, Point2::new(-1.03, 0.27));
            let (a, b) = (Point2::new(ax, ay), Point2::new(bx, by));
            let mut cells = vec![];
            walk(&g, &a, &b, |c| cells.push(c));
            prop_assert_eq!(cells.first().copied(), g.cell(&a));
            prop_assert_eq!(cells.last().copied(), g.cell(&b));
            for pair in cells.windows(2) {
                prop_assert_eq!(pair[0].x.abs_diff(pair[1].x) + pair[0].y.abs_diff(pair[1].y), 1);
            }
            let length = (b - a).norm().max(1e-12);
            for c in cells {
                // Distance of the centre from the line is at most half a diagonal.
                let d = (b - a).perp(&(g.center(c) - a)).abs() / length;
                prop_assert!(length < 1e-6 || d <= 0.1 * 0.5f64.sqrt() + 1e-9);
            }
        }

        #[test]
        fn an_index_is_the_floor(value in prop_oneof![any::<f64>(), -3.0..3.0f64, -3e9..3e9f64, Just(-0.0), (-5..5i32).prop_map(f64::from)]) {
            let floor = value.floor();
            let is_index = floor >= f64::from(i32::MIN) && floor <= f64::from(i32::MAX);
            prop_assert_eq!(index(value), is_index.then_some(floor as i32));
        }

        #[test]
        fn a_cell_holds_its_centre(x in -100_000..100_000i32, y in -100_000..100_000i32) {
            let g = GridGeometry::new(0.05, Point2::new(12.3, -4.5));
            prop_assert_eq!(g.cell(&g.center(Cell::new(x, y))), Some(Cell::new(x, y)));
        }
    }

    #[test]
    fn far_and_non_finite_points_have_no_cell() {
        let g = GridGeometry::new(1e-6, Point2::origin());
        assert_eq!(g.cell(&Point2::new(1e7, 0.0)), None);
        assert_eq!(g.cell(&Point2::new(f64::NAN, 0.0)), None);
        assert_eq!(Voxel::containing(&Point3::new(0.0, f64::INFINITY, 0.0), 0.1), None);
    }
}
