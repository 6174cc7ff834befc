//! From region to region, along their lanes, then to what is left.

use super::lanes::{Region, Rows, Stretch, regions};
use super::nearest::Nearest;
use super::params::CoverageParams;
use super::tool::Tool;
use crate::astar::neighbors_of;
use crate::bits::BitLines;
use crate::smooth::shorten;
use crate::{Costmap, PathRequest, SearchGrid};
use nalgebra::Point2;
use percept_geometry::Cell;
use rustc_hash::FxHashMap;

/// What a stretch of a coverage path is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CoverageLegKind {
    /// A lane.
    Lane,
    /// The way to the next lane, region or touch.
    Transit,
}

/// What was swept.
pub(super) struct Swept {
    /// Centre of the start's cell.
    pub(super) begin: Point2<f64>,
    /// Points in order, metres, each leg from where the one before ends; the first from the centre of the start's cell.
    pub(super) legs: Vec<(CoverageLegKind, Vec<Point2<f64>>)>,
    pub(super) coverable_cells: usize,
    pub(super) covered_share: f64,
    pub(super) num_regions: usize,
    pub(super) expansions: usize,
    pub(super) is_final: bool,
}

/// A robot's base on its way over cells, and the tool that it moves.
pub(super) struct Sweep<'a> {
    costmap: &'a Costmap,
    request: &'a PathRequest<'a>,
    blocked: Vec<bool>,
    rows: Rows,
    /// Lanes of each region, and whether it was done.
    regions: Vec<(Vec<Stretch>, bool)>,
    /// Regions that have a lane's end in a cell where one may begin.
    entries: FxHashMap<usize, Vec<usize>>,
    tool: Tool<'a>,
    coverable_cells: usize,
    /// Cells that may be left.
    may_be_left: usize,
    nearest: Nearest,
    at: usize,
    legs: Vec<(CoverageLegKind, Vec<Point2<f64>>)>,
}

impl<'a> Sweep<'a> {
    /// None if there is nothing to cover from the start's cell.
    pub(super) fn new(
        costmap: &'a Costmap,
        blocked: Vec<bool>,
        rows: Rows,
        request: &'a PathRequest<'a>,
        coverage: &CoverageParams,
        start: usize,
    ) -> Option<Self> {
        let mut tool = Tool::new(costmap, 0.5 * coverage.tool_width_m);
        let grid = SearchGrid { blocked: &blocked, factors: costmap.factors(), width: rows.width, height: rows.height };
        let reached = reached(&grid, start);
        // Cells that are open only so that a start that is too near to obstacles can be left are no places to go.
        let is_place = |i: usize| reached[i] && costmap.fits(cell_of(&rows, i));
        (0..reached.len()).filter(|i| is_place(*i)).for_each(|i| tool.demand_around(i));
        let spacing = coverage.tool_width_m * (1.0 - coverage.overlap) / costmap.geometry().resolution_m;
        let lanes = |region: &Region| (region.lanes(spacing.floor().max(1.0)), false);
        let regions: Vec<(Vec<Stretch>, bool)> = regions(&rows, is_place).iter().map(lanes).collect();
        let mut entries: FxHashMap<usize, Vec<usize>> = FxHashMap::default();
        for (region, (lanes, _)) in regions.iter().enumerate() {
            for lane in [lanes[0], lanes[lanes.len() - 1]] {
                for at in [lane.first, lane.last] {
                    entries.entry(rows.index(lane.row, at)).or_default().push(region);
                }
            }
        }
        let coverable_cells = tool.num_left;
        let may_be_left = (coverable_cells as f64 * (1.0 - coverage.enough) + 1e-9) as usize;
        let nearest = Nearest::new(&grid);
        let is_empty = coverable_cells == 0 || blocked[start];
        let out = Self {
            costmap,
            request,
            blocked,
            rows,
            regions,
            entries,
            tool,
            coverable_cells,
            may_be_left,
            nearest,
            at: start,
            legs: vec![],
        };
        (!is_empty).then_some(out)
    }

    pub(super) fn run(mut self) -> Swept {
        let begin = self.center(self.at);
        self.go(CoverageLegKind::Transit, &[self.at]);
        while !self.is_over() {
            let Some(way) = self.way(|sweep, at| sweep.entries.get(&at).is_some_and(|all| sweep.any_left(all))) else {
                break;
            };
            let end = way[way.len() - 1];
            let here = self.entries.get(&end).cloned().unwrap_or_default();
            let Some(region) = here.into_iter().find(|region| !self.regions[*region].1) else { break };
            self.regions[region].1 = true;
            let mut lanes = self.regions[region].0.clone();
            if lanes.iter().all(|lane| self.needed(lane).is_none()) {
                continue;
            }
            self.go(CoverageLegKind::Transit, &way);
            if !self.is_in(&lanes[0], end) {
                lanes.reverse();
            }
            lanes.iter().for_each(|lane| self.drive(lane));
        }
        // What lanes have left: the nearest of it, time and again.
        while !self.is_over() {
            let Some(way) = self.way(|sweep, at| sweep.tool.is_needed_at(at) && sweep.costmap.fits(sweep.cell(at)))
            else {
                break;
            };
            self.go(CoverageLegKind::Transit, &way);
        }
        let left = self.tool.num_left as f64 / self.coverable_cells as f64;
        Swept {
            begin,
            legs: self.legs,
            coverable_cells: self.coverable_cells,
            covered_share: 1.0 - left,
            num_regions: self.regions.len(),
            expansions: self.nearest.expansions,
            is_final: self.tool.num_left <= self.may_be_left,
        }
    }

    fn any_left(&self, regions: &[usize]) -> bool {
        regions.iter().any(|region| !self.regions[*region].1)
    }

    fn is_over(&self) -> bool {
        self.tool.num_left <= self.may_be_left
            || self.nearest.expansions >= self.request.params.max_expansions
            || self.request.stop.is_some_and(|stop| stop())
    }

    fn is_in(&self, lane: &Stretch, index: usize) -> bool {
        index == self.rows.index(lane.row, lane.first) || index == self.rows.index(lane.row, lane.last)
    }

    /// The part of a lane from which the tool covers something that is left.
    fn needed(&self, lane: &Stretch) -> Option<Stretch> {
        let is_needed = |at: &usize| self.tool.is_needed_at(self.rows.index(lane.row, *at));
        let first = (lane.first..=lane.last).find(is_needed)?;
        let last = (lane.first..=lane.last).rev().find(is_needed)?;
        Some(Stretch { first, last, ..*lane })
    }

    /// To the nearer end of a lane, and along it.
    fn drive(&mut self, lane: &Stretch) {
        let Some(lane) = self.needed(lane) else { return };
        let ends = [lane.first, lane.last].map(|at| self.rows.index(lane.row, at));
        let here = self.center(self.at);
        let off = |index: usize| (self.center(index) - here).norm();
        let [near, far] = if off(ends[0]) <= off(ends[1]) { ends } else { [ends[1], ends[0]] };
        let radius = self.request.params.robot_radius_m.max(1e-6);
        let is_straight = self.costmap.segment_clearance(&here, &self.center(near), radius) >= radius * (1.0 - 1e-6);
        if is_straight {
            self.go(CoverageLegKind::Transit, &[near]);
        } else {
            let Some(way) = self.way(|_, at| at == near) else { return };
            self.go(CoverageLegKind::Transit, &way);
        }
        self.go(CoverageLegKind::Lane, &[far]);
    }

    fn way(&mut self, wanted: impl Fn(&Self, usize) -> bool) -> Option<Vec<usize>> {
        let (blocked, mut nearest) = (std::mem::take(&mut self.blocked), std::mem::take(&mut self.nearest));
        let grid = SearchGrid {
            blocked: &blocked,
            factors: self.costmap.factors(),
            width: self.rows.width,
            height: self.rows.height,
        };
        let way = nearest.way(&grid, self.at, self.request.params.max_expansions, |at| wanted(self, at));
        (self.blocked, self.nearest) = (blocked, nearest);
        way
    }

    /// Moves base and tool: along a lane, or by a way over cells that is shortened first, so that what counts as covered is
    /// what the path itself covers.
    fn go(&mut self, kind: CoverageLegKind, way: &[usize]) {
        let mut points: Vec<Point2<f64>> = vec![self.center(self.at)];
        points.extend(way.iter().map(|index| self.center(*index)));
        points.dedup();
        if kind == CoverageLegKind::Transit {
            points = shorten(self.costmap, &points, self.request.params.robot_radius_m);
        }
        self.tool.pass(&points[0], &points[0]);
        points.windows(2).for_each(|leg| self.tool.pass(&leg[0], &leg[1]));
        self.at = way.last().copied().unwrap_or(self.at);
        if points.len() > 1 {
            self.legs.push((kind, points));
        }
    }

    fn center(&self, index: usize) -> Point2<f64> {
        self.costmap.geometry().center(self.cell(index))
    }

    fn cell(&self, index: usize) -> Cell {
        cell_of(&self.rows, index)
    }
}

fn cell_of(rows: &Rows, index: usize) -> Cell {
    Cell::new((index % rows.width) as i32, (index / rows.width) as i32)
}

/// Cells that can be reached from one.
fn reached(grid: &SearchGrid<'_>, start: usize) -> Vec<bool> {
    let mut out = vec![false; grid.blocked.len()];
    if grid.blocked[start] {
        return out;
    }
    let bits = BitLines::rows(grid.blocked, grid.width, grid.height);
    let mut stack = vec![start];
    out[start] = true;
    while let Some(at) = stack.pop() {
        for next in neighbors_of(grid, &bits, at) {
            if !std::mem::replace(&mut out[next], true) {
                stack.push(next);
            }
        }
    }
    out
}
