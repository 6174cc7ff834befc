//! Paths through a session's map, and one call for one step of a robot.

use super::layers::at_most;
use super::maps::stamp_of;
use super::zone_masks::SessionMask;
use super::zones::{Zones, zones_of};
use crate::reason;
use crate::{Error, IncomingFrame, Processed, Result, Service};
use nalgebra::{Point2, Point3, Vector3};
use percept_geometry::{Timestamp, se3};
use percept_mapping::height::Storey;
use percept_mapping::{DenseGrid, MappingError, Occupancy, OccupancyMap};
use percept_pipeline::{PoseEstimate, Snapshot};
use percept_planning::{
    Blocking, Footprint, Goal, Mask, Misfit, MisfitReason, NoPathReason, PathRequest, PlanError, PlanOutcome,
    PlanParams, Planner, Pose2, SpeedLimits, Zone,
};
use percept_scene::{Object, ObjectId, ObjectState};
use percept_slam::TrackingState;
use std::sync::Arc;
use std::time::{Duration, Instant};

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
    /// What else is asked.
    pub options: PathOptions,
}

/// What is asked of a path beside its ends and the session's parameters.
#[derive(Debug, Clone, Default)]
pub struct PathOptions {
    /// How it is searched.
    pub planner: Planner,
    /// Heading to begin with, radians; none: the robot's where the path starts where it is, else 0.
    pub start_yaw_rad: Option<f64>,
    /// Heading to end with, radians; none: any.
    pub goal_yaw_rad: Option<f64>,
    /// What the robot covers; none: a disc of `robot_radius_m`.
    pub footprint: Option<Footprint>,
    /// Where it may not be, or not be fast, besides the zones of the session.
    pub zones: Vec<Zone>,
    /// The same cell by cell.
    pub masks: Vec<SessionMask>,
    /// Over the ground of this storey; none: through the grid, which has one floor.
    pub storey: Option<Storey>,
    /// Whether the zones of the session do not count.
    pub ignores_session_zones: bool,
    /// Whether the map alone counts, and not what the newest frames see.
    pub is_map_only: bool,
    /// For times along the path.
    pub speed: SpeedLimits,
    /// The search ends with the best path so far after this; none: when it is done.
    pub deadline: Option<Duration>,
}

/// A path's first place that the robot cannot drive, and of which state of the map that is true.
#[derive(Debug, Clone)]
pub struct PathCheck {
    /// None: all of it can be driven.
    pub misfit: Option<Misfit>,
    /// The object that stands in the way, if one is known.
    pub object: Option<ObjectId>,
    /// Version of the map.
    pub map_version: u64,
    /// Stamp of the newest frame in it.
    pub stamp: Timestamp,
}

impl PathOptions {
    /// With the zones of the session, unless they do not count.
    pub(super) fn in_zones(mut self, stored: &Zones) -> Self {
        if !self.ignores_session_zones {
            self.zones.extend_from_slice(&stored.areas);
            self.masks.extend_from_slice(&stored.masks);
        }
        self
    }

    /// Its masks as planning has them.
    pub(super) fn planning_masks(&self) -> Vec<Mask<'_>> {
        self.masks.iter().map(|mask| mask.mask(self.speed.max_speed_mps)).collect()
    }

    /// The whole question. `stop` is asked while a search with a deadline goes on.
    pub(super) fn request<'a>(
        &'a self,
        (start, yaw_rad): (Point2<f64>, f64),
        goal: Point2<f64>,
        params: &'a PlanParams,
        masks: &'a [Mask<'a>],
        stop: Option<&'a (dyn Fn() -> bool + Sync)>,
    ) -> PathRequest<'a> {
        PathRequest {
            start: Pose2 { position: start, yaw_rad: self.start_yaw_rad.unwrap_or(yaw_rad) },
            goal: Goal { position: goal, yaw_rad: self.goal_yaw_rad },
            params,
            planner: self.planner,
            footprint: self.footprint.as_ref(),
            zones: &self.zones,
            masks,
            speed: self.speed,
            stop,
        }
    }
}

/// Why a robot's own place is no start.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum NoStart {
    /// It does not know where it is.
    #[default]
    Lost,
    /// It knows, but in a unit of its own: one camera alone does not tell lengths.
    ScaleUnknown,
}

/// A path, or why there is none.
#[derive(Debug, Clone)]
pub struct Plan {
    /// The planner's answer; none if no start was given and the robot does not know where it is, which `no_start` explains.
    pub outcome: Option<PlanOutcome>,
    /// Why the robot's own place is no start.
    pub no_start: NoStart,
    /// The object that stands in the way, if there is no path and one is known.
    pub object: Option<ObjectId>,
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
        let (snapshot, zones) = self.snapshot_with_zones(session).await?;
        let options = request.options.in_zones(&zones);
        self.plan_on(session, snapshot, PlanRequest { options, ..request }).await
    }

    /// A session's snapshot, and its zones.
    pub(super) async fn snapshot_with_zones(&self, session: &str) -> Result<(Arc<Snapshot>, Zones)> {
        let session = self.session(session).await?;
        Ok((session.snapshot(), zones_of(&session.meta())))
    }

    async fn plan_on(&self, session: &str, snapshot: Arc<Snapshot>, request: PlanRequest) -> Result<Plan> {
        let max_cells = self.limits.max_planning_cells;
        self.compute.query(&self.asker(session)?, move || plan(&snapshot, &request, max_cells)).await?
    }

    /// The first place of a path that the robot cannot drive, as the map is now.
    ///
    /// # Errors
    /// As [`Service::plan_path`]; `TOO_MANY_QUERIES`.
    pub async fn validate_path(
        &self,
        session: &str,
        poses: Vec<Pose2>,
        params: Option<PlanParams>,
        options: PathOptions,
    ) -> Result<PathCheck> {
        at_most("poses", poses.len(), MAX_POSES)?;
        let (snapshot, zones) = self.snapshot_with_zones(session).await?;
        let (options, max_cells) = (options.in_zones(&zones), self.limits.max_planning_cells);
        let work = move || misfit_on(&snapshot, &poses, params, &options, max_cells);
        self.compute.query(&self.asker(session)?, work).await?
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
        request.options = request.options.in_zones(&zones_of(&session.meta()));
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
    snapshot.objects.iter().filter(is_near).cloned().collect()
}

/// Where the robot is and looks, if it knows: map frame, metres, radians. A pose that nothing measured is known of the very first
/// frame, which the map begins with; later it is where the robot was before the server stopped, or a guess.
pub(super) fn known_pose(snapshot: &Snapshot) -> Option<(Point2<f64>, f64)> {
    let is_placed = |p: &&PoseEstimate| match p.state {
        TrackingState::Tracking => true,
        TrackingState::Initialising => snapshot.trajectory().nth(1).is_none(),
        TrackingState::Lost { .. } => false,
    };
    let is_known = |p: &&PoseEstimate| is_placed(p) && p.scale.is_metric();
    let pose = snapshot.pose.as_ref().filter(is_known)?;
    Some((pose.t_map_base.translation.vector.xy().into(), se3::yaw(&pose.t_map_base)))
}

/// Why [`known_pose`] knows none.
pub(super) fn no_start(snapshot: &Snapshot) -> NoStart {
    let is_tracked = |p: &PoseEstimate| p.state.is_tracking();
    let is_measured = |p: &PoseEstimate| p.scale.is_metric();
    match &snapshot.pose {
        Some(pose) if is_tracked(pose) && !is_measured(pose) => NoStart::ScaleUnknown,
        _ => NoStart::Lost,
    }
}

/// Plans on a snapshot.
///
/// # Errors
/// Coordinates or parameters out of bounds, `GRID_TOO_LARGE`.
pub fn plan(snapshot: &Snapshot, request: &PlanRequest, max_cells: usize) -> Result<Plan> {
    let (stamp, map_version) = (stamp_of(snapshot), snapshot.map_version);
    let mut params = request.params.unwrap_or(snapshot.params.planning);
    params.max_cells = params.max_cells.min(max_cells);
    let grid = ground(snapshot, &request.options, params.max_cells)?;
    let Some(start) = request.start.map(|start| (start, 0.0)).or(known_pose(snapshot)) else {
        check(request.goal, &params, &request.options)?;
        let no_start = no_start(snapshot);
        return Ok(Plan { outcome: None, no_start, object: None, map_version, stamp });
    };
    let outcome = on_grid(&grid, start, request.goal, &params, &request.options)?;
    let object = match &outcome {
        PlanOutcome::NoPath { blocking: Some(blocking), .. } => object_at(snapshot, blocking),
        _ => None,
    };
    Ok(Plan { outcome: Some(outcome), no_start: NoStart::default(), object, map_version, stamp })
}

/// The first place of a path that does not fit on a snapshot.
///
/// # Errors
/// As [`plan`]; `TOO_MANY_QUERIES`.
pub(super) fn misfit_on(
    snapshot: &Snapshot,
    poses: &[Pose2],
    params: Option<PlanParams>,
    options: &PathOptions,
    max_cells: usize,
) -> Result<PathCheck> {
    let mut params = params.unwrap_or(snapshot.params.planning);
    params.max_cells = params.max_cells.min(max_cells);
    let misfit = misfit(&ground(snapshot, options, params.max_cells)?, poses, &params, options)?;
    let blocking = misfit.as_ref().and_then(|m| match &m.reason {
        MisfitReason::Blocked(blocking) => Some(blocking),
        _ => None,
    });
    let object = blocking.and_then(|b| object_at(snapshot, b));
    Ok(PathCheck { misfit, object, map_version: snapshot.map_version, stamp: stamp_of(snapshot) })
}

/// Plans on a grid, from a position and a heading.
///
/// # Errors
/// Coordinates or parameters out of bounds, `GRID_TOO_LARGE`.
pub fn on_grid(
    grid: &DenseGrid,
    start: (Point2<f64>, f64),
    goal: Point2<f64>,
    params: &PlanParams,
    options: &PathOptions,
) -> Result<PlanOutcome> {
    let begun = Instant::now();
    let stop = options.deadline.map(|deadline| move || begun.elapsed() >= deadline);
    let stop = stop.as_ref().map(|stop| stop as &(dyn Fn() -> bool + Sync));
    let masks = options.planning_masks();
    percept_planning::plan_path(grid, &options.request(start, goal, params, &masks, stop)).map_err(plan_error)
}

/// What is wrong with a question is told also where nobody knows where the robot is.
///
/// # Errors
/// As [`on_grid`], but for the grid.
pub(super) fn check(goal: Point2<f64>, params: &PlanParams, options: &PathOptions) -> Result<()> {
    let masks = options.planning_masks();
    options.request((goal, 0.0), goal, params, &masks, None).validate().map_err(plan_error)
}

/// The first place of a path on a grid that does not fit.
///
/// # Errors
/// As [`on_grid`]; `TOO_MANY_QUERIES`.
pub fn misfit(grid: &DenseGrid, poses: &[Pose2], params: &PlanParams, options: &PathOptions) -> Result<Option<Misfit>> {
    at_most("poses", poses.len(), MAX_POSES)?;
    let (nowhere, masks) = (Point2::origin(), options.planning_masks());
    let request = options.request((nowhere, 0.0), nowhere, params, &masks, None);
    percept_planning::validate_path(grid, poses, &request).map_err(plan_error)
}

/// What is planned on: the grid, as the newest frames see it unless the map alone counts, or the ground of a storey.
///
/// # Errors
/// `GRID_TOO_LARGE`; `LAYER_OFF` for a storey where no heights are kept.
pub(super) fn ground(snapshot: &Snapshot, options: &PathOptions, max_cells: usize) -> Result<DenseGrid> {
    match options.storey {
        None if options.is_map_only => dense(&snapshot.layers.occupancy, max_cells),
        None => dense(&snapshot.grid_now(), max_cells),
        Some(storey) => super::layers::drivable(&snapshot.layers, storey, max_cells)
            .map_err(|e| Error { field: "options.storey".to_owned(), ..e }),
    }
}

fn dense(grid: &OccupancyMap, max_cells: usize) -> Result<DenseGrid> {
    grid.dense(max_cells).map_err(|e| match e {
        MappingError::RegionTooLarge { cells, limit } => plan_error(PlanError::GridTooLarge { cells, limit }),
        e => Error::internal(e),
    })
}

/// Poses of a path that is checked.
pub(super) const MAX_POSES: usize = 100_000;
/// An object's box ends so far from cells that it fills, metres: a cell of 0.1 m to each side.
const BESIDE_M: f64 = 0.1;

/// The object that stands where something blocks.
pub(super) fn object_at(snapshot: &Snapshot, blocking: &Blocking) -> Option<ObjectId> {
    let holds = |o: &&Object| {
        let mut bbox = o.bbox;
        bbox.size += Vector3::repeat(2.0 * BESIDE_M);
        let p = &blocking.obstacle;
        o.state != ObjectState::Gone && bbox.contains(&Point3::new(p.x, p.y, bbox.center().z))
    };
    let volume = |o: &&Object| o.bbox.volume();
    let found = snapshot.objects.iter().filter(holds);
    found.min_by(|a, b| volume(a).total_cmp(&volume(b))).map(|o| o.id)
}

/// Why the robot's own place is no start, in words with a remedy.
pub fn words_of_no_start(why: NoStart) -> &'static str {
    match why {
        NoStart::Lost => words_of(None),
        NoStart::ScaleUnknown => {
            "no start was given, and the robot's place is in a unit of its own, since one camera alone does not tell lengths; \
             send wheel odometry, depth images or a second camera's images along"
        }
    }
}

/// Why there is no path, in words; none: no start was given and the robot does not know where it is.
pub fn words_of(reason: Option<NoPathReason>) -> &'static str {
    match reason {
        None => "no start was given and the robot does not know where it is; let it send frames, or give a start",
        Some(NoPathReason::StartOutsideMap) => "the start lies outside of what was mapped",
        Some(NoPathReason::StartOccupied) => "the start is in an obstacle",
        Some(NoPathReason::StartDoesNotFit) => "the start is free, but nearer to an obstacle than the robot needs",
        Some(NoPathReason::StartInKeepOut) => "the start is in a keep-out zone",
        Some(NoPathReason::StartUnknown) => "the start lies where nothing was seen yet",
        Some(NoPathReason::GoalOutsideMap) => "the goal lies outside of what was mapped",
        Some(NoPathReason::GoalOccupied) => "the goal is in an obstacle",
        Some(NoPathReason::GoalDoesNotFit) => "the goal is free, but nearer to an obstacle than the robot needs",
        Some(NoPathReason::GoalInKeepOut) => "the goal is in a keep-out zone",
        Some(NoPathReason::GoalUnknown) => "the goal lies where nothing was seen yet",
        Some(NoPathReason::Unreachable) => "no way wide enough for the robot joins start and goal",
        Some(NoPathReason::NotSteerable) => "a way is wide enough, but not with this footprint and turning radius",
        Some(NoPathReason::SearchLimit) => "the search was stopped at max_expansions before it found a path",
        Some(NoPathReason::Stopped) => "deadline_ms was over before a path was found",
    }
}

pub(super) fn plan_error(e: PlanError) -> Error {
    match e {
        PlanError::InvalidParam { field, value, remedy } => {
            let place = place_of(field);
            let message = match field {
                // What is told is not the field's value, but what is wrong with it.
                "footprint.polygon" | "zones.polygon" => format!("{place} cannot be taken ({value}): {remedy}"),
                _ => format!("{place} is {value}; {remedy}"),
            };
            Error::invalid(reason::PARAMETER_OUT_OF_RANGE, place, message)
        }
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

/// Where a field of the planner's stands in a request.
fn place_of(field: &str) -> String {
    match field.split_once('.') {
        None => format!("params.{field}"),
        Some(("hybrid", rest)) => format!("options.steering.{rest}"),
        Some(("coverage", _)) => field.to_owned(),
        Some(("footprint", _)) => "options.footprint".to_owned(),
        Some(("zones", "share")) => "options.zones.speed_share".to_owned(),
        Some(_) => format!("options.{field}"),
    }
}
