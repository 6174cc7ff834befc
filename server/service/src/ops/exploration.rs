//! Paths that cover, frontiers, paths in space.

use super::maps::stamp_of;
use super::navigation::{PathOptions, PlanRequest, check, ground, known_pose, plan_error};
use crate::{Error, ErrorCode, Result, Service, Zones, reason};
use nalgebra::{Point2, Point3, Vector2};
use percept_geometry::{Aabb3, GridGeometry, Timestamp};
use percept_mapping::DenseGrid;
use percept_pipeline::Snapshot;
use percept_planning::flight::{DenseVoxels, FlightOutcome, FlightParams, FlightPlanner, FlightRequest, plan_flight};
use percept_planning::{
    CoverageOutcome, CoverageParams, Frontier, PlanError, PlanParams, Zone, frontiers, plan_coverage, rank_frontiers,
};
use std::time::{Duration, Instant};

/// An answer, and of which state of the map it is true.
#[derive(Debug, Clone)]
pub struct Explored<T> {
    /// None if no start was given and the robot does not know where it is.
    pub outcome: Option<T>,
    /// Version of the map.
    pub map_version: u64,
    /// Stamp of the newest frame in it.
    pub stamp: Timestamp,
}

impl<T> Explored<T> {
    fn of(snapshot: &Snapshot, outcome: Option<T>) -> Self {
        Self { outcome, map_version: snapshot.map_version, stamp: stamp_of(snapshot) }
    }
}

/// Which frontiers are asked for.
#[derive(Debug, Clone)]
pub struct FrontierRequest {
    /// Where from, map frame, metres; none: where the robot is.
    pub start: Option<Point2<f64>>,
    /// How; none: as the session is set.
    pub params: Option<PlanParams>,
    /// Footprint, zones and storey; the rest does not count.
    pub options: PathOptions,
    /// Those of less length are left out, metres.
    pub min_length_m: f64,
    /// How many metres of way a metre of frontier is worth.
    pub gain: f64,
}

/// What a path in space is asked for.
#[derive(Debug, Clone)]
pub struct FlightQuestion {
    /// Where from, map frame, metres; none: where base is.
    pub start: Option<Point3<f64>>,
    /// Where to, map frame, metres.
    pub goal: Point3<f64>,
    /// Part of the map that is searched; none: all.
    pub region: Option<Aabb3>,
    /// The robot, and limits.
    pub params: FlightParams,
    /// How it is searched.
    pub planner: FlightPlanner,
    /// Where it may not be, besides the zones of the session.
    pub zones: Vec<Zone>,
    /// Whether the zones of the session do not count.
    pub ignores_session_zones: bool,
    /// The search is given up after this; none: when it is done.
    pub deadline: Option<Duration>,
}

/// Around a grid in which frontiers are looked for: the search's own rim is one cell.
const MARGIN_CELLS: usize = 2;
/// Voxels of a box that is searched: a byte each, and some 20 while it is.
const MAX_FLIGHT_VOXELS: usize = 32_000_000;

impl Service {
    /// A path that covers what the robot reaches.
    ///
    /// # Errors
    /// As [`Service::plan_path`].
    pub async fn plan_coverage(
        &self,
        session: &str,
        request: PlanRequest,
        coverage: CoverageParams,
    ) -> Result<Explored<CoverageOutcome>> {
        let (snapshot, zones) = self.snapshot_with_zones(session).await?;
        let max_cells = self.limits.max_planning_cells;
        let work = move || covered(&snapshot, request, &zones, &coverage, max_cells);
        self.compute.query(&self.asker(session)?, work).await?
    }

    /// Edges of what is known that the robot reaches, what is worth most first.
    ///
    /// # Errors
    /// As [`Service::plan_path`]; `NO_POSE_YET` without a start.
    pub async fn find_frontiers(&self, session: &str, request: FrontierRequest) -> Result<Explored<Vec<Frontier>>> {
        let (snapshot, zones) = self.snapshot_with_zones(session).await?;
        let max_cells = self.limits.max_planning_cells;
        let work = move || edges_of_known(&snapshot, request, &zones, max_cells);
        self.compute.query(&self.asker(session)?, work).await?
    }

    /// A path in space through the voxels of the map.
    ///
    /// # Errors
    /// `LAYER_OFF`, `GRID_TOO_LARGE`, coordinates or parameters out of bounds, `SESSION_NOT_FOUND`.
    pub async fn plan_flight(&self, session: &str, question: FlightQuestion) -> Result<Explored<FlightOutcome>> {
        let (snapshot, zones) = self.snapshot_with_zones(session).await?;
        self.compute.query(&self.asker(session)?, move || flown(&snapshot, &question, &zones)).await?
    }
}

/// A grid with nothing known around it: what is free at its edge borders on that.
fn with_margin(grid: &DenseGrid, margin: usize) -> DenseGrid {
    let (width, height) = (grid.width + 2 * margin, grid.height + 2 * margin);
    let mut cells = vec![-1; width * height];
    for (y, row) in grid.cells.chunks_exact(grid.width.max(1)).enumerate() {
        let at = (y + margin) * width + margin;
        cells[at..at + row.len()].copy_from_slice(row);
    }
    let shift = margin as f64 * grid.geometry.resolution_m;
    let geometry = GridGeometry::new(grid.geometry.resolution_m, grid.geometry.origin.map(|v| v - shift));
    DenseGrid { geometry, width, height, cells }
}

fn limited(params: PlanParams, max_cells: usize) -> PlanParams {
    PlanParams { max_cells: params.max_cells.min(max_cells), ..params }
}

/// Frontiers of the map: who stands in the way for now will be elsewhere before the robot is there.
fn edges_of_known(
    snapshot: &Snapshot,
    request: FrontierRequest,
    zones: &Zones,
    max_cells: usize,
) -> Result<Explored<Vec<Frontier>>> {
    let is_given = request.start.is_some();
    let start = request.start.or(known_pose(snapshot).map(|(position, _)| position));
    let start = start.ok_or_else(|| {
        let message = "the robot does not know where it is; give a start";
        Error::new(ErrorCode::FailedPrecondition, reason::NO_POSE_YET, message)
    })?;
    let params = limited(request.params.unwrap_or(snapshot.params.planning), max_cells);
    let options = PathOptions { is_map_only: true, ..request.options.in_zones(zones) };
    let grid = ground(snapshot, &options, params.max_cells)?;
    if is_given {
        check_free(&grid, &start, &params)?;
    }
    let found = frontiers_on(&grid, start, (request.min_length_m, request.gain), &params, &options)?;
    Ok(Explored::of(snapshot, Some(found)))
}

/// Whether frontiers may be looked for from a place that was given: from others there would seem to be none.
///
/// # Errors
/// `OUT_OF_RANGE` if it is outside of the map, in an obstacle, or where nothing is known.
pub fn check_free(grid: &DenseGrid, start: &Point2<f64>, params: &PlanParams) -> Result<()> {
    let value_at = |p: &Point2<f64>| {
        let cell = grid.geometry.cell(p)?;
        let (x, y) = (usize::try_from(cell.x).ok()?, usize::try_from(cell.y).ok()?);
        (x < grid.width && y < grid.height).then(|| grid.cells.get(y * grid.width + x).copied()).flatten()
    };
    let is_occupied = |value: i8| f64::from(value) >= 100.0 * params.occupied_probability;
    // A robot may stand a little beside where it is free, as when a path is planned.
    let steps = (params.start_tolerance_m / grid.geometry.resolution_m).min(20.0) as i32;
    let beside = (-steps..=steps).flat_map(|y| (-steps..=steps).map(move |x| Vector2::new(f64::from(x), f64::from(y))));
    let mut near = beside.filter_map(|by| value_at(&(start + by * grid.geometry.resolution_m)));
    if near.any(|value| value >= 0 && !is_occupied(value)) {
        return Ok(());
    }
    let what = match value_at(start) {
        None => "outside of the map",
        Some(value) if is_occupied(value) => "in an obstacle",
        Some(_) => "where nothing is known",
    };
    let message = format!("start ({}, {}) is {what}; choose a place that is free", start.x, start.y);
    Err(Error::invalid(reason::OUT_OF_RANGE, "start", message))
}

/// Frontiers of a grid, of at least so many metres, what is worth most by this gain first.
///
/// # Errors
/// As [`on_grid`](super::navigation::on_grid).
pub fn frontiers_on(
    grid: &DenseGrid,
    start: Point2<f64>,
    (min_length_m, gain): (f64, f64),
    params: &PlanParams,
    options: &PathOptions,
) -> Result<Vec<Frontier>> {
    let grid = with_margin(grid, MARGIN_CELLS);
    let least = (min_length_m / grid.geometry.resolution_m).ceil().max(1.0) as usize;
    let masks = options.planning_masks();
    let asked = options.request((start, 0.0), start, params, &masks, None);
    let mut found = frontiers(&grid, &asked, least).map_err(plan_error)?;
    rank_frontiers(&mut found, gain).map_err(|e| Error { field: "gain".to_owned(), ..plan_error(e) })?;
    Ok(found)
}

fn covered(
    snapshot: &Snapshot,
    request: PlanRequest,
    zones: &Zones,
    coverage: &CoverageParams,
    max_cells: usize,
) -> Result<Explored<CoverageOutcome>> {
    let params = limited(request.params.unwrap_or(snapshot.params.planning), max_cells);
    // Who stands in the way for now will be elsewhere before all is covered.
    let options = PathOptions { is_map_only: true, ..request.options.in_zones(zones) };
    let grid = ground(snapshot, &options, params.max_cells)?;
    let start = request.start.map(|start| (start, 0.0)).or(known_pose(snapshot));
    let Some(start) = start else {
        check(Point2::origin(), &params, &options)?;
        return Ok(Explored::of(snapshot, None));
    };
    Ok(Explored::of(snapshot, Some(coverage_on(&grid, start, coverage, &params, &options)?)))
}

/// A path over a grid that covers what is reached from a position; the heading there does not count.
///
/// # Errors
/// As [`on_grid`](super::navigation::on_grid).
pub fn coverage_on(
    grid: &DenseGrid,
    start: (Point2<f64>, f64),
    coverage: &CoverageParams,
    params: &PlanParams,
    options: &PathOptions,
) -> Result<CoverageOutcome> {
    let begun = Instant::now();
    let stop = options.deadline.map(|deadline| move || begun.elapsed() >= deadline);
    let stop = stop.as_ref().map(|stop| stop as &(dyn Fn() -> bool + Sync));
    let masks = options.planning_masks();
    plan_coverage(grid, &options.request(start, start.0, params, &masks, stop), coverage).map_err(plan_error)
}

fn flown(snapshot: &Snapshot, question: &FlightQuestion, stored: &Zones) -> Result<Explored<FlightOutcome>> {
    if !snapshot.params.map.voxels.enabled {
        let message = "the session keeps no voxels; create one with params.map.voxels.enabled";
        return Err(Error::new(ErrorCode::FailedPrecondition, reason::LAYER_OFF, message));
    }
    let robot = || {
        let pose = snapshot.pose.as_ref().filter(|_| known_pose(snapshot).is_some())?;
        Some(Point3::from(pose.t_map_base.translation.vector))
    };
    let params = FlightParams { max_voxels: question.params.max_voxels.min(MAX_FLIGHT_VOXELS), ..question.params };
    params.validate().map_err(flight_error)?;
    // What is wrong with a question is told also where nobody knows where the robot is.
    if let Some(&value) = question.goal.iter().find(|v| !v.is_finite()) {
        return Err(flight_error(PlanError::NotFinite { field: "goal", value }));
    }
    let Some(start) = question.start.or_else(robot) else { return Ok(Explored::of(snapshot, None)) };
    if question.region.is_none() && snapshot.layers.voxels.tile_keys().next().is_none() {
        return Err(Error::new(ErrorCode::FailedPrecondition, reason::MAP_EMPTY, "nothing was mapped yet"));
    }
    let voxels = DenseVoxels::of_map(&snapshot.layers.voxels, question.region.as_ref(), params.max_voxels);
    let voxels = voxels.map_err(flight_error)?;
    let begun = Instant::now();
    let stop = question.deadline.map(|deadline| move || begun.elapsed() >= deadline);
    let zones = PathOptions {
        zones: question.zones.clone(),
        ignores_session_zones: question.ignores_session_zones,
        ..PathOptions::default()
    };
    let zones = zones.in_zones(stored);
    let masks = zones.planning_masks();
    let request = FlightRequest {
        planner: question.planner,
        zones: &zones.zones,
        masks: &masks,
        stop: stop.as_ref().map(|stop| stop as &(dyn Fn() -> bool + Sync)),
        ..FlightRequest::new(start, question.goal, &params)
    };
    Ok(Explored::of(snapshot, Some(plan_flight(&voxels, &request).map_err(flight_error)?)))
}

/// What is wrong with a question for a path in space: its parameters are among its options.
fn flight_error(e: PlanError) -> Error {
    let error = plan_error(e);
    let field = error.field.strip_prefix("params.").map_or(error.field.clone(), |f| format!("options.{f}"));
    Error { field, ..error }
}
