//! Clearance to cost.

mod zoned;

use crate::polygon::crosses;
use crate::{Mask, PlanParams, Zone};
use nalgebra::{Point2, Vector2};
use percept_geometry::clearance_in_cells;
use percept_geometry::{Cell, GridGeometry};
use percept_mapping::DenseGrid;

/// What keeps the robot away from a cell.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CellState {
    /// Known free, or unknown where that is allowed.
    Free,
    /// At or above `occupied_probability`.
    Occupied,
    /// Never seen, and not allowed.
    Unknown,
    /// In a keep-out zone, and else free.
    KeepOut,
}

/// For each cell of a map: what is there, how far the nearest obstacle is, what passing costs.
///
/// All arrays are row-major `height x width`. The map has a rim one cell wide added around it, free if unknown cells are
/// allowed and unknown if not: what lies outside the map is not known.
#[derive(Debug, Clone)]
pub struct Costmap {
    geometry: GridGeometry,
    width: usize,
    height: usize,
    state: Vec<CellState>,
    /// From a cell's centre to the nearest obstacle's edge, metres.
    clearance: Vec<f32>,
    /// Cost of a metre: 1, or more near obstacles and in speed zones.
    factors: Vec<f32>,
    /// Share of full speed that is allowed; empty if it is 1 everywhere.
    speeds: Vec<f32>,
    params: PlanParams,
}

impl Costmap {
    /// From a sound grid and sound parameters. Unknown cells within `start_tolerance_m` of `start` are free.
    pub fn new(grid: &DenseGrid, start: &Point2<f64>, params: &PlanParams) -> Self {
        Self::with_zones(grid, start, params, &[], &[])
    }

    /// As [`Costmap::new`], with sound zones and masks over it: keep-out cells are obstacles, and in speed zones a metre
    /// costs as much more as it takes longer.
    pub fn with_zones(
        grid: &DenseGrid,
        start: &Point2<f64>,
        params: &PlanParams,
        zones: &[Zone],
        masks: &[Mask<'_>],
    ) -> Self {
        let (width, height) = (grid.width + 2, grid.height + 2);
        let geometry = GridGeometry::new(grid.geometry.resolution_m, grid.geometry.corner(Cell::new(-1, -1)));
        let mut state = vec![if params.allow_unknown { CellState::Free } else { CellState::Unknown }; width * height];
        for (y, row) in grid.cells.chunks(grid.width.max(1)).enumerate() {
            for (x, &value) in row.iter().enumerate() {
                state[(y + 1) * width + x + 1] = match value {
                    v if v < 0 && params.allow_unknown => CellState::Free,
                    v if v < 0 => CellState::Unknown,
                    v if f64::from(v) >= 100.0 * params.occupied_probability => CellState::Occupied,
                    _ => CellState::Free,
                };
            }
        }
        let (clearance, factors, speeds) = (vec![], vec![], vec![]);
        let empty = Self { geometry, width, height, state, clearance, factors, speeds, params: *params };
        empty.freed_around(start).zoned(zones, masks, params.occupied_probability).measured()
    }

    fn freed_around(mut self, start: &Point2<f64>) -> Self {
        let radius = self.params.start_tolerance_m;
        for cell in self.cells_within(start, radius) {
            let index = self.at(cell);
            let near = (self.geometry.center(cell) - start).norm() <= radius;
            // The rim stays as it is: the robot cannot leave the map.
            if near && !self.is_rim(index) && self.state[index] == CellState::Unknown {
                self.state[index] = CellState::Free;
            }
        }
        self
    }

    fn measured(mut self) -> Self {
        let obstacle: Vec<bool> = self.state.iter().map(|s| *s != CellState::Free).collect();
        let resolution = self.geometry.resolution_m as f32;
        self.clearance = clearance_in_cells(&obstacle, self.width, self.height);
        self.clearance.iter_mut().for_each(|c| *c *= resolution);
        self.factors = self.clearance.iter().map(|c| self.params.factor(f64::from(*c)) as f32).collect();
        self.factors.iter_mut().zip(&self.speeds).for_each(|(factor, speed)| *factor /= speed);
        self
    }

    /// World to cell; cell (0, 0) belongs to the rim.
    pub fn geometry(&self) -> &GridGeometry {
        &self.geometry
    }

    /// Columns, the rim included.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows, the rim included.
    pub fn height(&self) -> usize {
        self.height
    }

    /// The cell of the map (not of its rim) that holds `p`; none outside.
    pub fn cell(&self, p: &Point2<f64>) -> Option<Cell> {
        let inside = |v: i32, size: usize| v >= 1 && (v as usize) + 1 < size;
        self.geometry.cell(p).filter(|c| inside(c.x, self.width) && inside(c.y, self.height))
    }

    /// What is in a cell; none outside.
    pub fn state(&self, cell: Cell) -> Option<CellState> {
        self.index(cell).map(|i| self.state[i])
    }

    /// Distance from a cell's centre to the nearest obstacle's edge, metres: 0 in obstacles, infinite if there is none;
    /// none outside.
    pub fn clearance_m(&self, cell: Cell) -> Option<f64> {
        self.index(cell).map(|i| f64::from(self.clearance[i]))
    }

    /// Cost of a metre in each cell, at least 1.
    pub fn factors(&self) -> &[f32] {
        &self.factors
    }

    pub(crate) fn set_state(&mut self, index: usize, state: CellState) {
        self.state[index] = state;
    }

    /// The lowest of several limits holds.
    pub(crate) fn limit_speed(&mut self, index: usize, share: f32) {
        self.speeds.resize(self.state.len(), 1.0);
        self.speeds[index] = self.speeds[index].min(share);
    }

    /// Lowest allowed share of full speed on the straight line between two points, at samples half a cell apart.
    pub(crate) fn slowest_between(&self, a: &Point2<f64>, b: &Point2<f64>) -> f64 {
        if self.speeds.is_empty() {
            return 1.0;
        }
        let samples = ((b - a).norm() / (0.5 * self.geometry.resolution_m)).ceil().max(1.0);
        let at = |i: f64| self.geometry.cell(&(a + (b - a) * (i / samples))).and_then(|c| self.index(c));
        let shares = (0..=samples as usize).filter_map(|i| at(i as f64)).map(|i| f64::from(self.speeds[i]));
        shares.fold(1.0, f64::min)
    }

    /// Of each cell, what is there.
    pub(crate) fn states(&self) -> &[CellState] {
        &self.state
    }

    /// Of each cell, as [`Costmap::clearance_m`].
    pub(crate) fn clearances(&self) -> &[f32] {
        &self.clearance
    }

    /// Whether the robot's disc fits with its centre on this cell's centre; not outside.
    ///
    /// Then it fits between such cells too, as long as no corner is cut. Along a straight step, obstacles' corners are
    /// half way between two centres, so that their squares reach as near to one of the ends. A diagonal step is nearest
    /// to an obstacle's corner in its middle, at sqrt(2) k cells for a whole k, while one of the cells beside the step
    /// is at sqrt(2) (k - 1/2) from it.
    pub fn fits(&self, cell: Cell) -> bool {
        self.index(cell).is_some_and(|i| self.fits_at(i))
    }

    fn fits_at(&self, index: usize) -> bool {
        let clearance = f64::from(self.clearance[index]);
        // f32 storage may be off by a part in 1e7.
        clearance > 0.0 && clearance >= self.params.robot_radius_m * (1.0 - 1e-6)
    }

    /// Cells that the robot's centre may not enter. A start nearer to obstacles than it should be may be left: within
    /// `start_tolerance_m` of it, cells that are no nearer than the start's are open.
    pub fn blocked(&self, start: &Point2<f64>) -> Vec<bool> {
        let mut out: Vec<bool> = (0..self.clearance.len()).map(|i| self.is_rim(i) || !self.fits_at(i)).collect();
        let Some(start_cell) = self.cell(start) else { return out };
        let at_start = self.clearance[self.at(start_cell)];
        if at_start > 0.0 && !self.fits(start_cell) {
            for cell in self.cells_within(start, self.params.start_tolerance_m) {
                let near = (self.geometry.center(cell) - start).norm() <= self.params.start_tolerance_m;
                let index = self.at(cell);
                if (near || cell == start_cell) && self.clearance[index] >= at_start && !self.is_rim(index) {
                    out[index] = false;
                }
            }
        }
        out
    }

    /// Distance from the segment to the nearest obstacle's edge, metres, at most `limit`. Exact; 0 where it touches.
    pub fn segment_clearance(&self, a: &Point2<f64>, b: &Point2<f64>, limit: f64) -> f64 {
        let pieces = ((b - a).norm() / (4.0 * self.geometry.resolution_m)).ceil().max(1.0);
        let at = |i: f64| a + (b - a) * (i / pieces);
        let mut nearest = limit;
        for i in 0..pieces as usize {
            nearest = self.piece_clearance(&at(i as f64), &at(i as f64 + 1.0), nearest);
        }
        nearest
    }

    fn piece_clearance(&self, a: &Point2<f64>, b: &Point2<f64>, limit: f64) -> f64 {
        let middle = nalgebra::center(a, b);
        let half = 0.5 * (b - a).norm();
        let Some(cell) = self.geometry.cell(&middle).filter(|c| self.index(*c).is_some()) else { return 0.0 };
        let at_center = f64::from(self.clearance[self.at(cell)]);
        let off = (self.geometry.center(cell) - middle).norm();
        // f32 storage may be off by a part in 1e7.
        if at_center * (1.0 - 1e-6) - off - half >= limit {
            return limit;
        }
        let reach = limit.min(at_center + off + 1e-6);
        let mut nearest = limit;
        for cell in self.cells_within(&middle, reach + half + self.geometry.resolution_m) {
            if self.state[self.at(cell)] != CellState::Free {
                let low = self.geometry.corner(cell);
                nearest = nearest.min(segment_to_square(a, b, &low, self.geometry.resolution_m));
            }
        }
        nearest
    }

    /// Cost of going straight from `a` to `b`: metres, times the factor at samples half a cell apart.
    pub fn segment_cost(&self, a: &Point2<f64>, b: &Point2<f64>) -> f64 {
        let length = (b - a).norm();
        let samples = (length / (0.5 * self.geometry.resolution_m)).ceil().max(1.0);
        let factor_at = |p: Point2<f64>| {
            let index = self.geometry.cell(&p).and_then(|c| self.index(c));
            index.map_or(f64::INFINITY, |i| f64::from(self.factors[i]))
        };
        let sum: f64 = (0..samples as usize).map(|i| factor_at(a + (b - a) * ((i as f64 + 0.5) / samples))).sum();
        if length == 0.0 { 0.0 } else { length * sum / samples }
    }

    pub(crate) fn is_rim(&self, index: usize) -> bool {
        let (x, y) = (index % self.width, index / self.width);
        x == 0 || y == 0 || x + 1 == self.width || y + 1 == self.height
    }

    fn index(&self, cell: Cell) -> Option<usize> {
        let (x, y) = (usize::try_from(cell.x).ok()?, usize::try_from(cell.y).ok()?);
        (x < self.width && y < self.height).then(|| y * self.width + x)
    }

    /// Row-major index of a cell known to be inside.
    pub(crate) fn at(&self, cell: Cell) -> usize {
        cell.y as usize * self.width + cell.x as usize
    }

    /// Cells inside, rim included, of the square of half width `radius` around `p`, row by row.
    pub(crate) fn cells_within(&self, p: &Point2<f64>, radius: f64) -> impl Iterator<Item = Cell> + use<> {
        let range = |center: f64, origin: f64, size: usize| {
            let cell = |v: f64| ((v - origin) / self.geometry.resolution_m).floor();
            let low = cell(center - radius).max(0.0) as i32;
            let high = cell(center + radius).min(size as f64 - 1.0) as i32;
            low..=high
        };
        let columns = range(p.x, self.geometry.origin.x, self.width);
        range(p.y, self.geometry.origin.y, self.height).flat_map(move |y| columns.clone().map(move |x| Cell::new(x, y)))
    }
}

impl PlanParams {
    /// Cost of a metre at this clearance (m): 1 beyond the inflation radius.
    pub(crate) fn factor(&self, clearance: f64) -> f64 {
        if clearance >= self.inflation_radius_m {
            return 1.0;
        }
        let beyond = (clearance - self.robot_radius_m).max(0.0);
        1.0 + self.clearance_weight * (-self.cost_scaling * beyond).exp()
    }
}

/// Distance between a segment and a square of this edge with its smallest corner at `low`.
fn segment_to_square(a: &Point2<f64>, b: &Point2<f64>, low: &Point2<f64>, edge: f64) -> f64 {
    let high = low + Vector2::repeat(edge);
    let to_square = |p: &Point2<f64>| (p - low.sup(&high.inf(p))).norm();
    let corners = [*low, Point2::new(high.x, low.y), high, Point2::new(low.x, high.y)];
    let along = b - a;
    let length2 = along.norm_squared();
    let to_segment = |p: &Point2<f64>| {
        let share = if length2 > 0.0 { ((p - a).dot(&along) / length2).clamp(0.0, 1.0) } else { 0.0 };
        (a + along * share - p).norm()
    };
    if crosses(a, &along, low, &high) {
        return 0.0;
    }
    let ends = to_square(a).min(to_square(b));
    corners.iter().map(to_segment).fold(ends, f64::min)
}
