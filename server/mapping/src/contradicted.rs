//! Where a frame contradicts the grid: what has gone from the map, and what has come that is not in it.

use crate::occupancy::{ScanUpdate, TILE, locate, overlap};
use crate::{LiveFrame, LiveParams, Occupancy, OccupancyMap};
use nalgebra::Point3;
use percept_geometry::{Cell, KeyframeScan, Pose};
use rustc_hash::FxHashMap;

/// Cells in which the map is wrong lie beside each other over so much, metres, three at least: fewer are what a pose, or a beam that
/// grazes, makes of edges.
const TOGETHER_M: f64 = 0.3;
/// What stands so near may be the same thing where a pose that is off has it, metres: two cells. On the way through a building the map
/// of which is still to be corrected, walls are.
const OFF_M: f64 = 0.2;

/// Cells of which the map says something, and a frame the opposite; those that lie together, row by row.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Contradicted {
    /// Occupied in the map, and seen through.
    pub gone: Vec<Cell>,
    /// Free in the map, and hit.
    pub come: Vec<Cell>,
}

impl Contradicted {
    fn is_empty(&self) -> bool {
        self.gone.is_empty() && self.come.is_empty()
    }
}

impl OccupancyMap {
    /// Where a frame contradicts the grid, of whose cells those count that it is sure of by so many looks. Work runs on the current
    /// rayon pool.
    pub fn contradicted_by(&self, params: &LiveParams, frame: &LiveFrame, looks: f32) -> Contradicted {
        let update = self.look(params, frame);
        let before = Window::of(self, &update);
        // At which heights it was seen through, or stands, is only asked where that matters.
        let by_marks = before.clone().marked_by(&update);
        if self.differences(&before, &by_marks, looks).is_empty() {
            return Contradicted::default();
        }
        let update = [(update, 2)];
        let after = Window::of(&self.under_looks(params, &update), &update[0].0);
        self.differences(&before, &after, looks)
    }

    /// Which returns of a scan taken at `t_map_base` end where the grid says that nothing stands, nor beside: a flag each. Those on the
    /// ground do not count.
    pub fn is_news(&self, t_map_base: &Pose, scan: &KeyframeScan) -> Vec<bool> {
        let (params, geometry) = (self.params(), self.geometry());
        let off = ((OFF_M / params.resolution_m).ceil() as i32).max(1);
        let floor_z = t_map_base.translation.vector.z - scan.base_height_m;
        let mut known: FxHashMap<Cell, bool> = FxHashMap::default();
        let mut is_free = |cell: Cell| {
            *known.entry(cell).or_insert_with(|| {
                let at = |x: i32, y: i32| self.log_odds(Cell::new(cell.x.saturating_add(x), cell.y.saturating_add(y)));
                let stands = |x: i32, y: i32| at(x, y).is_some_and(|v| v > 0.0);
                at(0, 0).is_some_and(|v| v < 0.0) && !(-off..=off).any(|x| (-off..=off).any(|y| stands(x, y)))
            })
        };
        let is_news = |p: &Point3<f32>| {
            let p = t_map_base * p.cast::<f64>();
            let is_up = scan.planar || p.z - floor_z > params.band_min_m;
            is_up && geometry.cell(&p.xy()).is_some_and(&mut is_free)
        };
        scan.hits.positions.iter().map(is_news).collect()
    }

    fn differences(&self, before: &Window, after: &Window, looks: f32) -> Contradicted {
        // What is left of a sum that is nothing is no look.
        let surely = |step: f32| (looks - 0.01).max(0.0) * step;
        let (occupied, free) = (surely(self.params().hit_log_odds), surely(self.params().free_log_odds));
        let cells = |length_m: f64| (length_m / self.params().resolution_m - 1e-6).ceil() as usize;
        let (off, least) = (cells(OFF_M).max(1), cells(TOGETHER_M).max(3));
        let (mut gone, mut come) = (vec![], vec![]);
        for (at, (was, is)) in before.log_odds.iter().zip(&after.log_odds).enumerate() {
            if *was > occupied && *is < 0.0 && !after.stands_around(at, off) {
                gone.push(at);
            } else if *was < free && *is > 0.0 && !before.stands_around(at, off) {
                come.push(at);
            }
        }
        let cells =
            |of: Vec<usize>| lying_together(&of, before.width, least).into_iter().map(|i| before.cell(i)).collect();
        Contradicted { gone: cells(gone), come: cells(come) }
    }
}

/// Log-odds of the cells that a frame says something of, row-major; NaN where nothing is known.
#[derive(Clone)]
struct Window {
    min: Cell,
    width: usize,
    log_odds: Vec<f32>,
}

impl Window {
    fn of(grid: &OccupancyMap, update: &ScanUpdate) -> Self {
        let (min, width) = (update.min(), update.width());
        let mut log_odds = vec![f32::NAN; width * width];
        let tile = |c: i32| (c.div_euclid(TILE), c.saturating_add(width as i32).div_euclid(TILE));
        let ((x0, x1), (y0, y1)) = (tile(min.x), tile(min.y));
        for (key, tile) in grid.tiles(grid.tile_keys_within((x0, y0), (x1, y1))) {
            let ((x0, x1), (y0, y1)) = (overlap(key.0, min.x, width), overlap(key.1, min.y, width));
            for y in (y0..y1).filter(|_| x0 < x1) {
                let slot = locate(Cell::new(min.x + x0 as i32, min.y + y as i32)).1;
                log_odds[y * width + x0..y * width + x1].copy_from_slice(&tile.log_odds()[slot..slot + x1 - x0]);
            }
        }
        Self { min, width, log_odds }
    }

    /// As if the marks counted whatever their heights.
    fn marked_by(mut self, update: &ScanUpdate) -> Self {
        for i in 0..self.log_odds.len() {
            if let Some(is_hit) = update.says(self.cell(i)) {
                self.log_odds[i] = if is_hit { 1.0 } else { -1.0 };
            }
        }
        self
    }

    fn cell(&self, i: usize) -> Cell {
        Cell::new(self.min.x + (i % self.width) as i32, self.min.y + (i / self.width) as i32)
    }

    /// Whether a cell up to so many columns and rows away is occupied.
    fn stands_around(&self, i: usize, off: usize) -> bool {
        around(i, self.width, off).any(|k| self.log_odds[k] > 0.0)
    }
}

/// A cell of a square and those up to so many columns and rows away.
fn around(i: usize, width: usize, off: usize) -> impl Iterator<Item = usize> {
    let span = move |v: usize| v.saturating_sub(off)..(v + off + 1).min(width);
    span(i / width).flat_map(move |y| span(i % width).map(move |x| y * width + x))
}

/// Those cells of a square that lie beside each other, at a side or a corner, by so many at least. In order, as what is given.
fn lying_together(cells: &[usize], width: usize, least: usize) -> Vec<usize> {
    let mut left = vec![false; width * width];
    cells.iter().for_each(|i| left[*i] = true);
    let mut out = vec![];
    for cell in cells {
        let mut group = vec![];
        if std::mem::take(&mut left[*cell]) {
            group.push(*cell);
        }
        let mut next = 0;
        while let Some(at) = group.get(next).copied() {
            group.extend(around(at, width, 1).filter(|i| std::mem::take(&mut left[*i])));
            next += 1;
        }
        if group.len() >= least {
            out.extend(group);
        }
    }
    out.sort_unstable();
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_count_only_where_enough_of_them_lie_beside_each_other() {
        let cells = [0, 11, 12, 50, 51, 99];
        assert_eq!(lying_together(&cells, 10, 3), [0, 11, 12]);
        assert_eq!(lying_together(&cells, 10, 2), [0, 11, 12, 50, 51]);
        assert_eq!(lying_together(&[], 10, 3), Vec::<usize>::new());
        // Ends of rows are no neighbours.
        assert_eq!(lying_together(&[9, 10], 10, 2), Vec::<usize>::new());
    }
}
