//! What all planners over cells share: what they plan for, and the path or the refusal that their cells come to.

use crate::answer::{NoPathReason, Path};
use crate::astar::{SearchGrid, reaches};
use crate::blocking::{Refusal, first_blocking};
use crate::costmap::Costmap;
use crate::smooth::{resample, shorten, smooth};
use crate::{Footprint, PathRequest, PlanParams};
use nalgebra::Point2;
use percept_geometry::Cell;

/// The request's parameters for what is planned for: the base keeps off by what the footprint needs whatever its heading.
pub(crate) fn sized(request: &PathRequest<'_>, planned_for: &Footprint) -> PlanParams {
    let radius = planned_for.inscribed_radius_m();
    let inflation_radius_m = request.params.inflation_radius_m.max(radius);
    PlanParams { robot_radius_m: radius, inflation_radius_m, ..*request.params }
}

/// From the request's start through cells to its goal, smoothed if that is wanted.
pub(crate) fn path_through(costmap: &Costmap, request: &PathRequest<'_>, cells: &[Cell], expansions: usize) -> Path {
    let params = request.params;
    let mut raw = vec![request.start.position];
    raw.extend(cells.iter().map(|c| costmap.geometry().center(*c)));
    raw.push(request.goal.position);
    let points = if params.smooth { smoothed(costmap, &raw, params) } else { raw };
    Path::of_legs(costmap, points, &request.speed, expansions)
}

/// Unreachable, or rather a start so hemmed in that no place the robot fits in can be reached from it.
pub(crate) fn unreachable(
    costmap: &Costmap,
    grid: &SearchGrid<'_>,
    ends: (Cell, Cell),
    params: &PlanParams,
) -> Refusal {
    let radius = params.robot_radius_m;
    if reaches(grid, ends.0, |c| costmap.fits(c)) {
        let blocking = first_blocking(costmap, grid.blocked, ends, radius);
        return Refusal { reason: NoPathReason::Unreachable, blocking };
    }
    let blocking = costmap.blocking_at(&costmap.geometry().center(ends.0), radius);
    Refusal { reason: NoPathReason::StartDoesNotFit, blocking }
}

fn smoothed(costmap: &Costmap, raw: &[Point2<f64>], params: &PlanParams) -> Vec<Point2<f64>> {
    let radius = params.robot_radius_m;
    let short = shorten(costmap, raw, radius);
    smooth(costmap, &resample(&short, params.waypoint_spacing_m), radius)
}
