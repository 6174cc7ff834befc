//! What a path is asked for.

use crate::{Footprint, HybridParams, Mask, PlanError, PlanParams, Pose2, SpeedLimits, Zone};
use nalgebra::Point2;
use percept_mapping::DenseGrid;
use std::borrow::Cow;

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
    /// Hybrid A*: for a robot that steers, and for a footprint that only fits in some headings. Start and goal headings are
    /// met.
    Hybrid(HybridParams),
}

/// A question for a path; [`PathRequest::new`] sets what is not asked for.
#[derive(Clone, Copy)]
pub struct PathRequest<'a> {
    /// Where from.
    pub start: Pose2,
    /// Where to.
    pub goal: Goal,
    /// Costs, limits, and the robot's radius.
    pub params: &'a PlanParams,
    /// How.
    pub planner: Planner,
    /// What the robot covers; none: a disc of `params.robot_radius_m`. By `Grid` and `AnyAngle` it is planned for as the
    /// smallest disc around the base that holds it.
    pub footprint: Option<&'a Footprint>,
    /// Where the robot may not be, or not be fast.
    pub zones: &'a [Zone],
    /// The same as grids.
    pub masks: &'a [Mask<'a>],
    /// For the path's duration.
    pub speed: SpeedLimits,
    /// Asked from time to time while a planner searches, say for a deadline: once it is true, the search ends with the best path
    /// found so far, if any. Over cells a path is found early and then made better, which takes longer until the cheapest is known
    /// than if there is none; by [`Planner::AnyAngle`] legs at any angle come after that.
    pub stop: Option<&'a (dyn Fn() -> bool + Sync)>,
}

impl<'a> PathRequest<'a> {
    /// From position to position (map frame, metres), whatever the headings, by [`Planner::Grid`].
    pub fn new(start: Point2<f64>, goal: Point2<f64>, params: &'a PlanParams) -> Self {
        let start = Pose2 { position: start, yaw_rad: 0.0 };
        Self {
            start,
            goal: Goal { position: goal, yaw_rad: None },
            params,
            planner: Planner::default(),
            footprint: None,
            zones: &[],
            masks: &[],
            speed: SpeedLimits::default(),
            stop: None,
        }
    }

    /// What the robot covers.
    pub fn footprint(&self) -> Cow<'a, Footprint> {
        let disc = || Cow::Owned(Footprint::Disc { radius_m: self.params.robot_radius_m });
        self.footprint.map_or_else(disc, Cow::Borrowed)
    }

    /// What is planned for: the footprint if its heading counts, else the smallest disc that holds it.
    pub(crate) fn planned_footprint(&self) -> Cow<'a, Footprint> {
        match self.planner {
            Planner::Hybrid(_) => self.footprint(),
            _ => Cow::Owned(self.enclosing_disc()),
        }
    }

    /// The smallest disc around the base that holds the footprint.
    pub(crate) fn enclosing_disc(&self) -> Footprint {
        Footprint::Disc { radius_m: self.footprint().circumscribed_radius_m() }
    }

    /// Checks all that is asked, and the map.
    ///
    /// # Errors
    /// As [`PathRequest::validate`]; `Map`, `GridTooLarge`.
    pub(crate) fn check_grid(&self, grid: &DenseGrid) -> Result<(), PlanError> {
        self.validate()?;
        grid.validate().map_err(PlanError::Map)?;
        let (cells, limit) = (grid.cells.len() as u64, self.params.max_cells as u64);
        if cells > limit { Err(PlanError::GridTooLarge { cells, limit }) } else { Ok(()) }
    }

    /// Checks all that is asked.
    ///
    /// # Errors
    /// `InvalidParam`, `NotFinite`, `Map` for a mask that is not sound.
    pub fn validate(&self) -> Result<(), PlanError> {
        self.params.validate()?;
        self.footprint.map_or(Ok(()), Footprint::validate)?;
        self.zones.iter().try_for_each(Zone::validate)?;
        self.masks.iter().try_for_each(|mask| mask.grid.validate().map_err(PlanError::Map))?;
        self.speed.validate()?;
        if let Planner::Hybrid(hybrid) = self.planner {
            hybrid.validate()?;
        }
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
