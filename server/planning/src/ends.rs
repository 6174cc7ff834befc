//! Whether a path may begin and end where it is to.

use crate::costmap::CellState;
use crate::fit::Fit;
use crate::{Costmap, Goal, NoPathReason, PlanParams, Pose2};
use nalgebra::Point2;
use percept_geometry::Cell;
use percept_mapping::DenseGrid;

/// The start's cell, if it is free and was seen, or near to what was.
pub(crate) fn check_start(
    costmap: &Costmap,
    grid: &DenseGrid,
    start: &Point2<f64>,
    params: &PlanParams,
) -> Result<Cell, NoPathReason> {
    let cell = costmap.cell(start).ok_or(NoPathReason::StartOutsideMap)?;
    match costmap.state(cell) {
        Some(CellState::Free) => {}
        Some(CellState::Unknown) => return Err(NoPathReason::StartUnknown),
        _ => return Err(NoPathReason::StartOccupied),
    }
    let seen = |c: Cell| grid.value(Cell::new(c.x - 1, c.y - 1)).flatten().is_some();
    let near = |c: Cell| (costmap.geometry().center(c) - start).norm() <= params.start_tolerance_m;
    let known = seen(cell) || costmap.cells_within(start, params.start_tolerance_m).any(|c| near(c) && seen(c));
    if known || params.allow_unknown { Ok(cell) } else { Err(NoPathReason::StartUnknown) }
}

/// The goal's cell, if the robot's disc fits there.
pub(crate) fn check_goal(costmap: &Costmap, goal: &Point2<f64>, params: &PlanParams) -> Result<Cell, NoPathReason> {
    let cell = costmap.cell(goal).ok_or(NoPathReason::GoalOutsideMap)?;
    match costmap.state(cell) {
        Some(CellState::Free) => {}
        Some(CellState::Unknown) => return Err(NoPathReason::GoalUnknown),
        _ => return Err(NoPathReason::GoalOccupied),
    }
    let center = costmap.geometry().center(cell);
    let radius = params.robot_radius_m;
    if costmap.fits(cell) && costmap.segment_clearance(&center, goal, radius) >= radius * (1.0 - 1e-6) {
        return Ok(cell);
    }
    let reach = radius + costmap.geometry().resolution_m;
    let occupied = |c: Cell| {
        let near = (costmap.geometry().center(c) - center).norm() <= reach;
        near && costmap.state(c) == Some(CellState::Occupied)
    };
    let any = costmap.cells_within(goal, reach).any(occupied);
    Err(if any { NoPathReason::GoalOccupied } else { NoPathReason::GoalUnknown })
}

/// As [`check_start`], for a footprint.
pub(crate) fn check_start_pose(
    fit: &Fit<'_>,
    costmap: &Costmap,
    grid: &DenseGrid,
    start: &Pose2,
    params: &PlanParams,
) -> Result<(), NoPathReason> {
    check_start(costmap, grid, &start.position, params)?;
    if fit.is_clear(start) { Ok(()) } else { Err(NoPathReason::StartOccupied) }
}

/// As [`check_goal`], for a footprint; without a heading, for the largest disc that it holds.
pub(crate) fn check_goal_pose(fit: &Fit<'_>, costmap: &Costmap, goal: &Goal) -> Result<(), NoPathReason> {
    let cell = costmap.cell(&goal.position).ok_or(NoPathReason::GoalOutsideMap)?;
    match costmap.state(cell) {
        Some(CellState::Free) => {}
        Some(CellState::Unknown) => return Err(NoPathReason::GoalUnknown),
        _ => return Err(NoPathReason::GoalOccupied),
    }
    let blocking = match goal.yaw_rad {
        Some(yaw_rad) => fit.obstacle_within(&Pose2 { position: goal.position, yaw_rad }, 0.0),
        None => return Ok(()),
    };
    match blocking.and_then(|cell| costmap.state(cell)) {
        None => Ok(()),
        Some(CellState::Unknown) => Err(NoPathReason::GoalUnknown),
        Some(_) => Err(NoPathReason::GoalOccupied),
    }
}
