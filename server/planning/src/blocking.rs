//! What stands in the way.

use crate::answer::{Blocking, NoPathReason};
use crate::astar::{GridPath, SearchGrid, search};
use crate::costmap::{CellState, Costmap};
use nalgebra::Point2;
use percept_geometry::Cell;

/// Why there is no path, and what is in the way if that is known.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Refusal {
    pub(crate) reason: NoPathReason,
    pub(crate) blocking: Option<Blocking>,
}

impl From<NoPathReason> for Refusal {
    fn from(reason: NoPathReason) -> Self {
        Self { reason, blocking: None }
    }
}

/// A step into a cell where the robot does not fit costs as many free ones: no map's detour is that long for the few that
/// a way through a wall takes.
const PENALTY: f32 = 1e4;

/// The first place where the robot does not fit on the way that crosses least of such places, `blocked` row-major.
pub(crate) fn first_blocking(costmap: &Costmap, blocked: &[bool], ends: (Cell, Cell), radius: f64) -> Option<Blocking> {
    let rim: Vec<bool> = (0..blocked.len()).map(|i| costmap.is_rim(i)).collect();
    let factors: Vec<f32> = blocked.iter().map(|b| if *b { PENALTY } else { 1.0 }).collect();
    let grid = SearchGrid { blocked: &rim, factors: &factors, width: costmap.width(), height: costmap.height() };
    let GridPath::Found { cells, .. } = search(&grid, ends.0, ends.1, usize::MAX) else { return None };
    let first = cells.into_iter().find(|c| blocked[costmap.at(*c)])?;
    costmap.blocking_at(&costmap.geometry().center(first), radius)
}

impl Costmap {
    /// The obstacle nearest to a point where a disc of this radius does not fit; of several, the first row by row.
    pub(crate) fn blocking_at(&self, position: &Point2<f64>, radius: f64) -> Option<Blocking> {
        let size = self.geometry().resolution_m;
        let gap = |cell: Cell| {
            let off = self.geometry().center(cell) - position;
            let beyond = |v: f64| (v.abs() - 0.5 * size).max(0.0);
            beyond(off.x).hypot(beyond(off.y))
        };
        let obstacles = self.cells_within(position, radius + size);
        let obstacles = obstacles.filter(|c| self.state(*c).is_some_and(|state| state != CellState::Free));
        let nearest = obstacles.map(|c| (gap(c), c)).min_by(|a, b| a.0.total_cmp(&b.0));
        nearest.and_then(|(_, cell)| self.blocking(position, cell))
    }

    /// What blocks a position is in this cell.
    pub(crate) fn blocking(&self, position: &Point2<f64>, cell: Cell) -> Option<Blocking> {
        let state = self.state(cell)?;
        Some(Blocking { position: *position, obstacle: self.geometry().center(cell), state })
    }
}
