//! The person: a figure of 1.7 m that walks a closed line in the middle of one room.

use super::layout::{RING_INSET_M, Room};
use crate::rng::{Purpose, stream};
use crate::robot::route::{STEP_M, smooth_closed};
use crate::solid::{PlanarFrame, Shape, Solid};
use crate::texture::{Material, Pattern};
use nalgebra::{Point2, Vector2};
use percept_geometry::Aabb3;
use rand::RngExt;

/// Distance of the person's line from the robot's ring lane, metres: both fit beside each other.
const OFF_LANE_M: f64 = 0.65;
const SPEED_M_PER_S: f64 = 0.8;
/// Length of two steps, metres.
const STRIDE_M: f64 = 1.3;
/// How far a foot swings ahead of the hips, metres.
const SWING_M: f64 = 0.14;

/// Where the person walks.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Person {
    /// A closed line, points `STEP_M` apart before smoothing.
    pub(crate) line: Vec<Point2<f64>>,
    phase: f64,
    material: Material,
}

impl Person {
    /// A quadrilateral with rounded corners within the ring lane of `room`.
    pub(crate) fn in_room(seed: u64, room: &Room) -> Self {
        let mut rng = stream(seed, Purpose::Person, 0, 0);
        let margin = Vector2::repeat(RING_INSET_M + OFF_LANE_M);
        let (min, max) = (room.min + margin, room.max - margin);
        let mut corner = |x: f64, y: f64| {
            // Drawn inwards by up to a fifth of the size.
            let (u, v) = (0.2 * rng.random_range(0.0..1.0), 0.2 * rng.random_range(0.0..1.0));
            let at = |low: f64, high: f64, side: f64, by: f64| low + (high - low) * (side + (1.0 - 2.0 * side) * by);
            Point2::new(at(min.x, max.x, x, u), at(min.y, max.y, y, v))
        };
        let corners = [corner(0.0, 0.0), corner(1.0, 0.0), corner(1.0, 1.0), corner(0.0, 1.0)];
        let line = smooth_closed(&corners, 0.12);
        let phase = rng.random_range(0.0..1.0);
        Self {
            line,
            phase,
            material: Material { pattern: Pattern::Stripes, color: [0.75, 0.3, 0.35], seed: rng.random() },
        }
    }

    /// Place and heading at a time, and how far it has walked (m).
    fn at(&self, t_s: f64) -> (PlanarFrame, f64) {
        let n = self.line.len();
        let walked = self.phase * n as f64 * STEP_M + SPEED_M_PER_S * t_s;
        let index = (walked / STEP_M).rem_euclid(n as f64);
        let (i, f) = (index as usize % n, index.fract());
        let (a, b) = (self.line[i], self.line[(i + 1) % n]);
        // Heading over 0.2 m, as a body turns.
        let ahead = self.line[(i + 10) % n] - self.line[(i + n - 10) % n];
        let p = a + (b - a) * f;
        (PlanarFrame::new(p.x, p.y, ahead.y.atan2(ahead.x)), walked)
    }

    /// The body at a time: two legs, trunk, head.
    pub(crate) fn solids(&self, t_s: f64, object: u32) -> [Solid; 4] {
        let (frame, walked) = self.at(t_s);
        let swing = SWING_M * (walked * std::f64::consts::TAU / STRIDE_M).sin();
        let leg = |y: f64, x: f64| Shape::Cylinder { x, y, radius: 0.075, z_min: 0.0, z_max: 0.8 };
        [
            leg(0.1, swing),
            leg(-0.1, -swing),
            Shape::Capsule { x: 0.0, y: 0.0, radius: 0.2, z_min: 0.95, z_max: 1.27 },
            Shape::Capsule { x: 0.0, y: 0.0, radius: 0.115, z_min: 1.585, z_max: 1.585 },
        ]
        .map(|shape| Solid { shape, frame, material: self.material, object: Some(object) })
    }

    /// Frame and box of the body at a time.
    pub(crate) fn bounds(&self, t_s: f64) -> (PlanarFrame, Aabb3) {
        let mut out = Aabb3::empty();
        let solids = self.solids(t_s, 0);
        for solid in &solids {
            out.grow(&solid.shape.bounds().min);
            out.grow(&solid.shape.bounds().max);
        }
        (solids[0].frame, out)
    }
}
