//! Whether a path may begin and end where it is to.

use crate::blocking::Refusal;
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
) -> Result<Cell, Refusal> {
    let cell = costmap.cell(start).ok_or(NoPathReason::StartOutsideMap)?;
    match costmap.state(cell) {
        Some(CellState::Free) => {}
        Some(CellState::Unknown) => return Err(NoPathReason::StartUnknown.into()),
        Some(CellState::KeepOut) => return Err(NoPathReason::StartInKeepOut.into()),
        _ => return Err(NoPathReason::StartOccupied.into()),
    }
    let seen = |c: Cell| grid.value(Cell::new(c.x - 1, c.y - 1)).flatten().is_some();
    let near = |c: Cell| (costmap.geometry().center(c) - start).norm() <= params.start_tolerance_m;
    let known = seen(cell) || costmap.cells_within(start, params.start_tolerance_m).any(|c| near(c) && seen(c));
    if known || params.allow_unknown { Ok(cell) } else { Err(NoPathReason::StartUnknown.into()) }
}

/// The goal's cell, if it is free.
fn check_goal_cell(costmap: &Costmap, goal: &Point2<f64>) -> Result<Cell, Refusal> {
    let cell = costmap.cell(goal).ok_or(NoPathReason::GoalOutsideMap)?;
    match costmap.state(cell) {
        Some(CellState::Free) => Ok(cell),
        Some(CellState::Unknown) => Err(NoPathReason::GoalUnknown.into()),
        Some(CellState::KeepOut) => Err(NoPathReason::GoalInKeepOut.into()),
        _ => Err(NoPathReason::GoalOccupied.into()),
    }
}

/// The goal's cell, if the robot's disc fits there and on its centre.
pub(crate) fn check_goal(costmap: &Costmap, goal: &Point2<f64>, params: &PlanParams) -> Result<Cell, Refusal> {
    let cell = check_goal_cell(costmap, goal)?;
    let center = costmap.geometry().center(cell);
    let radius = params.robot_radius_m;
    if costmap.fits(cell) && costmap.segment_clearance(&center, goal, radius) >= radius * (1.0 - 1e-6) {
        return Ok(cell);
    }
    let blocking = costmap.blocking_at(goal, radius + costmap.geometry().resolution_m);
    Err(Refusal { reason: NoPathReason::GoalDoesNotFit, blocking })
}

/// As [`check_start`], for a footprint.
pub(crate) fn check_start_pose(
    fit: &Fit<'_>,
    costmap: &Costmap,
    grid: &DenseGrid,
    start: &Pose2,
    params: &PlanParams,
) -> Result<(), Refusal> {
    check_start(costmap, grid, &start.position, params)?;
    let Some(obstacle) = fit.obstacle_within(start, 0.0) else { return Ok(()) };
    let blocking = costmap.blocking(&start.position, obstacle);
    Err(Refusal { reason: NoPathReason::StartDoesNotFit, blocking })
}

/// As [`check_goal`], for a footprint; without a heading, for the largest disc that it holds.
pub(crate) fn check_goal_pose(fit: &Fit<'_>, costmap: &Costmap, goal: &Goal, inscribed: f64) -> Result<(), Refusal> {
    check_goal_cell(costmap, &goal.position)?;
    let blocking = match goal.yaw_rad {
        Some(yaw_rad) => {
            let obstacle = fit.obstacle_within(&Pose2 { position: goal.position, yaw_rad }, 0.0);
            obstacle.and_then(|cell| costmap.blocking(&goal.position, cell))
        }
        None => {
            let clearance = costmap.segment_clearance(&goal.position, &goal.position, inscribed);
            let fits = clearance >= inscribed * (1.0 - 1e-6);
            if fits { None } else { costmap.blocking_at(&goal.position, inscribed) }
        }
    };
    match blocking {
        None => Ok(()),
        blocking => Err(Refusal { reason: NoPathReason::GoalDoesNotFit, blocking }),
    }
}
