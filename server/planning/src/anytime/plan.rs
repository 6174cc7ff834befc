//! Over a map, with the robot's footprint.

use super::{AnytimeEnd, AnytimeParams, AnytimePath, AnytimeRequest, search};
use crate::answer::{NoPathReason, Path, PlanOutcome};
use crate::blocking::Refusal;
use crate::by_cells::{path_through, sized, unreachable};
use crate::costmap::Costmap;
use crate::ends::{check_goal, check_start};
use crate::{PathRequest, PlanError, Planner, SearchGrid};
use percept_geometry::Cell;
use percept_mapping::DenseGrid;

/// A path over cells as [`Planner::Grid`] finds it (whatever the request's planner is), soon, and better ones until it is the
/// cheapest, `params.max_expansions` cells were expanded, or `stop` says so.
///
/// `on_better` is given each better path, or the same one with a lower bound, as it is found: [`Path::bound`] is what its cost
/// over cells, before it is smoothed, is at most in times the least; [`Path::is_final`] says that it is 1. What is given back
/// is the last of them. Where the time was over before there was one: `SearchLimit`, or `Stopped`. That answer, too, comes
/// after the map was looked at once: its clearances take some time to measure.
///
/// # Errors
/// As [`plan_path`](crate::plan_path); `InvalidParam` for `anytime`.
pub fn plan_anytime(
    grid: &DenseGrid,
    request: &PathRequest<'_>,
    anytime: &AnytimeParams,
    on_better: &mut dyn FnMut(&Path),
) -> Result<PlanOutcome, PlanError> {
    anytime.validate()?;
    let request = PathRequest { planner: Planner::Grid, ..*request };
    request.check_grid(grid)?;
    let params = sized(&request, &request.planned_footprint());
    let request = PathRequest { params: &params, ..request };
    let costmap = Costmap::with_zones(grid, &request.start.position, &params, request.zones, request.masks);
    Ok(match improved(&costmap, grid, &request, anytime, on_better) {
        Ok(path) => PlanOutcome::Path(path),
        Err(Refusal { reason, blocking }) => PlanOutcome::NoPath { reason, blocking },
    })
}

/// A way at most twice as costly as the cheapest, then the cheapest: of first bounds 2 to 5 and steps 0.5 to 4 that has a path as
/// early as any, the lowest bounds, and the cheapest the soonest (`--example deadline`, maps brc202d and AR0011SR).
const IN_TIME: AnytimeParams = AnytimeParams { first_bound: 2.0, bound_step: 1.0 };

/// The best way between two cells until `stop` says so: the cheapest if there is time for it. Only that one is smoothed.
pub(crate) fn best_in_time(
    costmap: &Costmap,
    request: &PathRequest<'_>,
    cells: &SearchGrid<'_>,
    (start, goal): (Cell, Cell),
    stop: &(dyn Fn() -> bool + Sync),
) -> Result<Path, Refusal> {
    let params = request.params;
    let asked =
        AnytimeRequest { start, goal, params: IN_TIME, max_expansions: params.max_expansions, stop: Some(stop) };
    let mut best: Option<AnytimePath> = None;
    let ended = search(cells, &asked, &mut |found| best = Some(found.clone()));
    if let Some(AnytimePath { cells, bound, expansions, .. }) = best {
        let path = path_through(costmap, request, &cells, expansions);
        return Ok(Path { bound: Some(bound), is_final: bound == 1.0, ..path });
    }
    Err(match ended {
        AnytimeEnd::Stopped => NoPathReason::Stopped.into(),
        AnytimeEnd::Limit => NoPathReason::SearchLimit.into(),
        _ => unreachable(costmap, cells, (start, goal), params),
    })
}

fn improved(
    costmap: &Costmap,
    grid: &DenseGrid,
    request: &PathRequest<'_>,
    anytime: &AnytimeParams,
    on_better: &mut dyn FnMut(&Path),
) -> Result<Path, Refusal> {
    let params = request.params;
    let start = check_start(costmap, grid, &request.start.position, params)?;
    let goal = check_goal(costmap, &request.goal.position, params)?;
    let blocked = costmap.blocked(&request.start.position);
    let (width, height) = (costmap.width(), costmap.height());
    let cells = SearchGrid { blocked: &blocked, factors: costmap.factors(), width, height };
    let asked =
        AnytimeRequest { start, goal, params: *anytime, max_expansions: params.max_expansions, stop: request.stop };
    let mut best: Option<Path> = None;
    let mut better = |found: &AnytimePath| {
        let path = path_through(costmap, request, &found.cells, found.expansions);
        // Smoothed, the way that costs more over cells may be the cheaper one.
        let cheaper = best.take().filter(|best| best.cost <= path.cost).unwrap_or(path);
        let (bound, is_final) = (Some(found.bound), found.bound == 1.0);
        let path = Path { bound, is_final, expansions: found.expansions, ..cheaper };
        on_better(&path);
        best = Some(path);
    };
    let ended = search(&cells, &asked, &mut better);
    match (best, ended) {
        (Some(path), _) => Ok(path),
        (None, AnytimeEnd::Stopped) => Err(NoPathReason::Stopped.into()),
        (None, AnytimeEnd::Limit) => Err(NoPathReason::SearchLimit.into()),
        (None, _) => Err(unreachable(costmap, &cells, (start, goal), params)),
    }
}
