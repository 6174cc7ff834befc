//! Marks on cells: how one keyframe's are gathered, each cell once, with the heights that they are about.

use super::OccupancyParams;
use super::mark::{Heights, Mark};
use super::planar::PlanarMarks;
use nalgebra::{Point2, Point3};
use percept_geometry::{Cell, GridGeometry};

/// What one keyframe says about the cells around its sensor: a square window of marks, as far as it saw.
///
/// Depends on the pose and the scan alone, so that many keyframes can be worked on at once.
#[derive(Debug, Clone, PartialEq)]
pub struct ScanUpdate {
    pub(super) min: Cell,
    pub(super) width: usize,
    /// Whether the beams lie in one plane and say nothing about other heights.
    pub(super) planar: bool,
    pub(super) marks: Marks,
}

/// Marks by cell of the window.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Marks {
    /// Row-major `width x width`.
    Each(Vec<Mark>),
    /// Of a planar scan.
    Planar(PlanarMarks),
}

impl ScanUpdate {
    /// The first cell of the window.
    pub(crate) fn min(&self) -> Cell {
        self.min
    }

    /// Cells along the window's edge.
    pub(crate) fn width(&self) -> usize {
        self.width
    }

    /// Whether something was hit in a cell, or seen through it; none where neither was.
    pub(crate) fn says(&self, cell: Cell) -> Option<bool> {
        match self.at(cell) {
            Mark::Unseen => None,
            Mark::Hit(_) => Some(true),
            Mark::Over(_) | Mark::Free(_) | Mark::Driven(_) => Some(false),
        }
    }

    /// What a cell is marked as.
    pub(super) fn at(&self, cell: Cell) -> Mark {
        let (x, y) = (i64::from(cell.x) - i64::from(self.min.x), i64::from(cell.y) - i64::from(self.min.y));
        let is_inside = |v: i64| (0..self.width as i64).contains(&v);
        match &self.marks {
            _ if !(is_inside(x) && is_inside(y)) => Mark::Unseen,
            Marks::Each(marks) => marks[y as usize * self.width + x as usize],
            Marks::Planar(marks) => marks.at(cell),
        }
    }

    /// The same, of which cells beside one that was hit are not said to be free: the end of a beam may as well lie in them.
    pub(crate) fn sparing_beside_hits(self) -> Self {
        let side = self.width;
        let cell = |k: usize| Cell::new(self.min.x + (k % side) as i32, self.min.y + (k / side) as i32);
        let all: Vec<Mark> = (0..side * side).map(|k| self.at(cell(k))).collect();
        let near = |v: usize| v.saturating_sub(1)..=(v + 1).min(side - 1);
        let mut spared = all.clone();
        for k in (0..all.len()).filter(|k| matches!(all[*k], Mark::Hit(_))) {
            for beside in near(k / side).flat_map(|y| near(k % side).map(move |x| y * side + x)) {
                if matches!(all[beside], Mark::Free(_) | Mark::Over(_)) {
                    spared[beside] = Mark::Unseen;
                }
            }
        }
        Self { marks: Marks::Each(spared), ..self }
    }

    /// Adds a mark, if the cell is in the window.
    #[inline]
    pub(super) fn mark(&mut self, cell: Cell, mark: Mark) {
        // What lies before the window wraps to far behind it.
        let [x, y] = [cell.x.wrapping_sub(self.min.x), cell.y.wrapping_sub(self.min.y)].map(|v| v as u32 as usize);
        if x >= self.width || y >= self.width {
            return;
        }
        match &mut self.marks {
            Marks::Each(marks) => {
                let slot = &mut marks[y * self.width + x];
                *slot = slot.joined(mark);
            }
            Marks::Planar(marks) => marks.mark(cell, mark),
        }
    }
}

/// Where the beams start, and how to read their ends.
pub(super) struct Frame<'a> {
    pub(super) params: &'a OccupancyParams,
    pub(super) geometry: &'a GridGeometry,
    /// Map frame, metres.
    pub(super) sensor: Point3<f64>,
    /// Height of the floor under base in the map, metres.
    pub(super) floor_z: f64,
}

impl Frame<'_> {
    pub(super) fn hit_at(&self, update: &mut ScanUpdate, end: &Point2<f64>, heights: Heights) {
        if let Some(cell) = self.geometry.cell(end) {
            update.mark(cell, Mark::Hit(heights));
        }
    }
}
