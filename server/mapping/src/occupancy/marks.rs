//! Marks on cells: how one keyframe's are gathered, each cell once, with the heights that they are about.

use super::OccupancyParams;
use super::planar::PlanarMarks;
use nalgebra::{Point2, Point3};
use percept_geometry::grid::walk;
use percept_geometry::{Cell, GridGeometry};

/// What one keyframe says about the cells around its sensor: a square window of marks, as far as it saw.
///
/// Depends on the pose and the scan alone, so that many keyframes can be worked on at once.
#[derive(Debug, Clone, PartialEq)]
pub struct ScanUpdate {
    pub(super) min: Cell,
    pub(super) width: usize,
    /// Whether the beams lie in one plane and say nothing about other heights.
    pub(super) planar: bool,
    pub(super) marks: Marks,
}

/// Marks by cell of the window.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Marks {
    /// Row-major `width x width`.
    Each(Vec<Mark>),
    /// Of a planar scan.
    Planar(PlanarMarks),
}

/// What a keyframe says about a cell, and at which heights.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Mark {
    /// Not seen.
    Unseen,
    /// Behind something, beams went over it at these heights: what stood there so high has gone. What is lower was not seen.
    Over(Heights),
    /// Beams passed at these heights, none ended here.
    Free(Heights),
    /// Beams ended here, at these heights.
    Hit(Heights),
    /// The robot's body came through, at these heights.
    Driven(Heights),
}

impl Mark {
    /// Both marks of one keyframe: a hit outweighs what passed, and the robot itself both; heights of a kind join.
    fn joined(self, other: Self) -> Self {
        match (self, other) {
            (Self::Driven(_), _) => self,
            (_, Self::Driven(_)) => other,
            (Self::Hit(a), Self::Hit(b)) => Self::Hit(a.joined(b)),
            (Self::Free(a), Self::Free(b)) => Self::Free(a.joined(b)),
            (Self::Over(a), Self::Over(b)) => Self::Over(a.joined(b)),
            (Self::Hit(_), _) | (_, Self::Unseen) | (Self::Free(_), Self::Over(_)) => self,
            _ => other,
        }
    }
}

/// A set of heights: a bit for each 64th of the band, the lowest first. Sampled beams leave gaps between them, in
/// which the edge of a table may stand unseen; an interval would not know.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Heights(u64);

impl Heights {
    /// No height.
    pub(super) const NONE: Self = Self(0);

    /// One height above the floor, metres; none outside of the band.
    pub(super) fn at(params: &OccupancyParams, height: f64) -> Self {
        let share = Self::share(params, height);
        if (0.0..1.0).contains(&share) { Self(1 << (share * 64.0) as u32) } else { Self::NONE }
    }

    /// From one height above the floor to another, metres: what of that lies in the band.
    pub(super) fn between(params: &OccupancyParams, low: f64, high: f64) -> Self {
        let (low, high) = (64.0 * Self::share(params, low), 64.0 * Self::share(params, high));
        if !(high >= 0.0 && low < 64.0) {
            return Self::NONE;
        }
        let (low, high) = (low.max(0.0) as u32, (high as u32).min(63));
        Self(u64::MAX >> (63 - (high - low)) << low)
    }

    /// All from the bottom of the band up to a height above the floor, metres; the lowest at least.
    pub(super) fn up_to(params: &OccupancyParams, height: f64) -> Self {
        Self(u64::MAX >> (63 - (Self::share(params, height).clamp(0.0, 0.999) * 64.0) as u32))
    }

    /// The height of a planar scan, which speaks for the band wherever it lies.
    pub(super) fn of_plane(params: &OccupancyParams, height: f64) -> Self {
        Self(1 << (Self::share(params, height).clamp(0.0, 0.999) * 64.0) as u32)
    }

    fn share(params: &OccupancyParams, height: f64) -> f64 {
        (height - params.band_min_m) / (params.band_max_m - params.band_min_m)
    }

    /// The heights of both.
    pub(super) fn joined(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    /// These heights but not the others.
    pub(super) fn without(self, other: Self) -> Self {
        Self(self.0 & !other.0)
    }

    /// Whether the other holds all of these.
    pub(super) fn within(self, other: Self) -> bool {
        self.0 & !other.0 == 0
    }

    /// The heights that are in both.
    pub(super) fn shared(self, other: Self) -> Self {
        Self(self.0 & other.0)
    }

    /// As bits, the lowest height first.
    pub(super) fn bits(self) -> u64 {
        self.0
    }

    pub(super) fn of_bits(bits: u64) -> Self {
        Self(bits)
    }

    /// Whether they share a height.
    pub(super) fn meet(self, other: Self) -> bool {
        self.0 & other.0 != 0
    }
}

impl ScanUpdate {
    /// The first cell of the window.
    pub(crate) fn min(&self) -> Cell {
        self.min
    }

    /// Cells along the window's edge.
    pub(crate) fn width(&self) -> usize {
        self.width
    }

    /// Whether something was hit in a cell, or seen through it; none where neither was.
    pub(crate) fn says(&self, cell: Cell) -> Option<bool> {
        match self.at(cell) {
            Mark::Unseen => None,
            Mark::Hit(_) => Some(true),
            Mark::Over(_) | Mark::Free(_) | Mark::Driven(_) => Some(false),
        }
    }

    /// What a cell is marked as.
    pub(super) fn at(&self, cell: Cell) -> Mark {
        let (x, y) = (i64::from(cell.x) - i64::from(self.min.x), i64::from(cell.y) - i64::from(self.min.y));
        let is_inside = |v: i64| (0..self.width as i64).contains(&v);
        match &self.marks {
            _ if !(is_inside(x) && is_inside(y)) => Mark::Unseen,
            Marks::Each(marks) => marks[y as usize * self.width + x as usize],
            Marks::Planar(marks) => marks.at(cell),
        }
    }

    /// The same, of which cells beside one that was hit are not said to be free: the end of a beam may as well lie in them.
    pub(crate) fn sparing_beside_hits(self) -> Self {
        let side = self.width;
        let cell = |k: usize| Cell::new(self.min.x + (k % side) as i32, self.min.y + (k / side) as i32);
        let all: Vec<Mark> = (0..side * side).map(|k| self.at(cell(k))).collect();
        let near = |v: usize| v.saturating_sub(1)..=(v + 1).min(side - 1);
        let mut spared = all.clone();
        for k in (0..all.len()).filter(|k| matches!(all[*k], Mark::Hit(_))) {
            for beside in near(k / side).flat_map(|y| near(k % side).map(move |x| y * side + x)) {
                if matches!(all[beside], Mark::Free(_) | Mark::Over(_)) {
                    spared[beside] = Mark::Unseen;
                }
            }
        }
        Self { marks: Marks::Each(spared), ..self }
    }

    /// Adds a mark, if the cell is in the window.
    #[inline]
    pub(super) fn mark(&mut self, cell: Cell, mark: Mark) {
        let (x, y) = (i64::from(cell.x) - i64::from(self.min.x), i64::from(cell.y) - i64::from(self.min.y));
        let side = self.width as i64;
        if x < 0 || y < 0 || x >= side || y >= side {
            return;
        }
        match &mut self.marks {
            Marks::Each(marks) => {
                let slot = &mut marks[y as usize * self.width + x as usize];
                *slot = slot.joined(mark);
            }
            Marks::Planar(marks) => marks.mark(cell, mark),
        }
    }
}

/// Where the beams start, and how to read their ends.
pub(super) struct Frame<'a> {
    pub(super) params: &'a OccupancyParams,
    pub(super) geometry: &'a GridGeometry,
    /// Map frame, metres.
    pub(super) sensor: Point3<f64>,
    /// Height of the floor under base in the map, metres.
    pub(super) floor_z: f64,
}

impl Frame<'_> {
    pub(super) fn hit_at(&self, update: &mut ScanUpdate, end: &Point2<f64>, heights: Heights) {
        if let Some(cell) = self.geometry.cell(end) {
            update.mark(cell, Mark::Hit(heights));
        }
    }

    /// Frees the cells from the sensor to `end`, without that of `end` itself.
    pub(super) fn free_before(&self, update: &mut ScanUpdate, end: &Point2<f64>, passed: impl Fn(Cell) -> Mark) {
        let last = self.geometry.cell(end);
        walk(self.geometry, &self.sensor.xy(), end, |cell| {
            if Some(cell) != last {
                update.mark(cell, passed(cell));
            }
        });
    }

    /// Frees the cells towards `end`, at most as far as the largest range.
    pub(super) fn free_towards(
        &self,
        update: &mut ScanUpdate,
        end: &Point2<f64>,
        range: f64,
        passed: impl Fn(Cell) -> Mark,
    ) {
        if range.is_finite() {
            let share = (self.params.range_max() / range).min(1.0);
            let end = self.sensor.xy() + (end - self.sensor.xy()) * if range > 0.0 { share } else { 0.0 };
            walk(self.geometry, &self.sensor.xy(), &end, |cell| update.mark(cell, passed(cell)));
        }
    }
}
