//! Columns of voxels that nothing may enter.

use super::DenseVoxels;
use super::clearance::squared_clearances;
use crate::polygon::contains;
use crate::{Mask, MaskKind, Zone, ZoneKind};
use nalgebra::Point2;

/// Which columns of a box, and of a margin around it, are closed: the ball may reach out of the box.
pub(super) struct KeepOut {
    closed: Vec<bool>,
    /// Columns of the box along x and y, and of the margin at each side.
    size: [usize; 2],
    margin: usize,
}

impl KeepOut {
    /// Of sound zones and masks (in these, what is at least `least` per cent); none if no column is closed.
    pub(super) fn of(
        voxels: &DenseVoxels,
        zones: &[Zone],
        masks: &[Mask<'_>],
        least: f64,
        margin: usize,
    ) -> Option<Self> {
        let size = [voxels.size[0], voxels.size[1]];
        let mut out = Self { closed: vec![], size, margin };
        out.closed = vec![false; out.width() * (size[1] + 2 * margin)];
        let edge = voxels.voxel_size_m;
        let corner = |column: Point2<i64>| {
            let low = [i64::from(voxels.low.x) + column.x, i64::from(voxels.low.y) + column.y];
            Point2::from(low.map(|v| v as f64 * edge))
        };
        // Columns that a rectangle in metres touches.
        let within = |low: Point2<f64>, high: Point2<f64>| {
            let range = |i: usize, first: i32| {
                let at = |v: f64| (v / edge).floor() - f64::from(first);
                let (least, most) = (-(margin as f64), (size[i] + margin) as f64 - 1.0);
                at(low[i]).max(least) as i64..=at(high[i]).min(most) as i64
            };
            let columns = range(0, voxels.low.x);
            range(1, voxels.low.y).flat_map(move |y| columns.clone().map(move |x| Point2::new(x, y)))
        };
        for zone in zones.iter().filter(|zone| zone.kind == ZoneKind::KeepOut) {
            let (low, high) = zone.bounds();
            for column in within(low, high) {
                let low = corner(column);
                let middle = low.map(|v| v + 0.5 * edge);
                if contains(&zone.polygon, &middle) || zone.edge_touches(&low, edge) {
                    out.set(column);
                }
            }
        }
        for mask in masks.iter().filter(|mask| mask.kind == MaskKind::KeepOut) {
            let geometry = &mask.grid.geometry;
            let is_closed = |value: i8| value >= 0 && f64::from(value) >= least;
            for index in (0..mask.grid.cells.len()).filter(|i| is_closed(mask.grid.cells[*i])) {
                let [x, y] = [index % mask.grid.width, index / mask.grid.width].map(|v| v as f64);
                // Cells that only share an edge with a column do not close it.
                let (inner, size) = (1e-6 * geometry.resolution_m, geometry.resolution_m);
                let low = geometry.origin + nalgebra::Vector2::new(x * size + inner, y * size + inner);
                within(low, low.map(|v| v + size - 2.0 * inner)).for_each(|column| out.set(column));
            }
        }
        out.closed.contains(&true).then_some(out)
    }

    fn width(&self) -> usize {
        self.size[0] + 2 * self.margin
    }

    fn index(&self, x: i64, y: i64) -> Option<usize> {
        let along = |v: i64, size: usize| usize::try_from(v + self.margin as i64).ok().filter(|v| *v < size);
        Some(along(y, self.size[1] + 2 * self.margin)? * self.width() + along(x, self.width())?)
    }

    fn set(&mut self, column: Point2<i64>) {
        if let Some(index) = self.index(column.x, column.y) {
            self.closed[index] = true;
        }
    }

    /// Whether a column is closed, counted from the box's lowest; not beyond the margin.
    pub(super) fn holds(&self, x: i64, y: i64) -> bool {
        self.index(x, y).is_some_and(|i| self.closed[i])
    }

    /// Makes voxels of closed columns obstacles.
    pub(super) fn close(&self, obstacle: &mut [bool]) {
        for (i, obstacle) in obstacle.iter_mut().enumerate() {
            *obstacle |= self.holds((i % self.size[0]) as i64, (i / self.size[0] % self.size[1]) as i64);
        }
    }

    /// Lowers clearances to those of closed columns, which go on above and below the box and in the margin.
    pub(super) fn limit(&self, squares: &mut [u16], most: usize) {
        let of_columns =
            squared_clearances(&self.closed, [self.width(), self.size[1] + 2 * self.margin, 1], most, true);
        for (row, squares) in squares.chunks_exact_mut(self.size[0]).enumerate() {
            let from = (row % self.size[1] + self.margin) * self.width() + self.margin;
            squares.iter_mut().zip(&of_columns[from..]).for_each(|(square, column)| *square = (*square).min(*column));
        }
    }
}
