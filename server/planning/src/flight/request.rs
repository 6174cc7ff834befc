//! What a path in space is asked for.

use super::{FlightParams, FlightPlanner};
use crate::{Mask, Zone};
use nalgebra::Point3;

/// A question for a path in space; [`FlightRequest::new`] sets what is not asked for.
#[derive(Clone, Copy)]
pub struct FlightRequest<'a> {
    /// Where from: the ball's centre, map frame, metres.
    pub start: Point3<f64>,
    /// Where to, likewise.
    pub goal: Point3<f64>,
    /// The robot's radius, and limits.
    pub params: &'a FlightParams,
    /// How.
    pub planner: FlightPlanner,
    /// Where no part of the ball may be: those that are keep-out, from the lowest voxel to the highest. Others do not count.
    pub zones: &'a [Zone],
    /// The same as grids: a cell closes all columns of voxels that it touches.
    pub masks: &'a [Mask<'a>],
    /// Asked before the search and from time to time in it, say for a deadline: once it is true, the search ends with the best path
    /// found so far, if any. A path is looked for first that may be twice as long as the shortest over voxels.
    pub stop: Option<&'a (dyn Fn() -> bool + Sync)>,
}

impl<'a> FlightRequest<'a> {
    /// From position to position (map frame, metres), at any angle.
    pub fn new(start: Point3<f64>, goal: Point3<f64>, params: &'a FlightParams) -> Self {
        Self { start, goal, params, planner: FlightPlanner::default(), zones: &[], masks: &[], stop: None }
    }
}
