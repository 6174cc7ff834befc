//! Where a robot is in the plane.

use nalgebra::Point2;

/// A position and a heading in the plane, map frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose2 {
    /// Of the robot's base, metres.
    pub position: Point2<f64>,
    /// Direction in which the robot looks, counter-clockwise from the x axis, radians; any finite number.
    pub yaw_rad: f64,
}
