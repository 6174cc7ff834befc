//! From start to goal: check the ends, search, smooth, check again.

use crate::astar::{SearchGrid, reaches, search};
use crate::costmap::{CellState, Costmap};
use crate::smooth::{resample, shorten, smooth};
use crate::theta::any_angle;
use crate::{GridPath, PathRequest, PlanError, PlanParams, Planner};
use nalgebra::Point2;
use percept_geometry::Cell;
use percept_mapping::{DenseGrid, MappingError, Occupancy};

/// A point of a path and the heading towards the next.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Waypoint {
    /// Map frame, metres.
    pub position: Point2<f64>,
    /// Direction to the next waypoint, (-pi, pi]; the last keeps that of the one before, 0 if the path has no length.
    pub yaw_rad: f64,
}

/// A path that the robot can drive.
#[derive(Debug, Clone, PartialEq)]
pub struct Path {
    /// From exactly the start to exactly the goal; straight in between.
    pub waypoints: Vec<Waypoint>,
    /// Length, metres.
    pub length_m: f64,
    /// Length, with metres near obstacles counted more: what the search kept small.
    pub cost: f64,
    /// Smallest distance of the robot's centre from an obstacle (or from unknown cells, unless allowed) along the way,
    /// metres, exact; none if the map has no obstacle.
    pub min_clearance_m: Option<f64>,
    /// Cells that the search expanded.
    pub expansions: usize,
}

/// Why there is no path.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum NoPathReason {
    /// The start is beyond what the map covers.
    StartOutsideMap,
    /// The start is in an obstacle, or so near to some that the robot cannot get free.
    StartOccupied,
    /// The start is in unknown space, and so is all within `start_tolerance_m`.
    StartUnknown,
    /// The goal is beyond what the map covers.
    GoalOutsideMap,
    /// The goal, or the centre of its cell, is in an obstacle or nearer to one than the robot's radius.
    GoalOccupied,
    /// The same for unknown space, where that is not allowed.
    GoalUnknown,
    /// Start and goal are free, and no way of the robot's width joins them.
    Unreachable,
    /// The search ended at `max_expansions`: there may be a path.
    SearchLimit,
}

/// The answer to a question for a path.
#[derive(Debug, Clone, PartialEq)]
pub enum PlanOutcome {
    /// There it is.
    Path(Path),
    /// There is none.
    NoPath {
        /// Why.
        reason: NoPathReason,
    },
}

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
    request.validate()?;
    grid.validate().map_err(PlanError::Map)?;
    let params = request.params;
    if grid.cells.len() > params.max_cells {
        return Err(PlanError::GridTooLarge { cells: grid.cells.len() as u64, limit: params.max_cells as u64 });
    }
    let costmap = Costmap::new(grid, &request.start.position, params);
    Ok(match route(&costmap, grid, request) {
        Ok(path) => PlanOutcome::Path(path),
        Err(reason) => PlanOutcome::NoPath { reason },
    })
}

fn route(costmap: &Costmap, grid: &DenseGrid, request: &PathRequest<'_>) -> Result<Path, NoPathReason> {
    let PathRequest { params, planner, .. } = *request;
    let (start, goal) = (request.start.position, request.goal.position);
    let from = check_start(costmap, grid, &start, params)?;
    let to = check_goal(costmap, &goal, params)?;
    let blocked = costmap.blocked(&start);
    let (width, height) = (costmap.width(), costmap.height());
    let search_grid = SearchGrid { blocked: &blocked, factors: costmap.factors(), width, height };
    let path_through = |cells: &[Cell], expansions: usize| {
        let mut raw = vec![start];
        raw.extend(cells.iter().map(|c| costmap.geometry().center(*c)));
        raw.push(goal);
        let points = if params.smooth { smoothed(costmap, &raw, params) } else { raw };
        path_of(costmap, points, expansions)
    };
    let by_cells = match search(&search_grid, from, to, params.max_expansions) {
        GridPath::Found { cells, expansions, .. } => path_through(&cells, expansions),
        GridPath::SearchLimit => return Err(NoPathReason::SearchLimit),
        GridPath::Unreachable { .. } => return Err(unreachable(costmap, &search_grid, from)),
    };
    if planner == Planner::Grid {
        return Ok(by_cells);
    }
    let left = params.max_expansions.saturating_sub(by_cells.expansions);
    match any_angle(costmap, &blocked, (from, to), params.robot_radius_m, left) {
        GridPath::Found { cells, expansions, .. } => {
            let path = path_through(&cells, by_cells.expansions + expansions);
            Ok(if path.cost < by_cells.cost { path } else { Path { expansions: path.expansions, ..by_cells } })
        }
        // What A* found is a path all the same.
        _ => Ok(by_cells),
    }
}

fn check_start(
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

fn check_goal(costmap: &Costmap, goal: &Point2<f64>, params: &PlanParams) -> Result<Cell, NoPathReason> {
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

/// Unreachable, or rather a start so hemmed in that no place the robot fits in can be reached from it.
fn unreachable(costmap: &Costmap, grid: &SearchGrid<'_>, from: Cell) -> NoPathReason {
    if reaches(grid, from, |c| costmap.fits(c)) { NoPathReason::Unreachable } else { NoPathReason::StartOccupied }
}

fn smoothed(costmap: &Costmap, raw: &[Point2<f64>], params: &PlanParams) -> Vec<Point2<f64>> {
    let radius = params.robot_radius_m;
    let short = shorten(costmap, raw, radius);
    smooth(costmap, &resample(&short, params.waypoint_spacing_m), radius)
}

fn path_of(costmap: &Costmap, mut points: Vec<Point2<f64>>, expansions: usize) -> Path {
    let (first, last) = (points[0], points[points.len() - 1]);
    points.dedup_by(|b, a| a == b);
    if points.len() == 1 {
        points = vec![first, last];
    }
    let mut nearest = f64::INFINITY;
    let (mut length, mut cost) = (0.0, 0.0);
    let mut waypoints: Vec<Waypoint> = Vec::with_capacity(points.len());
    for leg in points.windows(2) {
        let along = leg[1] - leg[0];
        length += along.norm();
        cost += costmap.segment_cost(&leg[0], &leg[1]);
        nearest = costmap.segment_clearance(&leg[0], &leg[1], nearest);
        let yaw_rad = percept_geometry::se3::wrap_angle(along.y.atan2(along.x));
        waypoints.push(Waypoint { position: leg[0], yaw_rad });
    }
    let yaw_rad = waypoints.last().map_or(0.0, |w| w.yaw_rad);
    waypoints.push(Waypoint { position: last, yaw_rad });
    let min_clearance_m = nearest.is_finite().then_some(nearest);
    Path { waypoints, length_m: length, cost, min_clearance_m, expansions }
}
