//! An occupancy grid as a planar lidar sees it.

use super::lattice::{best_of_squares, sort_by_blocks};
use super::{GivenOptions, GivenViews, view};
use crate::{DenseGrid, MappingError};
use nalgebra::{Point2, Point3};
use percept_geometry::grid::{walk, walk_while};
use percept_geometry::{Cell, GridGeometry, PointCloud};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::f64::consts::TAU;

/// A view in each square of this edge, metres: some times as near as robots make keyframes, so that one that is there sees what a
/// view shows; as much wider as it takes not to have more than [`MOST_VIEWS`].
const SQUARE_M: f64 = 1.5;
const MOST_VIEWS: usize = 2_000;
/// Rounds in which views are added where something was not seen, and in each so many times the first views at most.
const MORE_ROUNDS: usize = 3;
/// Beams of a view: a quarter of a degree between them, as the finest planar lidars have it. What is too small for them far away is
/// nearer to another view.
const BEAMS: usize = 1_440;
/// Cells are occupied from this on, and free up to that: `occupied_thresh` and `free_thresh` of nav2's map server, as its maps come.
const OCCUPIED: i8 = 65;
const FREE: i8 = 25;
/// Occupied cells are to be seen so often: one view leaves a cell as likely as not for who asks for 65 %.
const SEEN_OCCUPIED: u8 = 2;

/// Fewer cells than these that were missed in a square are scraps: what grids of real rooms have by the hundred where beams leaked
/// through windows and doors.
const SCRAPS: usize = 24;

#[derive(Clone, Copy, PartialEq, Eq)]
enum State {
    Unknown,
    Free,
    Occupied,
}

/// The grid while it is looked at.
struct Looked<'a> {
    grid: &'a DenseGrid,
    /// Cells as the walk numbers them: this grid's own.
    geometry: GridGeometry,
    states: Vec<State>,
    /// Occupied cells beside free ones.
    walls: Vec<Cell>,
}

/// Where beams from a place end, cells.
struct Seen {
    from: Cell,
    walls: Vec<Cell>,
    /// Ends of beams that meet nothing.
    open: Vec<Point2<f64>>,
}

/// Views of a grid by a planar lidar, whose beams end in the very middle of what is occupied.
///
/// # Errors
/// As [`DenseGrid::validate`]; `NothingFree` if no cell is free: there is no place to look from.
pub fn views_of_grid(grid: &DenseGrid, options: &GivenOptions) -> Result<GivenViews, MappingError> {
    grid.validate()?;
    let looked = Looked::new(grid);
    let range_cells = (options.range_max_m / grid.geometry.resolution_m).max(1.0);
    let clearance = looked.clearance();
    let is_free = |k: &usize| looked.states[*k] == State::Free;
    let free = || (0..looked.states.len()).filter(is_free).map(|k| (looked.cell(k), clearance[k]));
    let mut edge = (SQUARE_M / grid.geometry.resolution_m).ceil().max(1.0) as i32;
    let mut places = best_of_squares(free(), edge);
    while places.len() > MOST_VIEWS {
        edge = edge.saturating_mul(5) / 4 + 1;
        places = best_of_squares(free(), edge);
    }
    if places.is_empty() {
        return Err(MappingError::NothingFree);
    }
    let most_more = places.len();
    let mut times = vec![0u8; looked.states.len()];
    let mut seen = looked.look(&places, range_cells, &mut times);
    for _ in 0..MORE_ROUNDS {
        let missed = worth_a_view(looked.missed(&times, &clearance), edge);
        let mut more = best_of_squares(missed, edge);
        more.truncate(most_more);
        if more.is_empty() {
            break;
        }
        seen.extend(looked.look(&more, range_cells, &mut times));
    }
    let mut order: Vec<Cell> = seen.iter().map(|s| s.from).collect();
    sort_by_blocks(&mut order, edge);
    let place: BTreeMap<Cell, usize> = order.iter().enumerate().map(|(k, c)| (*c, k)).collect();
    seen.sort_by_key(|s| place.get(&s.from).copied());
    seen.dedup_by_key(|s| s.from);
    let share = |state: State| {
        let all = looked.states.iter().filter(|s| **s == state).count();
        let known = looked.states.iter().zip(&times).filter(|(s, n)| **s == state && **n > 0).count();
        if all == 0 { 1.0 } else { known as f64 / all as f64 }
    };
    let (occupied_share, free_share) = (share(State::Occupied), share(State::Free));
    let views = seen.par_iter().map(|s| looked.view(s, options)).collect();
    Ok(GivenViews { views, occupied_share, free_share })
}

/// Those in squares in which more than scraps were missed.
fn worth_a_view(missed: Vec<(Cell, f32)>, edge: i32) -> impl Iterator<Item = (Cell, f32)> {
    let square = move |c: &Cell| (c.y.div_euclid(edge), c.x.div_euclid(edge));
    let mut count: BTreeMap<(i32, i32), usize> = BTreeMap::new();
    missed.iter().for_each(|(c, _)| *count.entry(square(c)).or_default() += 1);
    missed.into_iter().filter(move |(c, _)| count.get(&square(c)).is_some_and(|n| *n >= SCRAPS))
}

impl<'a> Looked<'a> {
    fn new(grid: &'a DenseGrid) -> Self {
        let state = |v: &i8| match *v {
            OCCUPIED.. => State::Occupied,
            0..=FREE => State::Free,
            _ => State::Unknown,
        };
        let states: Vec<State> = grid.cells.iter().map(state).collect();
        let mut looked = Self { grid, geometry: grid.geometry, states, walls: vec![] };
        let is_beside = |cell: &Cell, state: State| {
            let beside = |(x, y): &(i32, i32)| looked.state(Cell::new(cell.x + x, cell.y + y)) == state;
            [(1, 0), (-1, 0), (0, 1), (0, -1)].iter().any(beside)
        };
        let occupied = (0..looked.states.len()).filter(|k| looked.states[*k] == State::Occupied);
        looked.walls = occupied.map(|k| looked.cell(k)).filter(|c| is_beside(c, State::Free)).collect();
        looked
    }

    fn cell(&self, index: usize) -> Cell {
        Cell::new((index % self.grid.width) as i32, (index / self.grid.width) as i32)
    }

    /// Unknown outside.
    fn state(&self, cell: Cell) -> State {
        self.grid.index(cell).map_or(State::Unknown, |k| self.states[k])
    }

    /// Distance to the next cell that is not free, in cells: two sweeps of a chamfer of 3 and 4 (Borgefors 1986), which is within
    /// 8 % of Euclid's and only ranks places.
    fn clearance(&self) -> Vec<f32> {
        let (width, height) = (self.grid.width as i32, self.grid.height as i32);
        let mut out: Vec<f32> = self.states.iter().map(|s| if *s == State::Free { f32::MAX } else { 0.0 }).collect();
        let sweep = |out: &mut Vec<f32>, x: i32, y: i32, forward: i32| {
            let near = [(-1, 0, 1.0), (0, -1, 1.0), (-1, -1, 4.0 / 3.0), (1, -1, 4.0 / 3.0)];
            let k = (y * width + x) as usize;
            for (dx, dy, d) in near {
                let beside = Cell::new(x + dx * forward, y + dy * forward);
                let there = self.grid.index(beside).map_or(0.0, |k| out[k]);
                out[k] = out[k].min(there + d);
            }
        };
        (0..height).for_each(|y| (0..width).for_each(|x| sweep(&mut out, x, y, 1)));
        (0..height).rev().for_each(|y| (0..width).rev().for_each(|x| sweep(&mut out, x, y, -1)));
        out
    }

    /// Where the beams of a view start: not the very middle of its cell, from where every other diagonal runs through corners of cells
    /// and either side of a corner would do.
    fn eye(&self, from: Cell) -> Point2<f64> {
        self.geometry.center(from) + nalgebra::Vector2::new(0.13, 0.07) * self.geometry.resolution_m
    }

    /// What is seen from places, and how often each cell is.
    fn look(&self, places: &[Cell], range_cells: f64, times: &mut [u8]) -> Vec<Seen> {
        let seen: Vec<Seen> = places.par_iter().map(|from| self.look_from(*from, range_cells)).collect();
        // The view that a cell was last seen from: beams of one view cross the same cells.
        let mut by = vec![u32::MAX; times.len()];
        for (view, s) in seen.iter().enumerate() {
            let from = self.eye(s.from);
            let ends = s.walls.iter().map(|c| self.geometry.center(*c)).chain(s.open.iter().copied());
            for end in ends {
                walk(&self.geometry, &from, &end, |cell| {
                    if let Some(k) = self.grid.index(cell).filter(|k| by[*k] != view as u32) {
                        (by[k], times[k]) = (view as u32, times[k].saturating_add(1));
                    }
                });
            }
        }
        seen
    }

    /// As beams all around tell what is seen, each of which then ends in the middle of its cell.
    fn look_from(&self, from: Cell, range_cells: f64) -> Seen {
        let center = self.eye(from);
        let length = range_cells * self.geometry.resolution_m;
        let (mut walls, mut rims, mut open) = (vec![], vec![], vec![]);
        // No more than cells on the circle where they end.
        let count = ((TAU * range_cells).ceil() as usize).min(BEAMS);
        for k in 0..count {
            let angle = (k as f64 + 0.5) / count as f64 * TAU;
            let end = center + nalgebra::Vector2::new(angle.cos(), angle.sin()) * length;
            let (mut last, mut stopped) = (from, None);
            walk_while(&self.geometry, &center, &end, |cell| match self.state(cell) {
                State::Free => {
                    last = cell;
                    true
                }
                state => {
                    stopped = Some((cell, state));
                    false
                }
            });
            match stopped {
                Some((cell, State::Occupied)) => walls.push(cell),
                Some(_) if last != from => rims.push(last),
                Some(_) => {}
                None => open.push(end),
            }
        }
        let is_seen = |cell: &Cell| self.open_before(&center, &self.geometry.center(*cell), *cell);
        for ends in [&mut walls, &mut rims] {
            ends.sort_unstable();
            ends.dedup();
            ends.retain(is_seen);
        }
        open.extend(rims.iter().map(|c| self.geometry.center(*c)));
        Seen { from, walls, open }
    }

    /// Whether all cells from one place to another are free but for the last.
    fn open_before(&self, from: &Point2<f64>, to: &Point2<f64>, last: Cell) -> bool {
        let mut is_open = true;
        walk_while(&self.geometry, from, to, |cell| {
            is_open = cell == last || self.state(cell) == State::Free;
            is_open
        });
        is_open
    }

    /// Free cells from which something is to be seen that was not seen, or not often enough: what is free itself, or beside what is
    /// occupied.
    fn missed(&self, times: &[u8], clearance: &[f32]) -> Vec<(Cell, f32)> {
        let mut out = vec![];
        for k in (0..times.len()).filter(|k| self.states[*k] == State::Free && times[*k] == 0) {
            out.push((self.cell(k), clearance[k]));
        }
        for wall in &self.walls {
            if self.grid.index(*wall).is_none_or(|k| times[k] >= SEEN_OCCUPIED) {
                continue;
            }
            let near = (-2..=2).flat_map(|y| (-2..=2).map(move |x| Cell::new(wall.x + x, wall.y + y)));
            let free = near.filter(|c| self.state(*c) == State::Free);
            out.extend(free.filter_map(|c| Some((c, clearance[self.grid.index(c)?]))));
        }
        out
    }

    fn view(&self, seen: &Seen, options: &GivenOptions) -> super::GivenView {
        let at = self.eye(seen.from);
        let height = options.sensor_height_m;
        let in_base = |p: Point2<f64>| Point3::new((p.x - at.x) as f32, (p.y - at.y) as f32, height as f32);
        let hits = seen.walls.iter().map(|c| in_base(self.geometry.center(*c))).collect();
        let misses = seen.open.iter().map(|p| Point3::new(p.x, p.y, height)).collect();
        view(
            Point3::new(at.x, at.y, 0.0),
            options,
            super::GIVEN_SENSOR,
            true,
            (PointCloud::from_positions(hits), misses),
        )
    }
}
