//! Paths through a session's map, and one call for one step of a robot.

use crate::reason;
use crate::{Error, IncomingFrame, Processed, Result, Service};
use nalgebra::Point2;
use percept_geometry::Timestamp;
use percept_pipeline::{PoseEstimate, Snapshot};
use percept_planning::{PlanError, PlanOutcome, PlanParams};
use percept_scene::{Object, ObjectState};
use percept_slam::TrackingState;
use std::sync::Arc;

/// Objects within this distance of the robot are obstacles in the answer to [`Service::navigate`], metres.
const OBSTACLE_RANGE_M: f64 = 5.0;

/// What a path is asked for.
#[derive(Debug, Clone)]
pub struct PlanRequest {
    /// Where from, map frame, metres; none: where the robot is.
    pub start: Option<Point2<f64>>,
    /// Where to, map frame, metres.
    pub goal: Point2<f64>,
    /// How; none: as the session is set.
    pub params: Option<PlanParams>,
}

/// A path, or why there is none.
#[derive(Debug, Clone)]
pub struct Plan {
    /// The planner's answer; none if no start was given and the robot does not know where it is.
    pub outcome: Option<PlanOutcome>,
    /// Version of the map that was searched.
    pub map_version: u64,
    /// Stamp of the newest frame in it.
    pub stamp: Timestamp,
}

/// The answer to one step.
#[derive(Debug, Clone)]
pub struct Navigation {
    /// What the message did.
    pub processed: Processed,
    /// Pose after it.
    pub pose: Option<PoseEstimate>,
    /// Objects near the robot.
    pub obstacles: Vec<Object>,
    /// The path.
    pub plan: Plan,
}

impl Service {
    /// A path through a session's map.
    ///
    /// # Errors
    /// Coordinates or parameters out of bounds, `GRID_TOO_LARGE`, `SESSION_NOT_FOUND`.
    pub async fn plan_path(&self, session: &str, request: PlanRequest) -> Result<Plan> {
        let snapshot = self.snapshot(session).await?;
        self.plan_on(session, snapshot, request).await
    }

    async fn plan_on(&self, session: &str, snapshot: Arc<Snapshot>, request: PlanRequest) -> Result<Plan> {
        let max_cells = self.limits.max_planning_cells;
        self.compute.query(&self.asker(session)?, move || plan(&snapshot, &request, max_cells)).await?
    }

    /// A sensor message and a goal in; pose, obstacles and path out.
    ///
    /// # Errors
    /// As [`Service::send_frame`] and [`Service::plan_path`].
    pub async fn navigate(&self, incoming: IncomingFrame, mut request: PlanRequest) -> Result<Navigation> {
        request.start = None;
        let id = incoming.session.clone();
        let (session, processed) = self.send_frame(incoming).await?;
        let snapshot = session.snapshot();
        let pose = snapshot.pose.clone();
        let obstacles = pose.as_ref().map(|p| near(&snapshot, p)).unwrap_or_default();
        let plan = self.plan_on(&id, snapshot, request).await?;
        Ok(Navigation { processed, pose, obstacles, plan })
    }
}

fn near(snapshot: &Snapshot, pose: &PoseEstimate) -> Vec<Object> {
    let robot = pose.t_map_base.translation.vector;
    let is_near = |o: &&Object| {
        o.state != ObjectState::Gone && (o.bbox.center().coords.xy() - robot.xy()).norm() <= OBSTACLE_RANGE_M
    };
    snapshot.objects.iter().filter(is_near).copied().collect()
}

/// Plans on a snapshot.
///
/// # Errors
/// Coordinates or parameters out of bounds, `GRID_TOO_LARGE`.
pub fn plan(snapshot: &Snapshot, request: &PlanRequest, max_cells: usize) -> Result<Plan> {
    let stamp = snapshot.pose.as_ref().map(|p| p.stamp).unwrap_or_default();
    let map_version = snapshot.map_version;
    let is_known = |p: &&PoseEstimate| !matches!(p.state, TrackingState::Lost { .. }) && p.scale.is_metric();
    let known = snapshot.pose.as_ref().filter(is_known);
    let robot = known.map(|p| Point2::from(p.t_map_base.translation.vector.xy()));
    let Some(start) = request.start.or(robot) else {
        return Ok(Plan { outcome: None, map_version, stamp });
    };
    let mut params = request.params.unwrap_or(snapshot.params.planning);
    params.max_cells = params.max_cells.min(max_cells);
    let outcome = percept_planning::plan(&snapshot.layers.occupancy, start, request.goal, &params);
    Ok(Plan { outcome: Some(outcome.map_err(plan_error)?), map_version, stamp })
}

fn plan_error(e: PlanError) -> Error {
    match e {
        PlanError::InvalidParam { field, value, remedy } => Error::invalid(
            reason::PARAMETER_OUT_OF_RANGE,
            format!("params.{field}"),
            format!("{field} is {value}; {remedy}"),
        ),
        PlanError::NotFinite { field, value } => {
            Error::invalid(reason::OUT_OF_RANGE, field, format!("{field} is {value}; it must be finite"))
        }
        PlanError::GridTooLarge { cells, limit } => Error::exhausted(
            reason::GRID_TOO_LARGE,
            "source",
            format!("the map has {cells} cells, a search looks at {limit} at most; use a coarser resolution_m"),
        ),
        PlanError::Map(e) => Error::internal(e),
    }
}
