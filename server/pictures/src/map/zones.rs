//! Zones: where a robot may not go, and where it goes slowly.

use crate::canvas::Canvas;
use crate::colors::{AMBER, INK, RED};
use crate::sheet::{Entry, Swatch, Window};
use nalgebra::Point2;

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

pub(super) fn legend(zones: &[Zone]) -> Vec<Entry> {
    let has = |keep_out: bool| zones.iter().any(|z| matches!(z.kind, ZoneKind::KeepOut) == keep_out);
    let mut out = vec![];
    if has(true) {
        out.push(Entry::new(Swatch::Hatch(RED), "keep out"));
    }
    if has(false) {
        out.push(Entry::new(Swatch::Fill(crate::colors::mix(crate::colors::PAPER, AMBER, 0.35)), "speed limit"));
    }
    out
}
