//! Where the robot drove: its body has been there, which no beam says as surely.

use super::OccupancyParams;
use super::mark::{Heights, Mark};
use super::marks::{Frame, ScanUpdate};
use crate::KeyframeView;
use crate::given::is_given;
use nalgebra::{Point2, Point3, Vector3};
use percept_geometry::{Cell, Pose};

/// A base that leans by more is held in a hand, radians: ramps rise by less.
const UPRIGHT_RAD: f64 = 0.15;
/// Between keyframes farther apart than this the way is not known, metres: 30 m/s at ten scans a second.
const FARTHEST_M: f64 = 3.0;
/// Nor where it bends so far beside the straight line between both, metres: half a cell of the default.
const BENDS_M: f64 = 0.05;

/// The robot's way since the keyframe before, as a straight line between two places of base.
///
/// Source: nav2's costmap clears a robot's footprint as it goes (`footprint_clearing_enabled` of its layers).
pub(super) struct Way {
    radius_m: f64,
    /// In the frame that is filled, metres; the same place twice where it is not known where base was before.
    before: Point2<f64>,
    now: Point2<f64>,
}

impl Way {
    /// None if nothing is to be said about it.
    pub(super) fn of(params: &OccupancyParams, view: &KeyframeView<'_>) -> Option<Self> {
        let t = &view.t_submap_base;
        let leans = (t * Vector3::z()).z.clamp(-1.0, 1.0).acos();
        // No body has been where a map that was given is looked at from.
        if params.footprint_radius_m <= 0.0 || leans > UPRIGHT_RAD || is_given(&view.scan.sensor) {
            return None;
        }
        let is_straight = |before: &Pose| {
            let length = before.translation.vector.norm();
            // An arc's height over its chord.
            length <= FARTHEST_M && length * before.rotation.angle() / 8.0 <= BENDS_M
        };
        let now = Point2::from(t.translation.vector.xy());
        let before = view.t_base_before.filter(is_straight).map(|before| (t * before).translation.vector.xy().into());
        Some(Self { radius_m: params.footprint_radius_m, before: before.unwrap_or(now), now })
    }

    /// How far from the sensor it reaches, metres.
    pub(super) fn reach_m(&self, sensor: &Point3<f64>) -> f64 {
        let farthest = (self.before - sensor.xy()).norm().max((self.now - sensor.xy()).norm());
        farthest + self.radius_m
    }

    /// Marks the cells that the body came through. What the keyframe hit where the robot has left stands there now.
    pub(super) fn mark(&self, frame: &Frame<'_>, update: &mut ScanUpdate) {
        let heights = Heights::up_to(frame.params, frame.sensor.z - frame.floor_z);
        let resolution = frame.geometry.resolution_m;
        // Of cells that it came through in part, those to whose middle half a cell is missing.
        let radius = self.radius_m + 0.5 * resolution;
        let corner = |p: Point2<f64>, aside: f64| frame.geometry.cell(&p.map(|v| v + aside));
        let (low, high) = (self.before.inf(&self.now), self.before.sup(&self.now));
        let (Some(low), Some(high)) = (corner(low, -radius), corner(high, radius)) else { return };
        for cell in (low.y..=high.y).flat_map(|y| (low.x..=high.x).map(move |x| Cell::new(x, y))) {
            let center = frame.geometry.center(cell);
            let is_here = (center - self.now).norm() <= radius;
            if is_here || self.distance(&center) <= radius && !matches!(update.at(cell), Mark::Hit(_)) {
                update.mark(cell, Mark::Driven(heights));
            }
        }
    }

    /// Of a place from the line, metres.
    fn distance(&self, p: &Point2<f64>) -> f64 {
        let (along, off) = (self.now - self.before, p - self.before);
        let share = (off.dot(&along) / along.norm_squared().max(1e-12)).clamp(0.0, 1.0);
        (off - along * share).norm()
    }
}
