//! Paths as pictures for people: one that is planned, or one that comes with the question.

use super::layers::at_most;
use super::maps::stamp_of;
use super::navigation::{MAX_POSES, NoStart, ground, known_pose, misfit, no_start, on_grid, plan_error, words_of};
use super::pictures;
use crate::{PathOptions, Plan, PlanRequest, Result, Service};
use nalgebra::Point2;
use percept_geometry::{Cell, GridGeometry, se3};
use percept_mapping::DenseGrid;
pub use percept_pictures::PathQuantity;
use percept_pictures::{PathDrawing, PathEnd};
use percept_pipeline::Snapshot;
use percept_planning::{
    Footprint, Misfit, MisfitReason, Path, PathSample, PlanOutcome, PlanParams, Pose2, samples_along,
};
use std::borrow::Cow;

/// Around what is known of a map so many cells are drawn, too.
const MARGIN_CELLS: usize = 8;
/// Corners by which a disc is drawn.
const DISC_CORNERS: usize = 32;

/// What is drawn.
#[derive(Debug, Clone)]
pub enum DrawnPath {
    /// A path that is planned first, or why there is none.
    Planned(PlanRequest),
    /// Poses as they are, map frame.
    Given {
        /// From first to last.
        poses: Vec<Pose2>,
        /// None: the session's.
        params: Option<PlanParams>,
        /// What else is asked.
        options: PathOptions,
    },
}

/// How it is drawn.
#[derive(Debug, Clone)]
pub struct Drawing {
    /// What.
    pub path: DrawnPath,
    /// What the colours along it mean.
    pub quantity: PathQuantity,
}

/// A path as a picture.
#[derive(Debug, Clone)]
pub struct PathPicture {
    /// The file.
    pub png: Vec<u8>,
    /// The path that was planned, or why there is none; of poses that were given, without an outcome, and of which state of the map.
    pub plan: Plan,
    /// Where poses that were given cannot be driven.
    pub misfit: Option<Misfit>,
}

impl Service {
    /// A path through a session's map as a picture.
    ///
    /// # Errors
    /// As [`Service::plan_path`] and [`Service::validate_path`]; `PICTURE_TOO_LARGE`.
    pub async fn draw_path(&self, session: &str, mut drawing: Drawing) -> Result<PathPicture> {
        let (snapshot, zones) = self.snapshot_with_zones(session).await?;
        match &mut drawing.path {
            DrawnPath::Planned(PlanRequest { options, .. }) | DrawnPath::Given { options, .. } => {
                *options = std::mem::take(options).in_zones(&zones);
            }
        }
        let (max_cells, title) = (self.limits.max_planning_cells, session.to_owned());
        let work = move || on_snapshot(&snapshot, &drawing, max_cells, &title);
        self.compute.query(&self.asker(session)?, work).await?
    }
}

fn on_snapshot(snapshot: &Snapshot, drawing: &Drawing, max_cells: usize, title: &str) -> Result<PathPicture> {
    let (stamp, map_version) = (stamp_of(snapshot), snapshot.map_version);
    let (DrawnPath::Planned(PlanRequest { params, .. }) | DrawnPath::Given { params, .. }) = &drawing.path;
    let mut params = params.unwrap_or(snapshot.params.planning);
    params.max_cells = params.max_cells.min(max_cells);
    let (DrawnPath::Planned(PlanRequest { options, .. }) | DrawnPath::Given { options, .. }) = &drawing.path;
    let grid = ground(snapshot, options, params.max_cells)?;
    let mut picture = match &drawing.path {
        DrawnPath::Given { poses, options, .. } => given(&grid, poses, &params, options, drawing.quantity, title)?,
        DrawnPath::Planned(request) => {
            let start = request.start.map(|start| (start, None));
            let start = start.or(known_pose(snapshot).map(|(p, yaw)| (p, Some(yaw))));
            let mut picture = planned(&grid, start, request.goal, &params, &request.options, drawing.quantity, title)?;
            picture.plan.no_start = no_start(snapshot);
            picture
        }
    };
    if let Some(PlanOutcome::NoPath { blocking: Some(blocking), .. }) = &picture.plan.outcome {
        picture.plan.object = super::navigation::object_at(snapshot, blocking);
    }
    let plan = Plan { map_version, stamp, ..picture.plan };
    Ok(PathPicture { plan, ..picture })
}

/// Plans on a grid, from a position and, where it is known, a heading, and draws what came of it. Without a start that is drawn.
///
/// # Errors
/// As [`on_grid`]; `PICTURE_TOO_LARGE`.
pub fn planned(
    grid: &DenseGrid,
    start: Option<(Point2<f64>, Option<f64>)>,
    goal: Point2<f64>,
    params: &PlanParams,
    options: &PathOptions,
    quantity: PathQuantity,
    title: &str,
) -> Result<PathPicture> {
    let plan = |(position, yaw): (Point2<f64>, Option<f64>)| {
        on_grid(grid, (position, yaw.unwrap_or_default()), goal, params, options)
    };
    let outcome = start.map(plan).transpose()?;
    let mut picture = surroundings(params, options, quantity);
    picture.start = start.map(|(position, yaw)| PathEnd { position, yaw_rad: options.start_yaw_rad.or(yaw) });
    picture.goal = Some(PathEnd { position: goal, yaw_rad: options.goal_yaw_rad });
    match &outcome {
        Some(PlanOutcome::Path(path)) => {
            let poses: Vec<Pose2> =
                path.waypoints.iter().map(|w| Pose2 { position: w.position, yaw_rad: w.yaw_rad }).collect();
            add_samples(&mut picture, &samples(grid, &poses, params, options)?);
            // The path has headings of its own.
            (picture.start, picture.goal) = (None, None);
            picture.notes = told(path);
        }
        Some(PlanOutcome::NoPath { reason, blocking }) => {
            picture.reason = Some(words_of(Some(*reason)).to_owned());
            picture.blocking = blocking.as_ref().map(|b| b.obstacle);
        }
        None => picture.reason = Some(words_of(None).to_owned()),
    }
    finished(grid, &picture, title, outcome, None)
}

/// Draws poses as they are, with the first place that cannot be driven.
///
/// # Errors
/// As [`misfit`]; `PICTURE_TOO_LARGE`.
pub fn given(
    grid: &DenseGrid,
    poses: &[Pose2],
    params: &PlanParams,
    options: &PathOptions,
    quantity: PathQuantity,
    title: &str,
) -> Result<PathPicture> {
    at_most("poses", poses.len(), MAX_POSES)?;
    let misfit = misfit(grid, poses, params, options)?;
    let mut picture = surroundings(params, options, quantity);
    add_samples(&mut picture, &samples(grid, poses, params, options)?);
    if let Some(misfit) = &misfit {
        picture.reason = Some(words_of_misfit(misfit));
        picture.blocking = Some(match &misfit.reason {
            MisfitReason::Blocked(blocking) => blocking.obstacle,
            _ => misfit.pose.position,
        });
    }
    finished(grid, &picture, title, None, misfit)
}

fn finished(
    grid: &DenseGrid,
    picture: &PathDrawing,
    title: &str,
    outcome: Option<PlanOutcome>,
    misfit: Option<Misfit>,
) -> Result<PathPicture> {
    let grid = known_part(grid, picture);
    let png = pictures::png(percept_pictures::path_picture(&*grid, picture, title))?;
    let plan = Plan {
        outcome,
        no_start: NoStart::default(),
        object: None,
        map_version: 0,
        stamp: percept_geometry::Timestamp::default(),
    };
    Ok(PathPicture { png, plan, misfit })
}

/// The part of a grid where anything is known, or drawn, with a margin: maps often lie in the middle of much that is not.
fn known_part<'a>(grid: &'a DenseGrid, picture: &PathDrawing) -> Cow<'a, DenseGrid> {
    let (mut low, mut high) = ([usize::MAX; 2], [0; 2]);
    let mut hold = |x: usize, y: usize| {
        (low, high) = ([low[0].min(x), low[1].min(y)], [high[0].max(x), high[1].max(y)]);
    };
    for (y, row) in grid.cells.chunks_exact(grid.width.max(1)).enumerate() {
        let known = |c: &i8| *c >= 0;
        if let (Some(first), Some(last)) = (row.iter().position(known), row.iter().rposition(known)) {
            hold(first, y);
            hold(last, y);
        }
    }
    let ends = picture.start.iter().chain(&picture.goal).map(|end| end.position);
    let places = ends.chain(picture.blocking).chain(picture.poses.iter().map(|p| p.translation.vector.xy().into()));
    for cell in places.filter_map(|p| grid.geometry.cell(&p)).filter(|cell| grid.index(*cell).is_some()) {
        hold(cell.x as usize, cell.y as usize);
    }
    if low[0] > high[0] {
        return Cow::Borrowed(grid);
    }
    let low = low.map(|v| v.saturating_sub(MARGIN_CELLS));
    let high = [(high[0] + MARGIN_CELLS).min(grid.width - 1), (high[1] + MARGIN_CELLS).min(grid.height - 1)];
    let (width, height) = (high[0] - low[0] + 1, high[1] - low[1] + 1);
    if (width, height) == (grid.width, grid.height) {
        return Cow::Borrowed(grid);
    }
    let row = |y: usize| &grid.cells[y * grid.width + low[0]..][..width];
    let cells = (low[1]..=high[1]).flat_map(row).copied().collect();
    let corner = grid.geometry.corner(Cell::new(low[0] as i32, low[1] as i32));
    let geometry = GridGeometry::new(grid.geometry.resolution_m, corner);
    Cow::Owned(DenseGrid { geometry, width, height, cells })
}

fn surroundings(params: &PlanParams, options: &PathOptions, quantity: PathQuantity) -> PathDrawing {
    let disc = Footprint::Disc { radius_m: params.robot_radius_m };
    let footprint = match options.footprint.as_ref().unwrap_or(&disc) {
        Footprint::Polygon(corners) => corners.clone(),
        // A point has no outline.
        Footprint::Disc { radius_m } if *radius_m <= 0.0 => vec![],
        Footprint::Disc { radius_m } => {
            let angle = |i: usize| std::f64::consts::TAU * i as f64 / DISC_CORNERS as f64;
            let corner = |i: usize| Point2::new(radius_m * angle(i).cos(), radius_m * angle(i).sin());
            (0..DISC_CORNERS).map(corner).collect()
        }
    };
    let mask = |m: &crate::SessionMask| m.drawn(options.speed.max_speed_mps, params.occupied_probability);
    PathDrawing {
        quantity,
        footprint,
        zones: options.zones.iter().map(pictures::zone).collect(),
        masks: options.masks.iter().map(mask).collect(),
        ..PathDrawing::default()
    }
}

fn samples(grid: &DenseGrid, poses: &[Pose2], params: &PlanParams, options: &PathOptions) -> Result<Vec<PathSample>> {
    let (nowhere, masks) = (Point2::origin(), options.planning_masks());
    let request = options.request((nowhere, 0.0), nowhere, params, &masks, None);
    samples_along(grid, poses, &request).map_err(plan_error)
}

fn add_samples(picture: &mut PathDrawing, samples: &[PathSample]) {
    let value = |s: &PathSample| match picture.quantity {
        PathQuantity::Clearance => s.clearance_m.unwrap_or(f64::INFINITY),
        PathQuantity::Cost => s.cost,
        PathQuantity::Speed => s.speed_mps,
    };
    picture.values = samples.iter().map(value).collect();
    let pose = |s: &PathSample| se3::from_xy_yaw(s.pose.position.x, s.pose.position.y, s.pose.yaw_rad);
    picture.poses = samples.iter().map(pose).collect();
}

fn told(path: &Path) -> Vec<String> {
    let mut out = vec![format!("takes {:.1} s", path.duration_s), format!("cost {:.2} m", path.cost)];
    out.extend(path.min_clearance_m.map(|least| format!("never nearer than {least:.2} m to an obstacle")));
    out
}

/// Why a path cannot be driven, in words.
pub fn words_of_misfit(misfit: &Misfit) -> String {
    let (x, y) = (misfit.pose.position.x, misfit.pose.position.y);
    let what = match &misfit.reason {
        MisfitReason::OutsideMap => "is outside of what was mapped",
        MisfitReason::Blocked(_) => "does not fit",
        MisfitReason::NotSteerable => "cannot go on with this turning radius",
        MisfitReason::Backwards => "would have to drive backwards",
    };
    format!("at ({x:.2}, {y:.2}), after waypoint {}, the robot {what}", misfit.pose_index)
}
