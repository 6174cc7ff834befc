//! What a path is asked for.

use crate::{PlanError, PlanParams};
use nalgebra::Point2;

/// A position and a heading in the plane, map frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose2 {
    /// Of the robot's base, metres.
    pub position: Point2<f64>,
    /// Direction in which the robot looks, counter-clockwise from the x axis, radians; any finite number.
    pub yaw_rad: f64,
}

/// Where to go, map frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Goal {
    /// Of the robot's base, metres.
    pub position: Point2<f64>,
    /// Heading to end with, radians; none: any.
    pub yaw_rad: Option<f64>,
}

/// How a path is searched.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Planner {
    /// A* over cells, shortened and smoothed: for a robot that turns on the spot. Headings are not looked at.
    #[default]
    Grid,
    /// Lazy Theta*: legs at any angle, where they cost less than what `Grid` finds. Headings are not looked at.
    AnyAngle,
}

/// A question for a path; [`PathRequest::new`] sets what is not asked for.
#[derive(Debug, Clone, Copy)]
pub struct PathRequest<'a> {
    /// Where from.
    pub start: Pose2,
    /// Where to.
    pub goal: Goal,
    /// Costs, limits, and the robot's radius.
    pub params: &'a PlanParams,
    /// How.
    pub planner: Planner,
}

impl<'a> PathRequest<'a> {
    /// From position to position (map frame, metres), whatever the headings, by [`Planner::Grid`].
    pub fn new(start: Point2<f64>, goal: Point2<f64>, params: &'a PlanParams) -> Self {
        let start = Pose2 { position: start, yaw_rad: 0.0 };
        Self { start, goal: Goal { position: goal, yaw_rad: None }, params, planner: Planner::default() }
    }

    /// Checks all that is asked.
    ///
    /// # Errors
    /// `InvalidParam`, `NotFinite`.
    pub fn validate(&self) -> Result<(), PlanError> {
        self.params.validate()?;
        let finite = |field, value: f64| {
            if value.is_finite() { Ok(()) } else { Err(PlanError::NotFinite { field, value }) }
        };
        for (field, point) in [("start", &self.start.position), ("goal", &self.goal.position)] {
            point.iter().try_for_each(|v| finite(field, *v))?;
        }
        finite("start.yaw_rad", self.start.yaw_rad)?;
        finite("goal.yaw_rad", self.goal.yaw_rad.unwrap_or_default())
    }
}
