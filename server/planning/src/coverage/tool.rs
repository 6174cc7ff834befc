//! What a tool has covered.

use crate::costmap::{CellState, Costmap};
use nalgebra::Point2;

/// A disc that is moved over the map's free cells. A cell is covered once its centre was within the disc.
pub(super) struct Tool<'a> {
    costmap: &'a Costmap,
    /// Offsets of cells whose centre the disc holds if it stands on a cell's centre.
    disc: Vec<(i32, i32)>,
    radius: f64,
    /// Cells that can be covered and have not been.
    pub(super) left: Vec<bool>,
    pub(super) num_left: usize,
}

impl<'a> Tool<'a> {
    /// Of this radius (m), with nothing to cover yet.
    pub(super) fn new(costmap: &'a Costmap, radius: f64) -> Self {
        let cells = radius / costmap.geometry().resolution_m;
        let reach = cells.floor() as i32;
        let square = (-reach..=reach).flat_map(|dy| (-reach..=reach).map(move |dx| (dx, dy)));
        let disc = square.filter(|(dx, dy)| f64::from(*dx).hypot(f64::from(*dy)) <= cells * (1.0 + 1e-9)).collect();
        Self { costmap, disc, radius, left: vec![false; costmap.states().len()], num_left: 0 }
    }

    /// What can be covered from this cell has to be.
    pub(super) fn demand_around(&mut self, index: usize) {
        for at in self.around(index).collect::<Vec<_>>() {
            if !self.left[at] && self.costmap.states()[at] == CellState::Free && !self.costmap.is_rim(at) {
                self.left[at] = true;
                self.num_left += 1;
            }
        }
    }

    /// Whether something is left that the tool covers from this cell.
    pub(super) fn is_needed_at(&self, index: usize) -> bool {
        self.num_left > 0 && self.around(index).any(|at| self.left[at])
    }

    /// Moves it straight from one point to another.
    pub(super) fn pass(&mut self, a: &Point2<f64>, b: &Point2<f64>) {
        let pieces = ((b - a).norm() / (2.0 * self.radius)).ceil().max(1.0);
        let at = |i: usize| a + (b - a) * (i as f64 / pieces);
        (0..pieces as usize).for_each(|i| self.pass_piece(&at(i), &at(i + 1)));
    }

    fn pass_piece(&mut self, a: &Point2<f64>, b: &Point2<f64>) {
        let along = b - a;
        let length2 = along.norm_squared();
        let off = |p: &Point2<f64>| {
            let share = if length2 > 0.0 { ((p - a).dot(&along) / length2).clamp(0.0, 1.0) } else { 0.0 };
            (a + along * share - p).norm()
        };
        for cell in self.costmap.cells_within(&nalgebra::center(a, b), 0.5 * along.norm() + self.radius) {
            let at = self.costmap.at(cell);
            if self.left[at] && off(&self.costmap.geometry().center(cell)) <= self.radius * (1.0 + 1e-9) {
                self.left[at] = false;
                self.num_left -= 1;
            }
        }
    }

    fn around(&self, index: usize) -> impl Iterator<Item = usize> + '_ {
        let (width, height) = (self.costmap.width() as i32, self.costmap.height() as i32);
        let (x, y) = (index as i32 % width, index as i32 / width);
        let inside = move |dx: i32, dy: i32| (0..width).contains(&(x + dx)) && (0..height).contains(&(y + dy));
        let cells = self.disc.iter().filter(move |(dx, dy)| inside(*dx, *dy));
        cells.map(move |(dx, dy)| ((y + dy) * width + x + dx) as usize)
    }
}
