//! Requests for paths, and paths.

use super::{geometry, maps, required, scene, sessions, zones};
use crate::{params, v1};
use nalgebra::Point2;
use percept_formats::GridMap;
use percept_geometry::GridGeometry;
use percept_mapping::DenseGrid;
use percept_mapping::height::Storey;
use percept_pipeline::PipelineParams;
use percept_planning::{
    Blocking, CellState, Footprint, HybridParams, Misfit, MisfitReason, NoPathReason, PlanOutcome, Planner, Pose2,
    SpeedLimits, Waypoint,
};
use percept_scene::ObjectId;
use percept_service::reason;
use percept_service::{
    Error, Limits, Navigation, PathChange, PathCheck, PathOptions, PathUpdate, Plan, PlanRequest, Result,
    navigation as ops,
};
use std::time::Duration;

/// Corners of a footprint.
const MAX_CORNERS: usize = 64;

/// What a path is asked for; parameters that are set replace the session's.
///
/// # Errors
/// Naming the field.
pub fn request(
    start: Option<&v1::Vector2>,
    goal: Option<&v1::Vector2>,
    sent: Option<&v1::PlanningParams>,
    asked: Option<&v1::PathOptions>,
    session: &PipelineParams,
) -> Result<PlanRequest> {
    Ok(PlanRequest {
        start: start.map(|s| geometry::point2("start", s)).transpose()?,
        goal: geometry::point2("goal", required("goal", goal)?)?,
        params: Some(params::planning(sent, &session.planning)?),
        options: options(asked)?,
    })
}

/// What else is asked of a path.
///
/// # Errors
/// Naming the field below `options`.
pub fn options(asked: Option<&v1::PathOptions>) -> Result<PathOptions> {
    let Some(asked) = asked else { return Ok(PathOptions::default()) };
    let within = |e: Error| e.within("options");
    let footprint = zones::corners("footprint", &asked.footprint, MAX_CORNERS).map_err(within)?;
    let speed = |s: &v1::SpeedLimits| SpeedLimits {
        max_speed_mps: s.max_speed_mps,
        max_accel_mps2: s.max_accel_mps2,
        max_turn_rate_radps: s.max_turn_rate_radps,
    };
    Ok(PathOptions {
        planner: planner(asked).map_err(within)?,
        start_yaw_rad: asked.start_yaw_rad,
        goal_yaw_rad: asked.goal_yaw_rad,
        footprint: (!footprint.is_empty()).then_some(Footprint::Polygon(footprint)),
        zones: zones::zones(&asked.zones)?,
        speed: asked.speed.as_ref().map_or_else(SpeedLimits::default, speed),
        masks: vec![],
        storey: asked.storey.as_ref().map(storey).transpose().map_err(|e| e.within("options.storey"))?,
        ignores_session_zones: asked.ignore_session_zones,
        is_map_only: asked.map_only,
        deadline: (asked.deadline_ms > 0).then(|| Duration::from_millis(asked.deadline_ms.into())),
    })
}

fn storey(s: &v1::StoreyOptions) -> Result<Storey> {
    super::layers::storey(s.storey, s.near_z_m, s.near_within_m)
}

/// The same of a path on a map that comes with the question, which has no storeys.
///
/// # Errors
/// Naming the field below `options`.
pub fn options_on_map(asked: Option<&v1::PathOptions>) -> Result<PathOptions> {
    let options = options(asked)?;
    if options.storey.is_some() {
        let words = "a map that comes with the question has one floor; leave storey out";
        return Err(Error::invalid(reason::OUT_OF_RANGE, "options.storey", words));
    }
    Ok(options)
}

fn planner(asked: &v1::PathOptions) -> Result<Planner> {
    let steering = asked.steering.unwrap_or_default();
    let usual = HybridParams::default();
    let hybrid = HybridParams {
        turning_radius_m: steering.turning_radius_m.unwrap_or(usual.turning_radius_m),
        allow_reverse: steering.allow_reverse.unwrap_or(usual.allow_reverse),
        reverse_cost: steering.reverse_cost.unwrap_or(usual.reverse_cost),
        direction_change_cost_m: steering.direction_change_cost_m.unwrap_or(usual.direction_change_cost_m),
        turning_cost: steering.turning_cost.unwrap_or(usual.turning_cost),
        tolerance: steering.tolerance.unwrap_or(usual.tolerance),
        ..usual
    };
    Ok(match v1::Planner::try_from(asked.planner) {
        Ok(v1::Planner::Unspecified | v1::Planner::Grid) => Planner::Grid,
        Ok(v1::Planner::AnyAngle) => Planner::AnyAngle,
        Ok(v1::Planner::Hybrid) => Planner::Hybrid(hybrid),
        Err(_) => return Err(super::unknown_enum("planner", asked.planner)),
    })
}

/// Poses of a path.
///
/// # Errors
/// `OUT_OF_RANGE` naming the pose.
pub fn poses(poses: &[v1::Pose2]) -> Result<Vec<Pose2>> {
    let pose = |(i, p): (usize, &v1::Pose2)| match [p.x_m, p.y_m, p.yaw_rad].iter().find(|v| !v.is_finite()) {
        None => Ok(Pose2 { position: Point2::new(p.x_m, p.y_m), yaw_rad: p.yaw_rad }),
        Some(value) => {
            let message = format!("a coordinate is {value}; it must be finite");
            Err(Error::invalid(reason::OUT_OF_RANGE, format!("poses[{i}]"), message))
        }
    };
    poses.iter().enumerate().map(pose).collect()
}

/// A map that came with the question.
///
/// # Errors
/// `FIELD_MISSING`, `SIZE_MISMATCH`, `OUT_OF_RANGE`, `FILE_INVALID`, `GRID_TOO_LARGE`.
pub fn given_map(map: Option<&v1::GivenMap>, limits: &Limits) -> Result<DenseGrid> {
    let map = required("map", map)?;
    match required("map", map.map.as_ref())? {
        v1::given_map::Map::Grid(sent) => grid(sent).map_err(|e| e.within("map.grid")),
        v1::given_map::Map::Nav2(files) => nav2(files, limits).map_err(|e| e.within("map.nav2")),
    }
}

/// A map from the files of nav2's map server.
///
/// # Errors
/// `FILE_INVALID` naming the file.
pub fn nav2(files: &v1::Nav2Map, limits: &Limits) -> Result<DenseGrid> {
    let of_file = |field: &'static str| {
        move |e: percept_formats::FormatError| Error::invalid(reason::FILE_INVALID, field, e.to_string())
    };
    let yaml = percept_formats::nav2::parse_yaml(&files.yaml).map_err(of_file("yaml"))?;
    let limits =
        percept_formats::Limits { max_pixels: limits.max_planning_cells as u64, ..super::format_limits(limits) };
    let decoded = percept_formats::nav2::decode(&yaml, &files.image, &limits).map_err(of_file("image"))?;
    let GridMap { geometry, width, height, cells } = decoded;
    Ok(DenseGrid { geometry, width, height, cells })
}

/// A map as occupancy.
///
/// # Errors
/// `FIELD_MISSING`, `SIZE_MISMATCH`, `OUT_OF_RANGE`.
pub fn grid(grid: &v1::GridMap) -> Result<DenseGrid> {
    let g = required("geometry", grid.geometry.as_ref())?;
    if !(g.resolution_m.is_finite() && g.resolution_m > 0.0) {
        let message = format!("resolution_m is {}; it must be positive", g.resolution_m);
        return Err(Error::invalid(reason::OUT_OF_RANGE, "geometry.resolution_m", message));
    }
    let origin = geometry::point2("geometry.origin", &required("geometry.origin", g.origin)?)?;
    let expected = u64::from(g.width) * u64::from(g.height);
    if grid.cells.len() as u64 != expected {
        let message = format!(
            "cells holds {} bytes, {} x {} cells are {expected}; send one byte a cell",
            grid.cells.len(),
            g.width,
            g.height
        );
        return Err(Error::invalid(reason::SIZE_MISMATCH, "cells", message));
    }
    let cells: Vec<i8> = grid.cells.iter().map(|c| *c as i8).collect();
    if let Some(value) = cells.iter().find(|c| !(-1..=100).contains(*c)) {
        let message = format!("a cell is {value}; cells are -1 (unknown) or 0 to 100");
        return Err(Error::invalid(reason::OUT_OF_RANGE, "cells", message));
    }
    let geometry = GridGeometry::new(g.resolution_m, origin);
    Ok(DenseGrid { geometry, width: g.width as usize, height: g.height as usize, cells })
}

fn reason_number(reason: NoPathReason) -> v1::NoPathReason {
    use v1::NoPathReason as R;
    match reason {
        NoPathReason::StartOutsideMap => R::StartOutsideMap,
        NoPathReason::StartOccupied => R::StartOccupied,
        NoPathReason::StartDoesNotFit => R::StartDoesNotFit,
        NoPathReason::StartInKeepOut => R::StartInKeepOut,
        NoPathReason::StartUnknown => R::StartUnknown,
        NoPathReason::GoalOutsideMap => R::GoalOutsideMap,
        NoPathReason::GoalOccupied => R::GoalOccupied,
        NoPathReason::GoalDoesNotFit => R::GoalDoesNotFit,
        NoPathReason::GoalInKeepOut => R::GoalInKeepOut,
        NoPathReason::GoalUnknown => R::GoalUnknown,
        NoPathReason::Unreachable => R::Unreachable,
        NoPathReason::NotSteerable => R::NotSteerable,
        NoPathReason::SearchLimit => R::SearchLimit,
        NoPathReason::Stopped => R::Deadline,
    }
}

/// Why there is no path; none: no start was given and the robot does not know where it is.
pub(super) fn reason_to(reason: Option<NoPathReason>) -> (v1::NoPathReason, &'static str) {
    (reason.map_or(v1::NoPathReason::Lost, reason_number), ops::words_of(reason))
}

pub(super) fn no_path_to(reason: Option<NoPathReason>, blocking: Option<v1::Blocking>) -> v1::NoPath {
    let (reason, detail) = reason_to(reason);
    v1::NoPath { reason: reason.into(), detail: detail.to_owned(), blocking }
}

pub(super) fn path_to(p: &percept_planning::Path) -> v1::Path {
    let waypoint = |w: &Waypoint| v1::Waypoint {
        x_m: w.position.x,
        y_m: w.position.y,
        yaw_rad: w.yaw_rad,
        is_reverse: w.is_reverse,
        clearance_m: w.clearance_m,
        time_s: w.time_s,
    };
    v1::Path {
        waypoints: p.waypoints.iter().map(waypoint).collect(),
        length_m: p.length_m,
        cost: p.cost,
        min_clearance_m: p.min_clearance_m,
        clearance_cost: p.cost_parts.clearance,
        steering_cost: p.cost_parts.steering,
        duration_s: p.duration_s,
        bound: p.bound,
        is_final: p.is_final,
    }
}

pub(super) fn blocking_to(b: &Blocking, object: Option<ObjectId>) -> v1::Blocking {
    let state = match b.state {
        CellState::Free => v1::BlockingState::Unspecified,
        CellState::Occupied => v1::BlockingState::Occupied,
        CellState::Unknown => v1::BlockingState::Unknown,
        CellState::KeepOut => v1::BlockingState::KeepOut,
    };
    let point = |p: &Point2<f64>| Some(v1::Vector2 { x: p.x, y: p.y });
    v1::Blocking {
        position: point(&b.position),
        obstacle: point(&b.obstacle),
        state: state.into(),
        object_id: object.map(|o| o.0),
    }
}

pub(super) fn outcome_to(outcome: &PlanOutcome, object: Option<ObjectId>) -> std::result::Result<v1::Path, v1::NoPath> {
    match outcome {
        PlanOutcome::Path(p) => Ok(path_to(p)),
        PlanOutcome::NoPath { reason, blocking } => {
            Err(no_path_to(Some(*reason), blocking.as_ref().map(|b| blocking_to(b, object))))
        }
    }
}

/// The path of a plan, or why there is none, as messages.
///
/// # Errors
/// There is none.
pub fn planned_to(plan: &Plan) -> std::result::Result<v1::Path, v1::NoPath> {
    match &plan.outcome {
        Some(outcome) => outcome_to(outcome, plan.object),
        None => {
            let reason = match plan.no_start {
                ops::NoStart::Lost => v1::NoPathReason::Lost,
                ops::NoStart::ScaleUnknown => v1::NoPathReason::ScaleUnknown,
            };
            let detail = ops::words_of_no_start(plan.no_start).to_owned();
            Err(v1::NoPath { reason: reason.into(), detail, blocking: None })
        }
    }
}

/// A path on a map that came with the question, or why there is none, as a message.
pub fn on_map_to(outcome: &PlanOutcome) -> v1::PlanOnMapResponse {
    use v1::plan_on_map_response::Outcome;
    v1::PlanOnMapResponse { outcome: Some(outcome_to(outcome, None).map_or_else(Outcome::NoPath, Outcome::Path)) }
}

/// Where a path does not fit, as a message.
pub fn misfit_to(m: &Misfit, object: Option<ObjectId>) -> v1::Misfit {
    let (reason, blocking) = match &m.reason {
        MisfitReason::OutsideMap => (v1::MisfitReason::OutsideMap, None),
        MisfitReason::Blocked(blocking) => (v1::MisfitReason::Blocked, Some(blocking_to(blocking, object))),
        MisfitReason::NotSteerable => (v1::MisfitReason::NotSteerable, None),
        MisfitReason::Backwards => (v1::MisfitReason::Backwards, None),
    };
    let pose = v1::Pose2 { x_m: m.pose.position.x, y_m: m.pose.position.y, yaw_rad: m.pose.yaw_rad };
    v1::Misfit { pose_index: m.pose_index as u32, pose: Some(pose), reason: reason.into(), blocking }
}

/// A checked path as a message.
pub fn check_to(check: &PathCheck) -> v1::ValidatePathResponse {
    v1::ValidatePathResponse {
        misfit: check.misfit.as_ref().map(|m| misfit_to(m, check.object)),
        stamp: Some(maps::stamp_to(check.map_version, check.stamp)),
    }
}

/// A path, or why there is none, as a message.
pub fn plan_to(plan: &Plan) -> v1::PlanPathResponse {
    use v1::plan_path_response::Outcome;
    let outcome = planned_to(plan).map_or_else(Outcome::NoPath, Outcome::Path);
    v1::PlanPathResponse { outcome: Some(outcome), stamp: Some(maps::stamp_to(plan.map_version, plan.stamp)) }
}

/// What is told of a watched path, as a message.
pub fn update_to(update: &PathUpdate) -> v1::WatchPathResponse {
    use v1::watch_path_response::Outcome;
    let (change, check) = match &update.change {
        PathChange::First => (v1::PathChange::First, None),
        PathChange::Blocked(check) => (v1::PathChange::Blocked, Some(check)),
        PathChange::Better => (v1::PathChange::Better, None),
        PathChange::Opened => (v1::PathChange::Opened, None),
        PathChange::OtherReason => (v1::PathChange::OtherReason, None),
    };
    let misfit = check.and_then(|c| Some(misfit_to(c.misfit.as_ref()?, c.object)));
    v1::WatchPathResponse {
        change: change.into(),
        outcome: Some(planned_to(&update.plan).map_or_else(Outcome::NoPath, Outcome::Path)),
        misfit,
        stamp: Some(maps::stamp_to(update.plan.map_version, update.plan.stamp)),
    }
}

/// The answer to one step as a message.
pub fn navigation_to(n: &Navigation) -> v1::NavigateResponse {
    use v1::navigate_response::Outcome;
    let outcome = planned_to(&n.plan).map_or_else(Outcome::NoPath, Outcome::Path);
    v1::NavigateResponse {
        frame: Some(sessions::result_to(&n.processed)),
        pose: n.pose.as_ref().map(sessions::pose_to),
        obstacles: n.obstacles.iter().map(scene::object_to).collect(),
        outcome: Some(outcome),
        stamp: Some(maps::stamp_to(n.plan.map_version, n.plan.stamp)),
    }
}
