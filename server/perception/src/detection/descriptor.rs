//! What the built-in classifier looks at.

use super::Structure;
use super::sides::Sides;
use nalgebra::Point3;
use percept_geometry::{ObjectClass, OrientedBox3};
use rustc_hash::FxHashSet;
use serde::{Deserialize, Serialize};

/// Edge of the cells in which footprints are counted, metres.
const CELL_M: f64 = 0.05;

/// A thing that a person named, as the built-in classifier sees it: an example of its class.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ClassExample {
    /// What it is.
    pub class: ObjectClass,
    /// Size and build.
    pub descriptor: Descriptor,
}

/// Size and build of a thing that stands on the floor.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Descriptor {
    /// Top above the floor, metres.
    pub height_m: f64,
    /// Longer side of the footprint, metres.
    pub length_m: f64,
    /// Shorter side of the footprint, metres.
    pub width_m: f64,
    /// Part of the points within 0.1 m of the top, 0..1: high for tables.
    pub top_share: f64,
    /// Cells taken between 0.1 and 0.4 of the height (under seats), over those that a closed side all around would
    /// take: low on legs, about 1 for closed things, more for filled ones.
    pub low_fill: f64,
    /// The same between 0.6 and 0.95 of the height.
    pub high_fill: f64,
    /// How much the sides face four directions a right angle apart: near 1 for what is made of boards, near 0
    /// for what is round.
    pub squareness: f64,
}

impl Descriptor {
    /// Of points whose box is `bbox`, and whose sides face so.
    pub(super) fn of(points: &[Point3<f32>], bbox: &OrientedBox3, sides: &Sides, structure: &Structure) -> Self {
        let heights: Vec<f64> = points.iter().map(|p| structure.height(&p.cast())).collect();
        let height = structure.height(&bbox.center()) + 0.5 * bbox.size.z;
        let (length, width) = (bbox.size.x.max(bbox.size.y), bbox.size.x.min(bbox.size.y));
        let share = |wanted: &dyn Fn(f64) -> bool| {
            heights.iter().filter(|h| wanted(**h)).count() as f64 / points.len().max(1) as f64
        };
        let around = (2.0 * (length + width) / CELL_M).max(1.0);
        let fill = |from: f64, to: f64| {
            let cells: FxHashSet<(i32, i32)> = points
                .iter()
                .zip(&heights)
                .filter(|(_, h)| (from * height..=to * height).contains(*h))
                .map(|(p, _)| ((f64::from(p.x) / CELL_M).floor() as i32, (f64::from(p.y) / CELL_M).floor() as i32))
                .collect();
            cells.len() as f64 / around
        };
        Self {
            height_m: height,
            length_m: length,
            width_m: width,
            top_share: share(&|h| h >= height - 0.1),
            low_fill: fill(0.1, 0.4),
            high_fill: fill(0.6, 0.95),
            squareness: sides.squareness,
        }
    }
}
