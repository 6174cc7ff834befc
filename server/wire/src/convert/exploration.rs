//! Paths that cover, frontiers, paths in space.

use super::navigation::{blocking_to, no_path_to, options, path_to, reason_to};
use super::zones::zones;
use super::{geometry, layers, maps, required};
use crate::{params, v1};
use percept_pipeline::PipelineParams;
use percept_planning::coverage::{CoverageDirection, CoverageLegKind};
use percept_planning::flight::{FlightOutcome, FlightParams, FlightPlanner};
use percept_planning::{CellState, CoverageOutcome, CoverageParams, Frontier, NoPathReason};
use percept_service::{Error, Explored, FlightQuestion, FrontierRequest, Result, reason};
use std::time::Duration;

/// Length of frontiers that are told if nothing is asked, metres: a door is wider.
const MIN_LENGTH_M: f64 = 0.5;
/// Cells of a frontier that are told.
const MAX_CELLS: usize = 1000;

/// How to cover.
///
/// # Errors
/// `ENUM_UNKNOWN`; values are checked by the planner.
pub fn coverage(asked: Option<&v1::CoverageOptions>) -> Result<CoverageParams> {
    let usual = CoverageParams::default();
    let Some(asked) = asked else { return Ok(usual) };
    let direction = match v1::CoverageDirection::try_from(asked.direction) {
        Ok(v1::CoverageDirection::Unspecified) => CoverageDirection::Shorter,
        Ok(v1::CoverageDirection::AlongX) => CoverageDirection::AlongX,
        Ok(v1::CoverageDirection::AlongY) => CoverageDirection::AlongY,
        Err(_) => return Err(super::unknown_enum("coverage.direction", asked.direction)),
    };
    Ok(CoverageParams {
        tool_width_m: asked.tool_width_m.unwrap_or(usual.tool_width_m),
        overlap: asked.overlap.unwrap_or(usual.overlap),
        enough: asked.enough.unwrap_or(usual.enough),
        direction,
    })
}

/// A path that covers, or why there is none.
pub fn covered_to(answer: &Explored<CoverageOutcome>) -> v1::PlanCoverageResponse {
    use v1::plan_coverage_response::Outcome;
    let outcome = match &answer.outcome {
        None => Outcome::NoPath(no_path_to(None, None)),
        Some(CoverageOutcome::NoPath { reason, blocking }) => {
            Outcome::NoPath(no_path_to(Some(*reason), blocking.as_ref().map(|b| blocking_to(b, None))))
        }
        Some(CoverageOutcome::Path(covering)) => Outcome::Path(v1::CoveragePath {
            path: Some(path_to(&covering.path)),
            legs: covering
                .legs
                .iter()
                .map(|leg| v1::CoverageLeg {
                    first_waypoint: leg.first_waypoint as u32,
                    is_transit: leg.kind == CoverageLegKind::Transit,
                })
                .collect(),
            coverable_m2: covering.coverable_m2,
            covered_share: covering.covered_share,
            num_regions: covering.num_regions as u32,
        }),
    };
    v1::PlanCoverageResponse { outcome: Some(outcome), stamp: Some(maps::stamp_to(answer.map_version, answer.stamp)) }
}

/// Which frontiers are asked for.
///
/// # Errors
/// Naming the field.
pub fn frontier_request(r: &v1::FindFrontiersRequest, session: &PipelineParams) -> Result<FrontierRequest> {
    let min_length_m = r.min_length_m.unwrap_or(MIN_LENGTH_M);
    if !(0.0..=1e4).contains(&min_length_m) {
        let message = format!("min_length_m is {min_length_m}; choose 0 to 10000, or leave it out");
        return Err(Error::invalid(reason::OUT_OF_RANGE, "min_length_m", message));
    }
    Ok(FrontierRequest {
        start: r.start.as_ref().map(|s| geometry::point2("start", s)).transpose()?,
        params: Some(params::planning(r.params.as_ref(), &session.planning)?),
        options: options(r.options.as_ref())?,
        min_length_m,
        gain: r.gain,
    })
}

/// Frontiers as a message.
pub fn frontiers_to(answer: &Explored<Vec<Frontier>>) -> v1::FindFrontiersResponse {
    let frontier = |f: &Frontier| {
        let every = f.cells.len().div_ceil(MAX_CELLS).max(1);
        let vector = |p: &nalgebra::Point2<f64>| v1::Vector2 { x: p.x, y: p.y };
        v1::Frontier {
            goal: Some(vector(&f.goal)),
            cost: f.cost,
            length_m: f.size_m,
            cells: f.cells.iter().step_by(every).map(vector).collect(),
        }
    };
    v1::FindFrontiersResponse {
        frontiers: answer.outcome.iter().flatten().map(frontier).collect(),
        stamp: Some(maps::stamp_to(answer.map_version, answer.stamp)),
    }
}

/// What a path in space is asked for.
///
/// # Errors
/// Naming the field.
pub fn flight(r: &v1::PlanFlightRequest) -> Result<FlightQuestion> {
    let usual = FlightParams::default();
    let asked = r.options.clone().unwrap_or_default();
    let planner = match v1::FlightPlanner::try_from(asked.planner) {
        Ok(v1::FlightPlanner::Unspecified | v1::FlightPlanner::AnyAngle) => FlightPlanner::AnyAngle,
        Ok(v1::FlightPlanner::Lattice) => FlightPlanner::Lattice,
        Err(_) => return Err(super::unknown_enum("options.planner", asked.planner)),
    };
    let point = |field: &'static str, v: &v1::Vector3| geometry::vector(field, v).map(Into::into);
    Ok(FlightQuestion {
        start: r.start.as_ref().map(|s| point("start", s)).transpose()?,
        goal: point("goal", &required("goal", r.goal)?)?,
        region: layers::box3(r.region.as_ref())?,
        params: FlightParams {
            robot_radius_m: asked.robot_radius_m.unwrap_or(usual.robot_radius_m),
            occupied_probability: asked.occupied_probability.unwrap_or(usual.occupied_probability),
            allow_unknown: asked.allow_unknown,
            start_tolerance_m: asked.start_tolerance_m.unwrap_or(usual.start_tolerance_m),
            min_z_m: asked.min_z_m,
            max_z_m: asked.max_z_m,
            ..usual
        },
        planner,
        zones: zones(&asked.zones)?,
        ignores_session_zones: asked.ignore_session_zones,
        deadline: (asked.deadline_ms > 0).then(|| Duration::from_millis(asked.deadline_ms.into())),
    })
}

/// A path in space, or why there is none.
pub fn flown_to(answer: &Explored<FlightOutcome>) -> v1::PlanFlightResponse {
    use v1::plan_flight_response::Outcome;
    let vector = |p: &nalgebra::Point3<f64>| geometry::vector_to(&p.coords);
    let outcome = match &answer.outcome {
        Some(FlightOutcome::Path(path)) => Outcome::Path(v1::FlightPath {
            waypoints: path.waypoints.iter().map(vector).collect(),
            length_m: path.length_m,
            min_clearance_m: path.min_clearance_m,
            bound: path.bound,
            is_final: path.is_final,
        }),
        none => {
            let (reason, blocking) = match none {
                Some(FlightOutcome::NoPath { reason, blocking }) => (Some(*reason), *blocking),
                _ => (None, None),
            };
            let (told, words) = reason_to(reason);
            let detail = match reason {
                Some(NoPathReason::StartInKeepOut | NoPathReason::GoalInKeepOut) => {
                    format!("{words}, or below min_z_m or above max_z_m")
                }
                Some(NoPathReason::StartOutsideMap | NoPathReason::GoalOutsideMap) => {
                    format!("{words}, or of the region that was asked for")
                }
                _ => words.to_owned(),
            };
            let state = blocking.map_or(v1::BlockingState::Unspecified, |b| match b.state {
                CellState::Unknown => v1::BlockingState::Unknown,
                CellState::KeepOut => v1::BlockingState::KeepOut,
                _ => v1::BlockingState::Occupied,
            });
            Outcome::NoPath(v1::NoFlight {
                reason: told.into(),
                detail,
                position: blocking.map(|b| vector(&b.position)),
                obstacle: blocking.map(|b| vector(&b.obstacle)),
                state: state.into(),
            })
        }
    };
    v1::PlanFlightResponse { outcome: Some(outcome), stamp: Some(maps::stamp_to(answer.map_version, answer.stamp)) }
}
