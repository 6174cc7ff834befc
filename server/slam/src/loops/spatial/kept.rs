//! What is kept of a keyframe that a sensor has seen in space.

use nalgebra::Point2;
use percept_geometry::KeptScan;

/// What a keyframe saw.
#[derive(Debug)]
pub(super) struct Kept {
    pub(super) scan: KeptScan,
    /// What stands upright, seen from above: in base turned level, its x axis kept.
    pub(super) walls: Vec<Point2<f32>>,
    /// Length of the way up to it, metres.
    pub(super) travel: f64,
}
