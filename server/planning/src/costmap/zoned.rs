//! Zones and masks laid over a map.

use super::{CellState, Costmap};
use crate::polygon::contains;
use crate::{Mask, MaskKind, Zone, ZoneKind};
use nalgebra::Point2;
use percept_geometry::Cell;

impl Costmap {
    /// Before clearances are measured. The rim stays as it is.
    pub(super) fn zoned(mut self, zones: &[Zone], masks: &[Mask<'_>], occupied_probability: f64) -> Self {
        for zone in zones {
            let (low, high) = zone.bounds();
            let middle = nalgebra::center(&low, &high);
            let size = self.geometry().resolution_m;
            let touches = |low: Point2<f64>| zone.edge_touches(&low, size);
            for cell in self.cells_within(&middle, 0.5 * (high - low).amax() + size) {
                let is_inside = contains(&zone.polygon, &self.geometry().center(cell));
                match zone.kind {
                    ZoneKind::KeepOut if is_inside || touches(self.geometry().corner(cell)) => self.keep_out(cell),
                    ZoneKind::SpeedLimit { share } if is_inside => self.slow_down(cell, share),
                    _ => {}
                }
            }
        }
        for mask in masks {
            for index in 0..self.states().len() {
                let cell = Cell::new((index % self.width()) as i32, (index / self.width()) as i32);
                let there = mask.grid.geometry.cell(&self.geometry().center(cell));
                let Some(Some(value)) = there.and_then(|c| mask.grid.value(c)) else { continue };
                match mask.kind {
                    MaskKind::KeepOut if f64::from(value) >= 100.0 * occupied_probability => self.keep_out(cell),
                    MaskKind::KeepOut => {}
                    kind => kind.speed_share(value).into_iter().for_each(|share| self.slow_down(cell, share)),
                }
            }
        }
        self
    }

    fn keep_out(&mut self, cell: Cell) {
        let index = self.at(cell);
        if !self.is_rim(index) && self.states()[index] == CellState::Free {
            self.set_state(index, CellState::KeepOut);
        }
    }

    fn slow_down(&mut self, cell: Cell, share: f64) {
        let index = self.at(cell);
        self.limit_speed(index, share as f32);
    }
}
