//! Zones: where a robot may not go, and where it goes slowly.

use crate::canvas::{Canvas, PixelBox};
use crate::colors::{AMBER, INK, RED};
use crate::sheet::{Entry, Swatch, Window};
use nalgebra::Point2;
use percept_mapping::DenseGrid;
use std::sync::Arc;

/// An area of the map.
#[derive(Debug, Clone, PartialEq)]
pub struct Zone {
    /// Corners in order, map frame, metres; fewer than three are no area.
    pub polygon: Vec<Point2<f64>>,
    /// What holds there.
    pub kind: ZoneKind,
}

/// What holds in a zone.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ZoneKind {
    /// No part of a robot may enter: hatched red.
    KeepOut,
    /// The robot drives no faster than this share of its speed (0 to 1): amber.
    SpeedLimit {
        /// Share of the highest speed.
        share: f64,
    },
}

/// Zones as the cells of a grid.
#[derive(Debug, Clone, PartialEq)]
pub struct ZoneMask {
    /// Where its cells lie in the map frame, and their values.
    pub grid: Arc<DenseGrid>,
    /// What holds in a cell by its value, -1 first, then 0 to 100; none, or too short: nothing.
    pub kinds: Vec<Option<ZoneKind>>,
}

impl ZoneMask {
    fn at(&self, p: &Point2<f64>) -> Option<ZoneKind> {
        let index = self.grid.geometry.cell(p).and_then(|cell| self.grid.index(cell))?;
        self.kind(*self.grid.cells.get(index)?)
    }

    fn kind(&self, value: i8) -> Option<ZoneKind> {
        self.kinds.get(usize::try_from(i32::from(value) + 1).ok()?).copied().flatten()
    }
}

/// Masks over the whole drawing: slow cells the stronger, the slower they are.
pub(super) fn draw_masks(canvas: &mut Canvas, window: &Window, plot: PixelBox, masks: &[ZoneMask], e: i32) {
    let corner = |x: i32, y: i32| Point2::new(f64::from(x), f64::from(y));
    let all = [corner(plot.x0, plot.y0), corner(plot.x1, plot.y0), corner(plot.x1, plot.y1), corner(plot.x0, plot.y1)];
    for mask in masks {
        canvas.polygon(&all, |x, y| {
            Some(match mask.at(&window.place(x, y))? {
                ZoneKind::KeepOut => (RED, crate::sheet::hatch(x, y, e)),
                ZoneKind::SpeedLimit { share } => (AMBER, 0.15 + 0.4 * (1.0 - share.clamp(0.0, 1.0))),
            })
        });
    }
}

pub(super) fn draw(canvas: &mut Canvas, window: &Window, zones: &[Zone], e: i32) {
    for zone in zones.iter().filter(|zone| zone.polygon.len() >= 3) {
        let corners: Vec<Point2<f64>> = zone.polygon.iter().map(|p| window.pixel(*p)).collect();
        match zone.kind {
            ZoneKind::KeepOut => {
                canvas.polygon(&corners, |x, y| Some((RED, crate::sheet::hatch(x, y, e))));
                canvas.closed(&corners, 2.0 * f64::from(e), RED);
            }
            ZoneKind::SpeedLimit { .. } => {
                canvas.polygon(&corners, |_, _| Some((AMBER, 0.35)));
                canvas.closed(&corners, 2.0 * f64::from(e), AMBER);
            }
        }
    }
}

/// Speed limits as labels at the middle of their corners.
pub(super) fn labels(window: &Window, zones: &[Zone]) -> Vec<(Point2<f64>, String, [u8; 3])> {
    let middle = |zone: &Zone| {
        let sum = zone.polygon.iter().fold(nalgebra::Vector2::zeros(), |sum, p| sum + p.coords);
        window.pixel(Point2::from(sum / zone.polygon.len().max(1) as f64))
    };
    let limits = zones.iter().filter_map(|zone| match zone.kind {
        ZoneKind::SpeedLimit { share } => Some((middle(zone), format!("{:.0} % speed", 100.0 * share), INK)),
        ZoneKind::KeepOut => None,
    });
    limits.collect()
}

pub(super) fn legend(zones: &[Zone], masks: &[ZoneMask]) -> Vec<Entry> {
    let of_masks = masks.iter().flat_map(|mask| mask.grid.cells.iter().filter_map(|value| mask.kind(*value)));
    let mut there = [false; 2];
    for kind in zones.iter().map(|z| z.kind).chain(of_masks) {
        there[usize::from(kind == ZoneKind::KeepOut)] = true;
    }
    let has = |keep_out: bool| there[usize::from(keep_out)];
    let mut out = vec![];
    if has(true) {
        out.push(Entry::new(Swatch::Hatch(RED), "keep out"));
    }
    if has(false) {
        out.push(Entry::new(Swatch::Fill(crate::colors::mix(crate::colors::PAPER, AMBER, 0.35)), "speed limit"));
    }
    out
}
