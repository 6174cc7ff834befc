//! Where to look next: the edge of what is known.

use crate::by_cells::sized;
use crate::costmap::{CellState, Costmap};
use crate::flood::Flood;
use crate::{PathRequest, PlanError, PlanParams, SearchGrid};
use nalgebra::Point2;
use percept_geometry::Cell;
use percept_mapping::DenseGrid;

/// A stretch of free cells beside unknown ones.
#[derive(Debug, Clone, PartialEq)]
pub struct Frontier {
    /// Centres of its cells, map frame, metres, row by row.
    pub cells: Vec<Point2<f64>>,
    /// Where to go to look at it: a place that the robot fits in and reaches, the nearest of such to the middle of its cells.
    pub goal: Point2<f64>,
    /// Cost of the way there over cells, metres, weighted by clearance.
    pub cost: f64,
    /// How much of it there is: its cells' number times their edge, metres. A straight one along an axis is so long.
    pub size_m: f64,
}

/// Orders frontiers by what going there is worth: the cost of the way less `gain` metres for each metre of frontier, the least
/// first. Where that is alike, as they were. 0: by the way alone, as [`frontiers`] gives them; a robot then finishes what is
/// near, scraps among it. At 1 to 3 it passes by scraps for the large openings behind which most is to be seen.
///
/// Source: the cost by which `explore_lite` orders frontiers (Hörner, "Map-merging for multi-robot system", 2016), with both in
/// metres.
///
/// # Errors
/// `InvalidParam` for a gain that is not 0 to 1000.
pub fn rank_frontiers(frontiers: &mut [Frontier], gain: f64) -> Result<(), PlanError> {
    if !(0.0..=1000.0).contains(&gain) {
        return Err(PlanError::InvalidParam { field: "gain", value: gain, remedy: "choose 0 to 1000" });
    }
    let worth = |f: &Frontier| f.cost - gain * f.size_m;
    frontiers.sort_by(|a, b| worth(a).total_cmp(&worth(b)));
    Ok(())
}

/// The frontiers that a robot can reach from the request's start (map frame, metres), the cheapest way first;
/// [`rank_frontiers`] weighs their size against it. Of the request, the footprint (as the smallest disc that holds it) and the
/// zones count: what lies in a keep-out zone, or is reached through one alone, is no frontier.
///
/// A frontier is free cells beside unknown ones, joined over edges and corners; those with fewer than `min_cells` are left
/// out. Its goal is in sight of it and within the robot's radius and three cells, for where the robot fits it stands off what is unknown.
///
/// Source: Yamauchi, "A frontier-based approach for autonomous exploration", 1997.
///
/// # Errors
/// `InvalidParam`, `NotFinite`, `GridTooLarge`, `Map`. A start where the robot does not fit has no frontiers.
pub fn frontiers(grid: &DenseGrid, request: &PathRequest<'_>, min_cells: usize) -> Result<Vec<Frontier>, PlanError> {
    request.check_grid(grid)?;
    // What is unknown is looked for, so that it is no free space here.
    let params = PlanParams { allow_unknown: false, ..sized(request, &request.enclosing_disc()) };
    let start = request.start.position;
    let costmap = Costmap::with_zones(grid, &start, &params, request.zones, request.masks);
    let blocked = costmap.blocked(&start);
    let (width, height) = (costmap.width(), costmap.height());
    let search = SearchGrid { blocked: &blocked, factors: costmap.factors(), width, height };
    let Some(from) = costmap.cell(&start) else { return Ok(Vec::new()) };
    let mut flood = Flood::new(search, from);
    let clusters = clusters(&costmap).into_iter().filter(|cells| cells.len() >= min_cells);
    let mut out: Vec<Frontier> = clusters.filter_map(|cells| reached(&costmap, &mut flood, &cells, &params)).collect();
    out.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    Ok(out)
}

fn clusters(costmap: &Costmap) -> Vec<Vec<Cell>> {
    let around = |cell: Cell| (-1..=1).flat_map(move |dy| (-1..=1).map(move |dx| Cell::new(cell.x + dx, cell.y + dy)));
    // The rim is no place to look at: nothing of the map lies beyond.
    let is_unknown = |c: Cell| costmap.state(c) == Some(CellState::Unknown) && !costmap.is_rim(costmap.at(c));
    let is_frontier = |c: Cell| costmap.state(c) == Some(CellState::Free) && around(c).any(is_unknown);
    let mut seen = vec![false; costmap.states().len()];
    let mut out = Vec::new();
    for index in 0..seen.len() {
        let first = Cell::new((index % costmap.width()) as i32, (index / costmap.width()) as i32);
        if seen[index] || !is_frontier(first) {
            continue;
        }
        let (mut cells, mut next) = (vec![first], 0);
        seen[index] = true;
        while let Some(&cell) = cells.get(next) {
            next += 1;
            for beside in around(cell).filter(|c| is_frontier(*c)) {
                if !std::mem::replace(&mut seen[costmap.at(beside)], true) {
                    cells.push(beside);
                }
            }
        }
        cells.sort_by_key(|c| (c.y, c.x));
        out.push(cells);
    }
    out
}

fn reached(costmap: &Costmap, flood: &mut Flood<'_>, cells: &[Cell], params: &PlanParams) -> Option<Frontier> {
    let centers: Vec<Point2<f64>> = cells.iter().map(|c| costmap.geometry().center(*c)).collect();
    let middle = centers.iter().fold(Point2::origin(), |sum, c| sum + c.coords / centers.len() as f64);
    let reach = params.robot_radius_m + 3.0 * costmap.geometry().resolution_m;
    // Around the frontier's cell that is nearest to the middle of all: the middle of a bent one may be far from it.
    let to_middle = |p: &Point2<f64>| (p - middle).norm();
    let mut nearest: Vec<Point2<f64>> = centers.clone();
    nearest.sort_by(|a, b| to_middle(a).total_cmp(&to_middle(b)));
    let mut place = |around: &Point2<f64>| {
        let near = costmap.cells_within(around, reach).filter(|c| costmap.fits(*c));
        let mut near: Vec<(f64, Cell)> = near.map(|c| ((costmap.geometry().center(c) - around).norm(), c)).collect();
        // In sight of it: not behind a wall.
        let sees = |c: Cell| costmap.segment_clearance(&costmap.geometry().center(c), around, 1e-6) > 0.0;
        near.retain(|(off, cell)| *off <= reach && sees(*cell));
        near.sort_by(|a, b| a.0.total_cmp(&b.0));
        near.into_iter().find_map(|(_, cell)| Some((cell, flood.cost_from(costmap.at(cell))?)))
    };
    let (cell, cost) = nearest.iter().find_map(&mut place)?;
    let resolution = costmap.geometry().resolution_m;
    let size_m = centers.len() as f64 * resolution;
    Some(Frontier { cells: centers, goal: costmap.geometry().center(cell), cost: cost * resolution, size_m })
}
