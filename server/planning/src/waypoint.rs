//! What a path is made of.

use crate::{Costmap, Pose2};
use nalgebra::Point2;
use percept_geometry::se3::wrap_angle;

/// A point of a path and the heading towards the next.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Waypoint {
    /// Map frame, metres.
    pub position: Point2<f64>,
    /// Direction in which the robot looks, (-pi, pi]. On paths of straight legs it is that to the next waypoint; the last
    /// keeps that of the one before, 0 if the path has no length.
    pub yaw_rad: f64,
    /// Whether the robot drives backwards from here to the next waypoint; the last keeps that of the one before.
    pub is_reverse: bool,
    /// Distance of the base from the nearest obstacle, metres, or up to a cell's diagonal less; none if there is none.
    pub clearance_m: Option<f64>,
    /// When it is reached, seconds after the first.
    pub time_s: f64,
}

impl Waypoint {
    pub(crate) fn at(costmap: &Costmap, pose: &Pose2, is_reverse: bool) -> Self {
        let (clearance, off) = costmap.clearance_near(&pose.position);
        let clearance_m = clearance.is_finite().then(|| (clearance - off).max(0.0));
        Self { position: pose.position, yaw_rad: wrap_angle(pose.yaw_rad), is_reverse, clearance_m, time_s: 0.0 }
    }
}
