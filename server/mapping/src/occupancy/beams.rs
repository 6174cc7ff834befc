//! The beams of a planar scan: how far each one is passed, and whether it ended on something.

use super::mark::{Heights, Mark};
use super::marks::Frame;
use super::planar::PlanarMarks;
use super::{OccupancyParams, fan};
use nalgebra::{Point2, Point3};
use percept_geometry::grid::walk;
use percept_geometry::{Cell, GridGeometry};

/// A beam from the sensor.
#[derive(Debug, Clone, Copy)]
pub(super) struct Beam {
    /// Where it ends, metres, map frame, and the cell there.
    pub(super) to: Point2<f64>,
    pub(super) end: Cell,
    /// Whether it ended on something. If not, its last cell is as free as those before.
    pub(super) is_hit: bool,
}

impl Frame<'_> {
    /// The beams to hits and misses (map frame): those beyond the largest range go as far as that and hit nothing, those that are
    /// too near or have no cell say nothing.
    pub(super) fn beams(&self, hits: &[Point3<f64>], misses: &[Point3<f64>]) -> Vec<Beam> {
        let OccupancyParams { range_min_m, .. } = *self.params;
        let (sensor, range_max) = (self.sensor.xy(), self.params.range_max());
        let mut out = Vec::with_capacity(hits.len() + misses.len());
        let mut add = |to: Point2<f64>, is_hit| out.extend(self.geometry.cell(&to).map(|end| Beam { to, end, is_hit }));
        let towards = |end: Point2<f64>, range: f64| {
            let share = (range_max / range).min(1.0);
            sensor + (end - sensor) * if range > 0.0 { share } else { 0.0 }
        };
        for p in hits {
            let range = (p.xy() - sensor).norm();
            if range <= range_max && range >= range_min_m {
                add(p.xy(), true);
            } else if range > range_max && range.is_finite() {
                add(towards(p.xy(), range), false);
            }
        }
        for p in misses {
            let range = (p.xy() - sensor).norm();
            if range.is_finite() {
                add(towards(p.xy(), range), false);
            }
        }
        out
    }

    /// Marks what planar beams say, all of which are about these heights.
    pub(super) fn mark_beams(&self, heights: Heights, hits: &[Point3<f64>], misses: &[Point3<f64>]) -> PlanarMarks {
        let (from, beams) = (self.sensor.xy(), self.beams(hits, misses));
        let start = self.geometry.cell(&from).unwrap_or(Cell::new(0, 0));
        let (mut low, mut high) = (start, start);
        for Beam { end, .. } in &beams {
            (low.x, low.y) = (low.x.min(end.x), low.y.min(end.y));
            (high.x, high.y) = (high.x.max(end.x), high.y.max(end.y));
        }
        // A cell more on each side: see [`fan`].
        low = Cell::new(low.x.saturating_sub(1), low.y.saturating_sub(1));
        high = Cell::new(high.x.saturating_add(1), high.y.saturating_add(1));
        let mut marks = PlanarMarks::new(heights, low, high);
        if !fan::free(&mut marks, self.geometry, &from, &beams) {
            marks.free.fill(0);
            free(&mut marks, self.geometry, &from, &beams);
        }
        for beam in beams.iter().filter(|beam| beam.is_hit) {
            marks.mark(beam.end, Mark::Hit(heights));
        }
        marks
    }
}

/// Frees the cells of beams, one cell after another: what [`fan::free`] does faster.
pub(super) fn free(marks: &mut PlanarMarks, geometry: &GridGeometry, from: &Point2<f64>, beams: &[Beam]) {
    let heights = marks.heights;
    for beam in beams {
        walk(geometry, from, &beam.to, |cell| marks.mark(cell, Mark::Free(heights)));
    }
}
