//! Cells of the map, in which grounds lie over each other.

use super::HeightParams;
use super::cell::{Cell, Pass};
use super::tile::CELLS;
use crate::occupancy::TILE;
use percept_geometry::Cell as At;

/// Storeys of a cell.
const MOST: usize = 4;

/// A tile while submaps are laid over each other: as many layers of cells as there are storeys somewhere in it. In each cell the
/// lower ones come first, and those that it has not are not finite.
#[derive(Debug, Clone, Default)]
pub struct Storeys(Vec<Vec<Cell>>);

/// A storey of a cell of the map, as it is read.
#[derive(Debug, Clone, Copy)]
pub struct HeightCell {
    /// Height of the ground, map frame, metres; NaN if it was not seen.
    pub ground_m: f32,
    /// Its standard deviation, metres; NaN if it was not seen.
    pub sigma_m: f32,
    /// Height of the ground, or where it ought to be, map frame, metres; NaN where there is no storey.
    pub level_m: f32,
    /// Highest of what stands on the ground, no higher than the robot's clearance, map frame, metres; NaN for none.
    pub top_m: f32,
    /// Lowest of what hangs above the robot's clearance, map frame, metres; NaN for none.
    pub overhang_m: f32,
    /// Keyframes that saw the ground, without those that found it elsewhere.
    pub num_keyframes: u16,
    /// Whether a drop was seen where the ground ought to be.
    pub is_drop: bool,
}

/// A tile of the map, `64 x 64` cells, each of up to four storeys.
#[derive(Debug, Clone, PartialEq)]
pub struct HeightTile {
    /// Storey by storey, row-major.
    planes: Vec<Vec<HeightCell>>,
    pub(super) bounds: (At, At),
}

/// Equal in every bit.
impl PartialEq for HeightCell {
    fn eq(&self, other: &Self) -> bool {
        let bits = |c: &Self| {
            let floats = [c.ground_m, c.sigma_m, c.level_m, c.top_m, c.overhang_m].map(f32::to_bits);
            (floats, c.num_keyframes, c.is_drop)
        };
        bits(self) == bits(other)
    }
}

impl HeightCell {
    /// Of which nothing is known.
    pub const UNKNOWN: Self = Self {
        ground_m: f32::NAN,
        sigma_m: f32::NAN,
        level_m: f32::NAN,
        top_m: f32::NAN,
        overhang_m: f32::NAN,
        num_keyframes: 0,
        is_drop: false,
    };

    fn of(cell: &Cell) -> Self {
        let seen = |v: f32| if cell.num > 0 { v } else { f32::NAN };
        Self {
            ground_m: seen(cell.z),
            sigma_m: seen(cell.variance.sqrt()),
            level_m: cell.z,
            top_m: cell.standing_top(),
            overhang_m: cell.overhang,
            num_keyframes: cell.num,
            is_drop: cell.is_drop(),
        }
    }
}

impl Storeys {
    /// How many a cell has.
    fn num(&self, slot: usize) -> usize {
        self.0.iter().take_while(|plane| plane[slot].z.is_finite()).count()
    }

    /// Whether nothing that a later submap says only by its beams changes anything.
    pub(super) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Lays what a submap says of a cell over what is known: over the storey that it belongs to, or as a further one. There are no
    /// more than four: a fifth takes the place of the nearest.
    pub(super) fn overlay(&mut self, slot: usize, cell: Option<&Cell>, pass: &Pass, params: &HeightParams) {
        let z = match (cell, pass.num) {
            (Some(cell), _) => cell.z,
            (None, 0) => return,
            (None, _) => pass.z,
        };
        let num = self.num(slot);
        let off = |k: &usize| (self.0[*k][slot].z - z).abs();
        let nearest = (0..num).min_by(|a, b| off(a).total_cmp(&off(b)));
        match nearest {
            Some(k) if self.0[k][slot].is_level_with(z, params) => {
                self.0[k][slot].overlay(cell, pass, params);
                self.sort(slot, num);
            }
            nearest => {
                let Some(cell) = cell else { return };
                let k = nearest.filter(|_| num == MOST).unwrap_or(num);
                if k == self.0.len() {
                    self.0.push(vec![Cell::unknown(f32::NAN); CELLS]);
                }
                self.0[k][slot] = *cell;
                self.sort(slot, k.max(num - usize::from(num == MOST)) + 1);
            }
        }
    }

    /// Puts a cell's storeys in order, the lowest first.
    fn sort(&mut self, slot: usize, num: usize) {
        for k in 1..num.min(self.0.len()) {
            for below in (0..k).rev() {
                let (low, high) = (self.0[below][slot], self.0[below + 1][slot]);
                if low.z <= high.z {
                    break;
                }
                (self.0[below][slot], self.0[below + 1][slot]) = (high, low);
            }
        }
    }

    pub(super) fn tile(&self, key: (i32, i32)) -> Option<HeightTile> {
        let mut planes: Vec<Vec<HeightCell>> = vec![];
        let mut bounds: Option<(At, At)> = None;
        for slot in 0..CELLS {
            let known = self.0.iter().map(|plane| &plane[slot]).filter(|c| c.z.is_finite() && c.is_known());
            for (k, cell) in known.enumerate() {
                if k == planes.len() {
                    planes.push(vec![HeightCell::UNKNOWN; CELLS]);
                }
                planes[k][slot] = HeightCell::of(cell);
                let at = At::new(key.0 * TILE + slot as i32 % TILE, key.1 * TILE + slot as i32 / TILE);
                let (min, max) = bounds.get_or_insert((at, at));
                *min = At::new(min.x.min(at.x), min.y.min(at.y));
                *max = At::new(max.x.max(at.x), max.y.max(at.y));
            }
        }
        Some(HeightTile { planes, bounds: bounds? })
    }

    pub(super) fn memory_bytes(&self) -> usize {
        self.0.iter().map(|plane| size_of_val(&plane[..])).sum()
    }
}

impl HeightTile {
    /// The storeys of a cell by its row-major index in the tile, row 0 at the smallest y; the lowest first.
    pub fn storeys(&self, slot: usize) -> impl Iterator<Item = &HeightCell> {
        self.planes.iter().filter_map(move |plane| plane.get(slot)).filter(|cell| !cell.level_m.is_nan())
    }

    pub(super) fn memory_bytes(&self) -> usize {
        self.planes.iter().map(|plane| size_of_val(&plane[..])).sum()
    }
}
