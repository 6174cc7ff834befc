//! A level as cells, and which room each belongs to.

use super::cleared::{Cleared, Kind};
use crate::SceneError;
use nalgebra::Point2;
use percept_geometry::{Cell, GridGeometry, OrientedBox3, clearance_in_cells};

/// Cells from this on are occupied, per cent, and up to that below free: as planning has them.
const OCCUPIED: i8 = 60;
const FREE: i8 = 40;
/// Around a thing, metres: beside it lies the floor of its room.
const AROUND_M: f64 = 0.15;

/// A rectangle of cells in ROS's values.
#[derive(Debug, Clone, Copy)]
pub struct Floor<'a> {
    /// Origin: lower-left corner of the first cell, map frame.
    pub geometry: GridGeometry,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Row-major `height x width`; -1 unknown, else 0 to 100: how sure it is that a cell is occupied.
    pub cells: &'a [i8],
}

impl Floor<'_> {
    /// Holds if there are as many cells as the shape says.
    pub(super) fn validate(&self) -> Result<(), SceneError> {
        if self.width.checked_mul(self.height) == Some(self.cells.len()) && self.cells.len() <= i32::MAX as usize {
            return Ok(());
        }
        let (field, value, requirement) = ("cells", self.cells.len() as f64, "width times height, at most 2^31 - 1");
        Err(SceneError::InvalidParam { field, value, requirement })
    }

    pub(super) fn resolution_m(&self) -> f64 {
        self.geometry.resolution_m
    }

    pub(super) fn is_occupied(&self, i: usize) -> bool {
        self.cells[i] >= OCCUPIED
    }

    pub(super) fn is_free(&self, i: usize) -> bool {
        (0..=FREE).contains(&self.cells[i])
    }

    pub(super) fn center(&self, i: usize) -> Point2<f64> {
        self.geometry.center(Cell::new((i % self.width) as i32, (i / self.width) as i32))
    }

    pub(super) fn around(&self) -> Around {
        Around { width: self.width, height: self.height }
    }

    /// Cells whose centres lie in a box, grown by so much, seen from above.
    pub(super) fn under(&self, thing: &OrientedBox3, grown_m: f64) -> Vec<usize> {
        cells_under(&self.geometry, (self.width, self.height), thing, grown_m)
    }
}

fn cells_under(
    geometry: &GridGeometry,
    (width, height): (usize, usize),
    thing: &OrientedBox3,
    grown_m: f64,
) -> Vec<usize> {
    let grown = OrientedBox3 { size: thing.size.add_scalar(2.0 * grown_m), ..*thing };
    let corners = grown.footprint();
    let low = corners.iter().fold(corners[0], |low, c| low.inf(c));
    let high = corners.iter().fold(corners[0], |high, c| high.sup(c));
    let (Some(low), Some(high)) = (geometry.cell(&low), geometry.cell(&high)) else { return vec![] };
    let span = |low: i32, high: i32, size: usize| low.max(0)..=high.min(size as i32 - 1);
    let z = grown.center().z;
    let is_under = |x: i32, y: i32| {
        let p = geometry.center(Cell::new(x, y));
        grown.contains(&nalgebra::Point3::new(p.x, p.y, z))
    };
    span(low.y, high.y, height)
        .flat_map(|y| span(low.x, high.x, width).map(move |x| (x, y)))
        .filter(|(x, y)| is_under(*x, *y))
        .map(|(x, y)| y as usize * width + x as usize)
        .collect()
}

/// Neighbours of cells.
#[derive(Debug, Clone, Copy)]
pub(super) struct Around {
    width: usize,
    height: usize,
}

impl Around {
    /// The up to eight cells around one, those that share an edge first.
    pub(super) fn eight(self, i: usize) -> impl Iterator<Item = usize> {
        const STEPS: [(isize, isize); 8] = [(1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, 1), (1, -1), (-1, -1)];
        let (x, y) = ((i % self.width) as isize, (i / self.width) as isize);
        STEPS.into_iter().filter_map(move |(dx, dy)| {
            let (x, y) = (x + dx, y + dy);
            let is_inside = x >= 0 && y >= 0 && x < self.width as isize && y < self.height as isize;
            is_inside.then(|| y as usize * self.width + x as usize)
        })
    }

    /// Those that share an edge.
    pub(super) fn four(self, i: usize) -> impl Iterator<Item = usize> {
        self.eight(i).filter(move |j| i.abs_diff(*j) == 1 || i.abs_diff(*j) == self.width)
    }

    /// Cells within so many of one that is set, along both axes.
    pub(super) fn grown(self, is_one: &[bool], by: usize) -> Vec<bool> {
        let mut grown = is_one.to_vec();
        for _ in 0..by {
            let before = grown.clone();
            for (i, cell) in grown.iter_mut().enumerate() {
                *cell = before[i] || self.eight(i).any(|j| before[j]);
            }
        }
        grown
    }

    /// Cells that hang together, by edges and corners, among those that `is_one`; each part ascending from where it was met first.
    pub(super) fn parts(self, is_one: &[bool]) -> Vec<Vec<usize>> {
        let mut left = is_one.to_vec();
        let mut parts = vec![];
        for start in 0..left.len() {
            if !std::mem::take(&mut left[start]) {
                continue;
            }
            let mut part = vec![start];
            let mut at = 0;
            while let Some(i) = part.get(at).copied() {
                at += 1;
                for next in self.eight(i) {
                    if std::mem::take(&mut left[next]) {
                        part.push(next);
                    }
                }
            }
            parts.push(part);
        }
        parts
    }
}

/// Smallest column and row, and largest.
pub(super) type Extent = ((usize, usize), (usize, usize));

/// Which room each cell belongs to.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Labels {
    pub(super) geometry: Option<GridGeometry>,
    pub(super) width: usize,
    pub(super) height: usize,
    /// Row-major: place of the room, [`Labels::NONE`] without.
    pub(super) cells: Vec<u32>,
}

impl Labels {
    pub(super) const NONE: u32 = u32::MAX;

    pub(super) fn get(&self, i: usize) -> Option<usize> {
        self.cells.get(i).filter(|label| **label != Self::NONE).map(|label| *label as usize)
    }

    pub(super) fn at(&self, p: &Point2<f64>) -> Option<usize> {
        self.index(p).and_then(|i| self.get(i))
    }

    pub(super) fn most_of(&self, thing: &OrientedBox3) -> Option<usize> {
        let cells = cells_under(&self.geometry?, (self.width, self.height), thing, AROUND_M);
        let mut counts = std::collections::BTreeMap::<usize, usize>::new();
        cells.into_iter().filter_map(|i| self.get(i)).for_each(|room| *counts.entry(room).or_default() += 1);
        // Of as many the first.
        counts.into_iter().rev().max_by_key(|(_, count)| *count).map(|(room, _)| room)
    }

    /// How far each cell of a room is from the nearest one of another, in steps over cells; many where there is none.
    pub(super) fn steps_from_others(&self) -> Vec<u32> {
        let around = self.around();
        let mut steps = vec![u32::MAX; self.cells.len()];
        let is_beside_another = |i: &usize| {
            let own = self.get(*i);
            own.is_some() && around.four(*i).any(|j| self.get(j).is_some_and(|other| Some(other) != own))
        };
        let mut edge: Vec<usize> = (0..self.cells.len()).filter(is_beside_another).collect();
        edge.iter().for_each(|i| steps[*i] = 0);
        while !edge.is_empty() {
            let mut next = vec![];
            for i in edge {
                for j in around.four(i) {
                    if self.get(j).is_some() && steps[j] == u32::MAX {
                        steps[j] = steps[i] + 1;
                        next.push(j);
                    }
                }
            }
            edge = next;
        }
        steps
    }

    /// The same rooms, of which each gets another number, or none.
    pub(super) fn renumbered(mut self, numbers: &[Option<usize>]) -> Self {
        let new = |c: u32| numbers[c as usize].map_or(Self::NONE, |n| n as u32);
        self.cells.iter_mut().filter(|c| **c != Self::NONE).for_each(|c| *c = new(*c));
        self
    }

    /// Of each of so many rooms the share of its border that is wall, of that which is wall or not known.
    pub(super) fn enclosed(&self, cleared: &Cleared, rooms: usize) -> Vec<f64> {
        let (mut wall, mut unknown, around) = (vec![0usize; rooms], vec![0usize; rooms], self.around());
        for i in 0..self.cells.len() {
            let Some(room) = self.get(i) else { continue };
            for j in around.four(i) {
                match cleared.kinds[j] {
                    Kind::Wall | Kind::Thing => wall[room] += 1,
                    Kind::Unknown => unknown[room] += 1,
                    Kind::Open => {}
                }
            }
        }
        wall.iter().zip(&unknown).map(|(w, u)| *w as f64 / (*w + *u).max(1) as f64).collect()
    }

    pub(super) fn around(&self) -> Around {
        Around { width: self.width, height: self.height }
    }

    pub(super) fn index(&self, p: &Point2<f64>) -> Option<usize> {
        let cell = self.geometry?.cell(p)?;
        let (x, y) = (usize::try_from(cell.x).ok()?, usize::try_from(cell.y).ok()?);
        (x < self.width && y < self.height).then(|| y * self.width + x)
    }

    pub(super) fn is_open_between(&self, a: &OrientedBox3, b: &OrientedBox3) -> bool {
        let Some(geometry) = self.geometry else { return true };
        let (from, to) = (Point2::from(a.center().coords.xy()), Point2::from(b.center().coords.xy()));
        let grown = |b: &OrientedBox3| OrientedBox3 { size: b.size.add_scalar(2.0 * AROUND_M), ..*b };
        let (a, b) = (grown(a), grown(b));
        let is_in = |b: &OrientedBox3, p: &Point2<f64>| b.contains(&nalgebra::Point3::new(p.x, p.y, b.center().z));
        let steps = ((to - from).norm() / geometry.resolution_m).ceil().max(1.0) as usize;
        (0..=steps).all(|k| {
            let p = from + (to - from) * (k as f64 / steps as f64);
            is_in(&a, &p) || is_in(&b, &p) || self.at(&p).is_some()
        })
    }

    pub(super) fn cells_of(&self, room: usize) -> impl Iterator<Item = usize> {
        self.cells.iter().enumerate().filter(move |(_, label)| **label as usize == room).map(|(i, _)| i)
    }

    /// Smallest and largest column and row of each of so many rooms; the smallest is larger than the largest of one that has no cell.
    pub(super) fn extents(&self, rooms: usize) -> Vec<Extent> {
        let mut extents = vec![((usize::MAX, usize::MAX), (0, 0)); rooms];
        for (i, label) in self.cells.iter().enumerate() {
            let Some((low, high)) = extents.get_mut(*label as usize) else { continue };
            let (x, y) = (i % self.width, i / self.width);
            (*low, *high) = ((low.0.min(x), low.1.min(y)), (high.0.max(x), high.1.max(y)));
        }
        extents
    }

    /// Radius of the largest circle that fits into a room's outer border, whatever stands in the room, in cells.
    pub(super) fn radius_within(&self, room: usize, (low, high): Extent) -> f64 {
        if low.0 > high.0 {
            return 0.0;
        }
        // With a rim of what is outside.
        let (width, height) = (high.0 - low.0 + 3, high.1 - low.1 + 3);
        let is_room = |i: usize| {
            let (x, y) = (i % width + low.0, i / width + low.1);
            // The rim is one to the left of and below the room.
            x > low.0
                && y > low.1
                && x <= high.0 + 1
                && y <= high.1 + 1
                && self.get((y - 1) * self.width + x - 1) == Some(room)
        };
        let around = Around { width, height };
        let (mut is_outside, mut edge) = (vec![false; width * height], vec![0]);
        is_outside[0] = true;
        while let Some(i) = edge.pop() {
            for j in around.four(i).filter(|j| !is_room(*j)) {
                if !std::mem::replace(&mut is_outside[j], true) {
                    edge.push(j);
                }
            }
        }
        clearance_in_cells(&is_outside, width, height).into_iter().fold(0.0, f32::max).into()
    }

    /// Cells of each of so many rooms.
    pub(super) fn counts(&self, rooms: usize) -> Vec<usize> {
        let mut counts = vec![0; rooms];
        self.cells.iter().filter(|c| **c != Self::NONE).for_each(|c| counts[*c as usize] += 1);
        counts
    }
}
