//! What is asked, and what comes of it.

use super::lanes::Rows;
use super::params::{CoverageDirection, CoverageParams};
use super::sweep::{CoverageLegKind, Sweep, Swept};
use crate::answer::Blocking;
use crate::blocking::Refusal;
use crate::by_cells::sized;
use crate::costmap::Costmap;
use crate::ends::check_start;
use crate::{NoPathReason, Path, PathRequest, PlanError, Planner};
use nalgebra::Point2;
use percept_mapping::DenseGrid;

/// A stretch of a coverage path.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CoverageLeg {
    /// Index of the waypoint at which it begins; it ends at that of the next leg, the last one with the path.
    pub first_waypoint: usize,
    /// What it is for.
    pub kind: CoverageLegKind,
}

/// A path that covers.
#[derive(Debug, Clone, PartialEq)]
pub struct CoveragePath {
    /// From the start on, in order. [`Path::is_final`] is false if the caller or `max_expansions` ended the planning before it
    /// was enough.
    pub path: Path,
    /// What its stretches are for, in order.
    pub legs: Vec<CoverageLeg>,
    /// Area that can be covered: free cells that the tool touches (by their centre) with the base on some cell that it
    /// reaches from the start, m^2.
    pub coverable_m2: f64,
    /// Share of that which the path covers.
    pub covered_share: f64,
    /// Regions that it is divided into.
    pub num_regions: usize,
}

/// The answer to a question for a path that covers.
#[derive(Debug, Clone, PartialEq)]
pub enum CoverageOutcome {
    /// There it is.
    Path(CoveragePath),
    /// There is none: the start is no place to begin at, or the planning was ended before it began.
    NoPath {
        /// Why.
        reason: NoPathReason,
        /// What is too near to the start.
        blocking: Option<Blocking>,
    },
}

/// A path that covers what the robot reaches from the request's start. The robot is planned for as the smallest disc that
/// holds its footprint; the request's goal, headings and planner are not looked at. `max_expansions` and `stop` limit all of
/// it.
///
/// # Errors
/// As [`plan_path`](crate::plan_path); `InvalidParam` for `coverage`.
pub fn plan_coverage(
    grid: &DenseGrid,
    request: &PathRequest<'_>,
    coverage: &CoverageParams,
) -> Result<CoverageOutcome, PlanError> {
    coverage.validate()?;
    let request = PathRequest { planner: Planner::Grid, ..*request };
    request.check_grid(grid)?;
    let params = sized(&request, &request.planned_footprint());
    let request = PathRequest { params: &params, ..request };
    let costmap = Costmap::with_zones(grid, &request.start.position, &params, request.zones, request.masks);
    Ok(match covered(&costmap, grid, &request, coverage) {
        Ok(path) => CoverageOutcome::Path(path),
        Err(Refusal { reason, blocking }) => CoverageOutcome::NoPath { reason, blocking },
    })
}

fn covered(
    costmap: &Costmap,
    grid: &DenseGrid,
    request: &PathRequest<'_>,
    coverage: &CoverageParams,
) -> Result<CoveragePath, Refusal> {
    let start = check_start(costmap, grid, &request.start.position, request.params)?;
    if request.stop.is_some_and(|stop| stop()) {
        return Err(NoPathReason::Stopped.into());
    }
    let along = |along_y: bool| {
        let rows = Rows { width: costmap.width(), height: costmap.height(), along_y };
        let blocked = costmap.blocked(&request.start.position);
        let swept = Sweep::new(costmap, blocked, rows, request, coverage, costmap.at(start))?.run();
        Some(answer(costmap, request, swept))
    };
    // A start so hemmed in that the robot fits nowhere around it.
    let refused = || {
        let blocking = costmap.blocking_at(&request.start.position, request.params.robot_radius_m);
        Refusal { reason: NoPathReason::StartDoesNotFit, blocking }
    };
    match coverage.direction {
        CoverageDirection::AlongX => along(false).ok_or_else(refused),
        CoverageDirection::AlongY => along(true).ok_or_else(refused),
        CoverageDirection::Shorter => {
            let (x, y) = (along(false).ok_or_else(refused)?, along(true).ok_or_else(refused)?);
            // One that was cut off is short for no merit.
            let rank = |c: &CoveragePath| (!c.path.is_final, c.path.length_m);
            Ok(if rank(&x) <= rank(&y) { x } else { y })
        }
    }
}

fn answer(costmap: &Costmap, request: &PathRequest<'_>, swept: Swept) -> CoveragePath {
    let mut points: Vec<Point2<f64>> = vec![request.start.position];
    let mut legs: Vec<CoverageLeg> = vec![];
    points.push(swept.begin);
    points.dedup();
    if points.len() > 1 {
        legs.push(CoverageLeg { first_waypoint: 0, kind: CoverageLegKind::Transit });
    }
    for (kind, stretch) in &swept.legs {
        if legs.last().is_none_or(|last| last.kind != *kind) {
            legs.push(CoverageLeg { first_waypoint: points.len() - 1, kind: *kind });
        }
        points.extend(&stretch[1..]);
    }
    let path = Path::of_legs(costmap, points, &request.speed, swept.expansions);
    CoveragePath {
        path: Path { is_final: swept.is_final, ..path },
        legs,
        coverable_m2: swept.coverable_cells as f64 * costmap.geometry().resolution_m.powi(2),
        covered_share: swept.covered_share,
        num_regions: swept.num_regions,
    }
}
