//! One keyframe as marks on cells: which it saw free, which it hit, each once.

use super::OccupancyParams;
use nalgebra::{Point2, Point3};
use percept_geometry::grid::walk;
use percept_geometry::{Cell, GridGeometry, KeyframeScan, Pose};
use std::f64::consts::{PI, TAU};

/// A beam that goes deeper than this below the band's bottom looks down a drop (stairs, a pit), metres.
const DROP_M: f64 = 0.2;

/// What one keyframe says about the cells around its sensor: a square window of marks, as far as it saw.
///
/// Depends on the pose and the scan alone, so that many keyframes can be worked on at once.
#[derive(Debug, Clone, PartialEq)]
pub struct ScanUpdate {
    pub(super) min: Cell,
    pub(super) width: usize,
    /// Whether the beams lie in one plane and say nothing about other heights.
    pub(super) planar: bool,
    /// Row-major `width x width`.
    pub(super) marks: Vec<Mark>,
}

/// What a keyframe says about a cell, and at which heights.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Mark {
    /// Not seen.
    Unseen,
    /// Beams passed at these heights, none ended here.
    Free(Heights),
    /// Beams ended here, at these heights.
    Hit(Heights),
}

impl Mark {
    /// Both marks of one keyframe: a hit outweighs, heights of a kind join.
    fn joined(self, other: Self) -> Self {
        match (self, other) {
            (Self::Hit(a), Self::Hit(b)) => Self::Hit(a.joined(b)),
            (Self::Free(a), Self::Free(b)) => Self::Free(a.joined(b)),
            (Self::Hit(_), _) | (_, Self::Unseen) => self,
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
    fn at(params: &OccupancyParams, height: f64) -> Self {
        let share = Self::share(params, height);
        if (0.0..1.0).contains(&share) { Self(1 << (share * 64.0) as u32) } else { Self::NONE }
    }

    /// The height of a planar scan, which speaks for the band wherever it lies.
    fn of_plane(params: &OccupancyParams, height: f64) -> Self {
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
    /// The marks of a scan taken at `t_map_base`.
    ///
    /// **Planar scans**: each return within `range_max_m` marks its own end and frees the cells before it; misses
    /// and returns beyond only free. **Others**: heights are taken along the map's z, from the floor under base. Returns in the
    /// band mark their ends. In each azimuth column seen from the sensor, the cells up to the nearest of them are
    /// free, or without one, up to the farthest floor return, far return or end of a miss (each only as far as its
    /// beam stays in the band). Free cells hold the heights at which the beams of the column pass there, so
    /// that looking under a table does not free its top. Points that are not finite, or beyond the range
    /// of the indices, say nothing.
    pub fn new(params: &OccupancyParams, geometry: &GridGeometry, t_map_base: &Pose, scan: &KeyframeScan) -> Self {
        let sensor = Point3::from((t_map_base * scan.t_base_sensor).translation.vector);
        let in_map = |p: &Point3<f32>| t_map_base * p.cast::<f64>();
        let ends = scan.hits.positions.iter().chain(&scan.misses);
        let ranges = ends.map(|p| (in_map(p) - sensor).xy().norm()).filter(|r| r.is_finite());
        let half = (ranges.fold(0.0, f64::max).min(params.range_max_m) / geometry.resolution_m).ceil() as i32 + 1;
        let min = geometry.cell(&sensor.xy()).and_then(|c| {
            c.x.checked_add(half).and(c.y.checked_add(half))?;
            Some(Cell::new(c.x.checked_sub(half)?, c.y.checked_sub(half)?))
        });
        let Some(min) = min else {
            return Self { min: Cell::new(0, 0), width: 0, planar: true, marks: Vec::new() };
        };
        let width = 2 * half as usize + 1;
        let mut update = Self { min, width, planar: scan.planar, marks: vec![Mark::Unseen; width * width] };
        let frame = Frame { params, geometry, sensor, floor_z: t_map_base.translation.vector.z - scan.base_height_m };
        if scan.planar {
            frame.mark_beams(&mut update, &scan.hits.positions, &scan.misses, in_map);
        } else {
            frame.mark_columns(&mut update, &scan.hits.positions, &scan.misses, in_map);
        }
        update
    }

    fn mark(&mut self, cell: Cell, mark: Mark) {
        let (x, y) = (i64::from(cell.x) - i64::from(self.min.x), i64::from(cell.y) - i64::from(self.min.y));
        let side = self.width as i64;
        if x < 0 || y < 0 || x >= side || y >= side {
            return;
        }
        let slot = &mut self.marks[y as usize * self.width + x as usize];
        *slot = slot.joined(mark);
    }
}

/// Where the beams start, and how to read their ends.
struct Frame<'a> {
    params: &'a OccupancyParams,
    geometry: &'a GridGeometry,
    sensor: Point3<f64>,
    floor_z: f64,
}

/// What is known of an azimuth column: ends (m, map) and their horizontal ranges from the sensor (m), and how steep
/// its beams are. One set of slopes does for all ranges: beams that end early leave the band there, or end at the
/// obstacle that bounds the column.
#[derive(Clone)]
struct Column {
    nearest_obstacle: f64,
    obstacle: Point2<f64>,
    farthest_free: f64,
    free: Point2<f64>,
    /// Rise over run of each beam, no two in the same bin.
    slopes: Vec<f32>,
    taken: u64,
}

impl Column {
    /// Adds a beam unless there is one much like it: 64 bins from 45 degrees down to 45 degrees up.
    fn include(&mut self, slope: f64) {
        let bin = ((slope.clamp(-1.0, 1.0) + 1.0) * 31.99) as u32;
        if slope.is_finite() && self.taken & (1 << bin) == 0 {
            self.taken |= 1 << bin;
            self.slopes.push(slope as f32);
        }
    }
}

impl Frame<'_> {
    fn mark_beams(
        &self,
        update: &mut ScanUpdate,
        hits: &[Point3<f32>],
        misses: &[Point3<f32>],
        in_map: impl Fn(&Point3<f32>) -> Point3<f64>,
    ) {
        let heights = Heights::of_plane(self.params, self.sensor.z - self.floor_z);
        let passed = |_| Mark::Free(heights);
        for p in hits {
            let end = in_map(p).xy();
            let range = (end - self.sensor.xy()).norm();
            if range > self.params.range_max_m {
                self.free_towards(update, &end, range, passed);
            } else if range >= self.params.range_min_m {
                self.hit_at(update, &end, heights);
                self.free_before(update, &end, passed);
            }
        }
        for p in misses {
            let end = in_map(p).xy();
            self.free_towards(update, &end, (end - self.sensor.xy()).norm(), passed);
        }
    }

    fn mark_columns(
        &self,
        update: &mut ScanUpdate,
        hits: &[Point3<f32>],
        misses: &[Point3<f32>],
        in_map: impl Fn(&Point3<f32>) -> Point3<f64>,
    ) {
        // As many columns as cells on the circle of the largest range, so that no cell is skipped.
        let count = (TAU * self.params.range_max_m / self.geometry.resolution_m).ceil().max(360.0) as usize;
        let none = Column {
            nearest_obstacle: f64::INFINITY,
            obstacle: Point2::origin(),
            farthest_free: 0.0,
            free: Point2::origin(),
            slopes: Vec::new(),
            taken: 0,
        };
        let mut columns = vec![none; count];
        for p in hits {
            self.read_return(update, &mut columns, &in_map(p));
        }
        for p in misses {
            self.read_free(&mut columns, &in_map(p));
        }
        for column in &columns {
            if column.nearest_obstacle.is_finite() {
                self.free_before(update, &column.obstacle, |cell| self.passed(cell, &column.slopes));
            } else if column.farthest_free > 0.0 {
                let passed = |cell| self.passed(cell, &column.slopes);
                self.free_towards(update, &column.free, column.farthest_free, passed);
            }
        }
    }

    fn read_return(&self, update: &mut ScanUpdate, columns: &mut [Column], p: &Point3<f64>) {
        let range = (p.xy() - self.sensor.xy()).norm();
        let height = p.z - self.floor_z;
        if !(range >= self.params.range_min_m && range > 0.0 && range.is_finite() && height.is_finite()) {
            return;
        }
        self.column(columns, p).include((p.z - self.sensor.z) / range);
        if height > self.params.band_max_m && range <= self.params.range_max_m {
            return;
        }
        if height < self.params.band_min_m || range > self.params.range_max_m {
            return self.read_free(columns, p);
        }
        self.hit_at(update, &p.xy(), Heights::at(self.params, height));
        let column = self.column(columns, p);
        if range < column.nearest_obstacle {
            (column.nearest_obstacle, column.obstacle) = (range, p.xy());
        }
    }

    /// A beam that met nothing in the band on its way to `end`: free as far as it is over the floor and below the
    /// band's top.
    fn read_free(&self, columns: &mut [Column], end: &Point3<f64>) {
        let (h0, h1) = (self.sensor.z - self.floor_z, end.z - self.floor_z);
        let slope = (h1 - h0) / (end.xy() - self.sensor.xy()).norm();
        let (bottom, top) = (self.params.band_min_m - DROP_M, self.params.band_max_m);
        let share = match h1 {
            h if h > top => ((top - h0).max(0.0) / (h1 - h0)).max(0.0),
            h if h < bottom => ((h0 - bottom).max(0.0) / (h0 - h1)).max(0.0),
            _ => 1.0,
        };
        let end = self.sensor.xy() + (end.xy() - self.sensor.xy()) * share;
        let range = (end - self.sensor.xy()).norm();
        if !(range.is_finite() && range > 0.0) {
            return;
        }
        let column = self.column(columns, &Point3::new(end.x, end.y, 0.0));
        column.include(slope);
        if range > column.farthest_free {
            (column.farthest_free, column.free) = (range, end);
        }
    }

    fn column<'c>(&self, columns: &'c mut [Column], p: &Point3<f64>) -> &'c mut Column {
        let azimuth = (p.y - self.sensor.y).atan2(p.x - self.sensor.x);
        let last = columns.len() - 1;
        &mut columns[(((azimuth + PI) / TAU * (last + 1) as f64) as usize).min(last)]
    }

    fn hit_at(&self, update: &mut ScanUpdate, end: &Point2<f64>, heights: Heights) {
        if let Some(cell) = self.geometry.cell(end) {
            update.mark(cell, Mark::Hit(heights));
        }
    }

    /// What a column says of a free cell: the heights at which its beams pass there.
    fn passed(&self, cell: Cell, slopes: &[f32]) -> Mark {
        let range = (self.geometry.center(cell) - self.sensor.xy()).norm();
        let at = |slope: &f32| Heights::at(self.params, self.sensor.z - self.floor_z + f64::from(*slope) * range);
        Mark::Free(slopes.iter().map(at).fold(Heights::NONE, Heights::joined))
    }

    /// Frees the cells from the sensor to `end`, without that of `end` itself.
    fn free_before(&self, update: &mut ScanUpdate, end: &Point2<f64>, passed: impl Fn(Cell) -> Mark) {
        let last = self.geometry.cell(end);
        walk(self.geometry, &self.sensor.xy(), end, |cell| {
            if Some(cell) != last {
                update.mark(cell, passed(cell));
            }
        });
    }

    /// Frees the cells towards `end`, at most as far as the largest range.
    fn free_towards(&self, update: &mut ScanUpdate, end: &Point2<f64>, range: f64, passed: impl Fn(Cell) -> Mark) {
        if range.is_finite() {
            let share = (self.params.range_max_m / range).min(1.0);
            let end = self.sensor.xy() + (end - self.sensor.xy()) * if range > 0.0 { share } else { 0.0 };
            walk(self.geometry, &self.sensor.xy(), &end, |cell| update.mark(cell, passed(cell)));
        }
    }
}
