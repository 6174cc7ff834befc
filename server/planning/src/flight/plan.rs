//! From start to goal in space: check the ends, search, pull taut.

use super::ends::{FlightBlocking, Refusal, check_goal, check_start};
use super::field::Field;
use super::lattice::{Found, Limits};
use super::{DenseVoxels, FlightPlanner, FlightRequest};
use crate::{NoPathReason, PlanError, Zone};
use nalgebra::Point3;

/// A path along which the ball touches nothing.
#[derive(Debug, Clone, PartialEq)]
pub struct FlightPath {
    /// From exactly the start to exactly the goal, straight in between, map frame, metres. Two or more.
    pub waypoints: Vec<Point3<f64>>,
    /// Length, metres.
    pub length_m: f64,
    /// Smallest distance of the ball's centre from an obstacle's voxel along the way, metres, exact; none if it is more than
    /// the radius and two voxels.
    pub min_clearance_m: Option<f64>,
    /// Voxels that the searches expanded.
    pub expansions: usize,
    /// Its length from voxel to voxel, before corners are left out, is at most so many times the least.
    pub bound: f64,
    /// Whether the searches came to their end; else this is the best so far.
    pub is_final: bool,
}

/// The answer to a question for a path in space.
#[derive(Debug, Clone, PartialEq)]
pub enum FlightOutcome {
    /// There it is.
    Path(FlightPath),
    /// There is none.
    NoPath {
        /// Why: as for paths in the plane. `StartInKeepOut` and `GoalInKeepOut` are also ends above or below the limits of
        /// height. Never `NotSteerable`.
        reason: NoPathReason,
        /// Of an end where the ball does not fit: what is too near.
        blocking: Option<FlightBlocking>,
    },
}

/// The shortest path of a ball through a box of voxels, of those that the planner finds.
///
/// A voxel's centre is open where the ball on it touches no obstacle's cube. It moves from centre to centre where all centres
/// around its way are open; corners that can be left out without coming nearer to obstacles than the radius then are.
///
/// # Errors
/// `InvalidParam`, `NotFinite` (`start`, `goal`), `GridTooLarge`, `Map` for a mask that is not sound.
pub fn plan_flight(voxels: &DenseVoxels, request: &FlightRequest<'_>) -> Result<FlightOutcome, PlanError> {
    let params = request.params;
    for (field, point) in [("start", &request.start), ("goal", &request.goal)] {
        if let Some(&value) = point.iter().find(|v| !v.is_finite()) {
            return Err(PlanError::NotFinite { field, value });
        }
    }
    params.validate_over(voxels.voxel_size_m)?;
    request.zones.iter().try_for_each(Zone::validate)?;
    request.masks.iter().try_for_each(|mask| mask.grid.validate().map_err(PlanError::Map))?;
    let (cells, limit) = (voxels.percent.len() as u64, params.max_voxels as u64);
    if cells > limit {
        return Err(PlanError::GridTooLarge { cells, limit });
    }
    voxels.validate()?;
    Ok(match route(voxels, request) {
        Ok(path) => FlightOutcome::Path(path),
        Err(Refusal { reason, blocking }) => FlightOutcome::NoPath { reason, blocking },
    })
}

fn route(voxels: &DenseVoxels, request: &FlightRequest<'_>) -> Result<FlightPath, Refusal> {
    let params = request.params;
    let (start, goal) = (Field::located(voxels, &request.start), Field::located(voxels, &request.goal));
    let mut field = Field::new(voxels, request, &start);
    let from = check_start(&mut field, voxels, &start, params)?;
    let to = check_goal(&field, &goal, params)?;
    let limits =
        |spent: usize| Limits { max_expansions: params.max_expansions.saturating_sub(spent), stop: request.stop };
    let raw = |way: Vec<usize>| {
        let mut out = vec![start];
        out.extend(way.into_iter().map(|index| field.center(index)));
        out.push(goal);
        out.dedup();
        out
    };
    // By voxels alone, or with the corners left out that can be.
    let drawn = |by_voxels: Vec<Point3<f64>>| match request.planner {
        FlightPlanner::Lattice => measured(&field, voxels, request, by_voxels),
        FlightPlanner::AnyAngle => measured(&field, voxels, request, taut(&field, &by_voxels)),
    };
    let none = |found: &Found| match found {
        Found::Limit => NoPathReason::SearchLimit.into(),
        Found::Stopped => NoPathReason::Stopped.into(),
        Found::Nothing { got_free: false } => field.refusal(NoPathReason::StartDoesNotFit, &start),
        _ => NoPathReason::Unreachable.into(),
    };
    let (mut soon, mut spent) = (None, 0);
    if request.stop.is_some() {
        match field.soon_over_voxels(from, to, &limits(0)) {
            Found::Way { voxels: way, expansions } => {
                let center = |index: &usize| field.center(*index);
                let length = way.windows(2).map(|pair| (center(&pair[1]) - center(&pair[0])).norm()).sum();
                (soon, spent) = (Some((way, field.soon_bound((from, to), length))), expansions);
            }
            ended => return Err(none(&ended)),
        }
    }
    let (by_voxels, expansions) = match (field.shortest_over_voxels(from, to, &limits(spent)), soon) {
        (Found::Way { voxels, expansions }, _) => (raw(voxels), spent + expansions),
        (Found::Limit | Found::Stopped, Some((way, bound))) => {
            return Ok(FlightPath { expansions: spent, bound, is_final: false, ..drawn(raw(way)) });
        }
        (ended, _) => return Err(none(&ended)),
    };
    let by_voxels = FlightPath { expansions, ..drawn(by_voxels) };
    if request.planner == FlightPlanner::Lattice {
        return Ok(by_voxels);
    }
    Ok(match field.any_angle(from, to, &limits(expansions)) {
        Found::Way { voxels: corners, expansions: more } => {
            let path = measured(&field, voxels, request, taut(&field, &raw(corners)));
            let shorter = if path.length_m < by_voxels.length_m { path } else { by_voxels };
            FlightPath { expansions: expansions + more, ..shorter }
        }
        // What A* found is a path all the same.
        Found::Limit | Found::Stopped => FlightPath { is_final: false, ..by_voxels },
        Found::Nothing { .. } => by_voxels,
    })
}

/// Leaves out corners: each point is followed by the last one that it can see before it first cannot, without coming nearer
/// to obstacles than the radius, or than what is replaced.
fn taut(field: &Field<'_>, path: &[Point3<f64>]) -> Vec<Point3<f64>> {
    let mut out = vec![path[0]];
    let mut from = 0;
    while from + 1 < path.len() {
        let mut to = from + 1;
        let mut replaced = field.segment_clearance(&path[from], &path[to], field.radius);
        for next in to + 1..path.len() {
            replaced = field.segment_clearance(&path[next - 1], &path[next], replaced);
            if field.segment_clearance(&path[from], &path[next], replaced) < replaced * (1.0 - 1e-9) {
                break;
            }
            to = next;
        }
        out.push(path[to]);
        from = to;
    }
    out
}

/// Back in the map's frame, with its exact ends.
fn measured(
    field: &Field<'_>,
    voxels: &DenseVoxels,
    request: &FlightRequest<'_>,
    points: Vec<Point3<f64>>,
) -> FlightPath {
    let size = voxels.voxel_size_m;
    let legs = || points.windows(2);
    let nearest = legs().fold(field.farthest(), |nearest, leg| field.segment_clearance(&leg[0], &leg[1], nearest));
    let nearest = if points.len() == 1 { field.segment_clearance(&points[0], &points[0], nearest) } else { nearest };
    let mut waypoints: Vec<Point3<f64>> = points.iter().map(|p| field.placed(p)).collect();
    if waypoints.len() == 1 {
        waypoints.push(request.goal);
    }
    let last = waypoints.len() - 1;
    (waypoints[0], waypoints[last]) = (request.start, request.goal);
    let length_m = waypoints.windows(2).map(|leg| (leg[1] - leg[0]).norm()).sum();
    let min_clearance_m = (nearest < field.farthest()).then_some(nearest * size);
    FlightPath { waypoints, length_m, min_clearance_m, expansions: 0, bound: 1.0, is_final: true }
}
