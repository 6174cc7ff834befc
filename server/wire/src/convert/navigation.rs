//! Requests for paths, and paths.

use super::{geometry, maps, required, scene, sessions};
use crate::{params, v1};
use percept_pipeline::PipelineParams;
use percept_planning::{NoPathReason, PlanOutcome};
use percept_service::{Navigation, Plan, PlanRequest, Result};

/// What a path is asked for; parameters that are set replace the session's.
///
/// # Errors
/// Naming the field.
pub fn request(
    start: Option<&v1::Vector2>,
    goal: Option<&v1::Vector2>,
    sent: Option<&v1::PlanningParams>,
    session: &PipelineParams,
) -> Result<PlanRequest> {
    Ok(PlanRequest {
        start: start.map(|s| geometry::point2("start", s)).transpose()?,
        goal: geometry::point2("goal", required("goal", goal)?)?,
        params: Some(params::planning(sent, &session.planning)?),
    })
}

fn reason_to(reason: NoPathReason) -> (v1::NoPathReason, &'static str) {
    use v1::NoPathReason as R;
    match reason {
        NoPathReason::StartOutsideMap => (R::StartOutsideMap, "the start lies outside of what was mapped"),
        NoPathReason::StartOccupied => {
            (R::StartOccupied, "the start is in an obstacle, or nearer to one than the robot's radius")
        }
        NoPathReason::StartUnknown => (R::StartUnknown, "the start lies where nothing was seen yet"),
        NoPathReason::GoalOutsideMap => (R::GoalOutsideMap, "the goal lies outside of what was mapped"),
        NoPathReason::GoalOccupied => {
            (R::GoalOccupied, "the goal is in an obstacle, or nearer to one than the robot's radius")
        }
        NoPathReason::GoalUnknown => (R::GoalUnknown, "the goal lies where nothing was seen yet"),
        NoPathReason::Unreachable => (R::Unreachable, "no way wide enough for the robot joins start and goal"),
        NoPathReason::SearchLimit => {
            (R::SearchLimit, "the search was stopped at max_expansions before it found a path")
        }
    }
}

fn path_to(p: &percept_planning::Path) -> v1::Path {
    let waypoint =
        |w: &percept_planning::Waypoint| v1::Pose2 { x_m: w.position.x, y_m: w.position.y, yaw_rad: w.yaw_rad };
    v1::Path {
        waypoints: p.waypoints.iter().map(waypoint).collect(),
        length_m: p.length_m,
        cost: p.cost,
        min_clearance_m: p.min_clearance_m,
    }
}

fn outcome_to(plan: &Plan) -> std::result::Result<v1::Path, v1::NoPath> {
    match &plan.outcome {
        Some(PlanOutcome::Path(p)) => Ok(path_to(p)),
        Some(PlanOutcome::NoPath { reason }) => {
            let (reason, detail) = reason_to(*reason);
            Err(v1::NoPath { reason: reason.into(), detail: detail.to_owned() })
        }
        None => Err(v1::NoPath {
            reason: v1::NoPathReason::Lost.into(),
            detail: "no start was given and the robot does not know where it is".to_owned(),
        }),
    }
}

/// A path, or why there is none, as a message.
pub fn plan_to(plan: &Plan) -> v1::PlanPathResponse {
    use v1::plan_path_response::Outcome;
    let outcome = outcome_to(plan).map_or_else(Outcome::NoPath, Outcome::Path);
    v1::PlanPathResponse { outcome: Some(outcome), stamp: Some(maps::stamp_to(plan.map_version, plan.stamp)) }
}

/// The answer to one step as a message.
pub fn navigation_to(n: &Navigation) -> v1::NavigateResponse {
    use v1::navigate_response::Outcome;
    let outcome = outcome_to(&n.plan).map_or_else(Outcome::NoPath, Outcome::Path);
    v1::NavigateResponse {
        frame: Some(sessions::result_to(&n.processed)),
        pose: n.pose.as_ref().map(sessions::pose_to),
        obstacles: n.obstacles.iter().map(scene::object_to).collect(),
        outcome: Some(outcome),
        stamp: Some(maps::stamp_to(n.plan.map_version, n.plan.stamp)),
    }
}
