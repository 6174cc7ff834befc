//! From start to goal: check the ends, search, smooth, check again.

use crate::answer::{NoPathReason, Path, PlanOutcome};
use crate::anytime::best_in_time;
use crate::astar::{SearchGrid, search};
use crate::blocking::{Refusal, first_blocking};
use crate::by_cells::{path_through, sized, unreachable};
use crate::costmap::Costmap;
use crate::ends::{check_goal, check_goal_pose, check_start, check_start_pose};
use crate::fit::Fit;
use crate::hybrid::{DrivingCost, HybridPath, Limits, Steering, closed_cells, shortcut};
use crate::theta::{AnyAngleLimits, any_angle};
use crate::{Footprint, GridPath, HybridParams, PathRequest, PlanError, PlanParams, Planner};
use nalgebra::Point2;
use percept_mapping::{DenseGrid, MappingError, Occupancy};

/// Plans over all that a grid knows; see [`plan_dense`].
///
/// # Errors
/// As [`plan_dense`]; `GridTooLarge` also if the rectangle around the known cells is larger than `max_cells`.
pub fn plan(
    grid: &impl Occupancy,
    start: Point2<f64>,
    goal: Point2<f64>,
    params: &PlanParams,
) -> Result<PlanOutcome, PlanError> {
    plan_over(grid, &PathRequest::new(start, goal, params))
}

/// Plans over all that a grid knows; see [`plan_path`].
///
/// # Errors
/// As [`plan_path`]; `GridTooLarge` also if the rectangle around the known cells is larger than `max_cells`.
pub fn plan_over(grid: &impl Occupancy, request: &PathRequest<'_>) -> Result<PlanOutcome, PlanError> {
    request.validate()?;
    let dense = grid.dense(request.params.max_cells).map_err(|error| match error {
        MappingError::RegionTooLarge { cells, limit } => PlanError::GridTooLarge { cells, limit },
        other => PlanError::Map(other),
    })?;
    plan_path(&dense, request)
}

/// The cheapest path of the robot's disc from `start` to `goal` (map frame, metres) over a rectangle of the map, shortened
/// and smoothed without coming nearer to obstacles than `robot_radius_m`.
///
/// # Errors
/// As [`plan_path`].
pub fn plan_dense(
    grid: &DenseGrid,
    start: Point2<f64>,
    goal: Point2<f64>,
    params: &PlanParams,
) -> Result<PlanOutcome, PlanError> {
    plan_path(grid, &PathRequest::new(start, goal, params))
}

/// A path over a rectangle of the map, as it is asked for.
///
/// # Errors
/// `InvalidParam`, `NotFinite`, `GridTooLarge`, `Map` for a grid whose values or shape are not sound.
pub fn plan_path(grid: &DenseGrid, request: &PathRequest<'_>) -> Result<PlanOutcome, PlanError> {
    request.check_grid(grid)?;
    let footprint = request.planned_footprint();
    let params = sized(request, &footprint);
    let request = PathRequest { params: &params, ..*request };
    let PathRequest { zones, masks, .. } = request;
    let costmap = Costmap::with_zones(grid, &request.start.position, &params, zones, masks);
    let found = match request.planner {
        Planner::Hybrid(hybrid) => steer(&costmap, grid, &request, hybrid, &footprint),
        _ => route(&costmap, grid, &request),
    };
    Ok(match found {
        Ok(path) => PlanOutcome::Path(path),
        Err(Refusal { reason, blocking }) => PlanOutcome::NoPath { reason, blocking },
    })
}

/// A path that can be steered.
fn steer(
    costmap: &Costmap,
    grid: &DenseGrid,
    request: &PathRequest<'_>,
    hybrid: HybridParams,
    footprint: &Footprint,
) -> Result<Path, Refusal> {
    let PathRequest { start, goal, params, .. } = *request;
    let inscribed = footprint.inscribed_radius_m();
    let fit = Fit::new(costmap, footprint);
    check_start_pose(&fit, costmap, grid, &start, params)?;
    check_goal_pose(&fit, costmap, &goal, inscribed)?;
    let closed = closed_cells(costmap, inscribed);
    let limits = Limits { max_expansions: params.max_expansions, stop: request.stop, cheaper_than: f64::INFINITY };
    let steering = Steering { costmap, fit: &fit, closed: &closed, start, goal, params: hybrid };
    let (arcs, bound, is_final, expansions) = match steering.search(&limits) {
        HybridPath::Found { arcs, bound, is_final, expansions } => (arcs, bound, is_final, expansions),
        HybridPath::Exhausted { .. } => return Err(NoPathReason::NotSteerable.into()),
        HybridPath::Apart => {
            let blocking = costmap.cell(&start.position).zip(costmap.cell(&goal.position));
            let blocking = blocking.and_then(|ends| first_blocking(costmap, &closed, ends, inscribed));
            return Err(Refusal { reason: NoPathReason::Unreachable, blocking });
        }
        HybridPath::Stopped { by_caller: true } => return Err(NoPathReason::Stopped.into()),
        HybridPath::Stopped { by_caller: false } => return Err(NoPathReason::SearchLimit.into()),
    };
    let cost = DrivingCost { costmap, params: hybrid };
    let (arcs, is_final, expansions) = if params.smooth {
        let refined = steering.refined(shortcut(&cost, &fit, arcs), expansions, &limits);
        (refined.arcs, is_final && refined.is_final, refined.expansions)
    } else {
        (arcs, is_final, expansions)
    };
    let path = Path::of_arcs(&cost, (&start, goal.position), &arcs, params.waypoint_spacing_m, &request.speed);
    Ok(Path { bound: Some(bound), is_final, expansions, ..path })
}

fn route(costmap: &Costmap, grid: &DenseGrid, request: &PathRequest<'_>) -> Result<Path, Refusal> {
    let PathRequest { params, planner, .. } = *request;
    let (start, goal) = (request.start.position, request.goal.position);
    let from = check_start(costmap, grid, &start, params)?;
    let to = check_goal(costmap, &goal, params)?;
    let blocked = costmap.blocked(&start);
    let (width, height) = (costmap.width(), costmap.height());
    let search_grid = SearchGrid { blocked: &blocked, factors: costmap.factors(), width, height };
    let by_cells = match request.stop {
        Some(stop) => best_in_time(costmap, request, &search_grid, (from, to), stop)?,
        None => match search(&search_grid, from, to, params.max_expansions) {
            GridPath::Found { cells, expansions, .. } => path_through(costmap, request, &cells, expansions),
            GridPath::SearchLimit => return Err(NoPathReason::SearchLimit.into()),
            GridPath::Unreachable { .. } => return Err(unreachable(costmap, &search_grid, (from, to), params)),
        },
    };
    if planner == Planner::Grid || !by_cells.is_final {
        return Ok(by_cells);
    }
    let limits = AnyAngleLimits {
        clearance_m: params.robot_radius_m,
        max_expansions: params.max_expansions.saturating_sub(by_cells.expansions),
        stop: request.stop,
    };
    Ok(match any_angle(costmap, &blocked, (from, to), &limits) {
        GridPath::Found { cells, expansions, .. } => {
            let path = path_through(costmap, request, &cells, by_cells.expansions + expansions);
            if path.cost < by_cells.cost { path } else { Path { expansions: path.expansions, ..by_cells } }
        }
        // What A* found is a path all the same, and the best so far.
        _ => Path { is_final: false, ..by_cells },
    })
}
