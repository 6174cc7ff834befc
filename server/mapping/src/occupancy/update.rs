//! One keyframe as marks on cells: which it saw free, which it hit, each once.

use super::OccupancyParams;
use super::columns::Columns;
use super::ground::Ground;
use nalgebra::{Point2, Point3};
use percept_geometry::grid::walk;
use percept_geometry::{Cell, GridGeometry, KeyframeScan, Pose};

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
    pub(super) fn at(params: &OccupancyParams, height: f64) -> Self {
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
    /// and returns beyond only free. **Others**: heights are taken along the map's z, from the [`Ground`] that the scan
    /// shows, which goes on from the floor under base. Returns in the band mark their ends, unless the ground there is in more doubt
    /// than they are high. In each azimuth column seen from the sensor, the cells up to the nearest of them are
    /// free, or without one, up to the farthest floor return, far return or end of a miss (each only as far as its
    /// beam stays in the band); behind it, those between ground and ground that were seen over it. Where the ground drops, its edge
    /// is marked. Free cells hold the heights at which the beams of the column pass there, so
    /// that looking under a table does not free its top. Points that are not finite, or beyond the range
    /// of the indices, say nothing.
    pub fn new(params: &OccupancyParams, geometry: &GridGeometry, t_map_base: &Pose, scan: &KeyframeScan) -> Self {
        let sensor = Point3::from((t_map_base * scan.t_base_sensor).translation.vector);
        let in_map = |p: &Point3<f32>| t_map_base * p.cast::<f64>();
        let ends = scan.hits.positions.iter().chain(&scan.misses);
        let ranges = ends.map(|p| (in_map(p) - sensor).xy().norm()).filter(|r| r.is_finite());
        let half = (ranges.fold(0.0, f64::max).min(params.range_max()) / geometry.resolution_m).ceil() as i32 + 1;
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
            let hits: Vec<Point3<f64>> = scan.hits.positions.iter().map(in_map).collect();
            let misses: Vec<Point3<f64>> = scan.misses.iter().map(in_map).collect();
            let up = t_map_base * nalgebra::Vector3::z();
            let ground = Ground::new(params, &sensor, (frame.floor_z, &up), &hits);
            Columns::new(&frame, &ground).mark(&mut update, &hits, &misses);
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
pub(super) struct Frame<'a> {
    pub(super) params: &'a OccupancyParams,
    pub(super) geometry: &'a GridGeometry,
    /// Map frame, metres.
    pub(super) sensor: Point3<f64>,
    /// Height of the floor under base in the map, metres.
    pub(super) floor_z: f64,
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
            if range > self.params.range_max() {
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

    /// Frees the cells from one place to another, both included.
    pub(super) fn free_between(
        &self,
        update: &mut ScanUpdate,
        from: &Point2<f64>,
        to: &Point2<f64>,
        passed: impl Fn(Cell) -> Mark,
    ) {
        walk(self.geometry, from, to, |cell| update.mark(cell, passed(cell)));
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
