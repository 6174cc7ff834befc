//! Over maps, with the robot's footprint.

use super::RepairingPlanner;
use crate::answer::{NoPathReason, PlanOutcome};
use crate::blocking::Refusal;
use crate::by_cells::{path_through, sized, unreachable};
use crate::costmap::Costmap;
use crate::ends::{check_goal, check_start};
use crate::{GridPath, PathRequest, PlanError, Planner, SearchGrid};
use percept_geometry::{Cell, GridGeometry};
use percept_mapping::DenseGrid;

/// Answers the same question again and again while the map changes and the robot moves; see [`RepairedRoute::plan`].
#[derive(Debug, Default)]
pub struct RepairedRoute {
    kept: Option<(GridGeometry, RepairingPlanner)>,
}

impl RepairedRoute {
    /// Nothing is kept yet.
    pub fn new() -> Self {
        Self::default()
    }

    /// As [`plan_path`](crate::plan_path) by [`Planner::Grid`] (whatever the request's planner is), repairing what was searched
    /// before. What is different in the map is found by looking at all of it, once clearances are measured anew; the search alone
    /// is repaired. It begins from scratch when the goal's cell, or the rectangle that the map covers, is another.
    ///
    /// `SearchLimit`: asked again, it goes on where it ended; the request's `stop` is not looked at. The path is as cheap over cells as that of `plan_path`, but may be
    /// another of the same cost.
    ///
    /// # Errors
    /// As [`plan_path`](crate::plan_path). What was kept stays as it was.
    pub fn plan(&mut self, grid: &DenseGrid, request: &PathRequest<'_>) -> Result<PlanOutcome, PlanError> {
        let request = PathRequest { planner: Planner::Grid, ..*request };
        request.check_grid(grid)?;
        let params = sized(&request, &request.planned_footprint());
        let request = PathRequest { params: &params, ..request };
        let costmap = Costmap::with_zones(grid, &request.start.position, &params, request.zones, request.masks);
        let ends = check_start(&costmap, grid, &request.start.position, &params)
            .and_then(|start| Ok((start, check_goal(&costmap, &request.goal.position, &params)?)));
        let (start, goal) = match ends {
            Ok(ends) => ends,
            Err(Refusal { reason, blocking }) => return Ok(PlanOutcome::NoPath { reason, blocking }),
        };
        let blocked = costmap.blocked(&request.start.position);
        let (width, height) = (costmap.width(), costmap.height());
        let cells = SearchGrid { blocked: &blocked, factors: costmap.factors(), width, height };
        let planner = self.kept_for(&costmap, &cells, goal)?;
        let refusal = match planner.path(start, params.max_expansions) {
            GridPath::Found { cells, expansions, .. } => {
                return Ok(PlanOutcome::Path(path_through(&costmap, &request, &cells, expansions)));
            }
            GridPath::SearchLimit => NoPathReason::SearchLimit.into(),
            GridPath::Unreachable { .. } => unreachable(&costmap, &cells, (start, goal), &params),
        };
        Ok(PlanOutcome::NoPath { reason: refusal.reason, blocking: refusal.blocking })
    }

    /// The kept search, brought up to date, or a new one.
    fn kept_for(
        &mut self,
        costmap: &Costmap,
        cells: &SearchGrid<'_>,
        goal: Cell,
    ) -> Result<&mut RepairingPlanner, PlanError> {
        let geometry = *costmap.geometry();
        let fits = |(of, planner): &(GridGeometry, RepairingPlanner)| {
            let size = (planner.grid().width, planner.grid().height);
            *of == geometry && planner.goal() == goal && size == (cells.width, cells.height)
        };
        let (_, planner) = match self.kept.take().filter(fits) {
            Some((_, mut planner)) => {
                planner.update(cells)?;
                self.kept.insert((geometry, planner))
            }
            None => self.kept.insert((geometry, RepairingPlanner::new(cells, goal)?)),
        };
        Ok(planner)
    }
}
