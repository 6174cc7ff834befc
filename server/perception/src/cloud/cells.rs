//! Points sorted into cells so small that all points of one are neighbours.

use nalgebra::Point3;
use percept_geometry::{by_processor, cloud::is_finite};
use rayon::prelude::*;

/// Cells along an axis that a key has room for, two of them as a margin on either side.
const MAX_CELLS: f64 = (1 << 21) as f64 - 8.0;
const MARGIN: u64 = 4;
/// Cells whose points are judged by one task.
const CHUNK: usize = 256;
/// Columns of cells that may hold neighbours: 5 x 5, nearest first.
const COLUMNS: [(i64, i64); 25] = columns();

/// Finite points in cells of edge `eps / sqrt 3` (a little less, for rounding): two points of one cell are within
/// `eps`, and all neighbours of a point are in the 5 x 5 x 5 cells around its own.
///
/// A cell's key has x, y and z from its high bits down, and cells are in the order of their keys: five cells of a
/// column lie side by side, and so do their points.
///
/// Source: Gunawan, "A faster algorithm for DBSCAN", 2013; three dimensions as in de Berg et al., "Faster DBSCAN and
/// HDBSCAN in low-dimensional Euclidean spaces", 2017.
pub(super) struct Cells {
    eps2: f32,
    keys: Vec<u64>,
    /// First point of each cell, and the number of points.
    starts: Vec<u32>,
    xs: Vec<f32>,
    ys: Vec<f32>,
    zs: Vec<f32>,
    /// Index of each in the cloud; ascending in a cell.
    pub(super) indices: Vec<u32>,
}

impl Cells {
    /// None if the cloud is so wide, or `eps` so small, that cells cannot be numbered.
    pub(super) fn new(points: &[Point3<f32>], eps: f32) -> Option<Self> {
        let edge = f64::from(eps) / 3f64.sqrt() * (1.0 - 1e-5);
        let (mut low, mut high) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
        for p in points.iter().filter(|p| is_finite(p)) {
            for a in 0..3 {
                low[a] = low[a].min(p[a]);
                high[a] = high[a].max(p[a]);
            }
        }
        let cells_across = |a: usize| (f64::from(high[a]) - f64::from(low[a])) / edge;
        if !(edge > 1e-18 && (0..3).all(|a| cells_across(a) < MAX_CELLS)) {
            return None;
        }
        let cell = |p: &Point3<f32>, a: usize| ((f64::from(p[a]) - f64::from(low[a])) / edge) as u64 + MARGIN;
        let key = |p: &Point3<f32>| cell(p, 0) << 42 | cell(p, 1) << 21 | cell(p, 2);
        let finite = points.iter().zip(0u32..).filter(|(p, _)| is_finite(p));
        let mut sorted: Vec<(u64, u32)> = finite.map(|(p, i)| (key(p), i)).collect();
        sorted.par_sort_unstable();
        let axis = |a: usize| sorted.iter().map(|&(_, i)| points[i as usize][a]).collect();
        let (xs, ys, zs) = (axis(0), axis(1), axis(2));
        let (mut keys, mut starts) = (Vec::new(), Vec::new());
        for (place, &(key, _)) in sorted.iter().enumerate() {
            if keys.last() != Some(&key) {
                keys.push(key);
                starts.push(place as u32);
            }
        }
        starts.push(sorted.len() as u32);
        let indices = sorted.iter().map(|&(_, i)| i).collect();
        Some(Self { eps2: eps * eps, keys, starts, xs, ys, zs, indices })
    }

    /// Number of cells that hold a point.
    pub(super) fn len(&self) -> usize {
        self.keys.len()
    }

    /// Places of a cell's points.
    pub(super) fn places(&self, cell: usize) -> std::ops::Range<usize> {
        self.starts[cell] as usize..self.starts[cell + 1] as usize
    }

    /// Whether each point (by place) has at least `min_points` within eps, itself among them.
    pub(super) fn cores(&self, min_points: usize) -> Vec<bool> {
        let judged: Vec<Vec<bool>> = self
            .chunks()
            .map(|chunk| {
                let mut out = Vec::new();
                self.walk(chunk, |cell, columns| {
                    let places = self.places(cell);
                    if places.len() >= min_points {
                        out.extend(places.map(|_| true));
                        return;
                    }
                    out.extend(places.map(|place| {
                        let mut count = 0;
                        columns.iter().any(|column| {
                            count += self.count(place, self.span(column));
                            count >= min_points
                        })
                    }));
                });
                out
            })
            .collect();
        judged.concat()
    }

    /// Pairs of cells, the later first, that hold a pair of neighbours of which both take part. Cells that `joined`
    /// says to be of one set already are not looked at again; `join` tells of new pairs.
    pub(super) fn join(&self, takes_part: &[bool], mut visit: impl FnMut(usize, usize, &mut dyn FnMut() -> bool)) {
        let any: Vec<bool> = (0..self.len()).map(|cell| takes_part[self.places(cell)].contains(&true)).collect();
        self.walk(0..self.len(), |cell, columns| {
            if !any[cell] {
                return;
            }
            for other in columns.iter().flat_map(|c| c.clone()).filter(|&other| other < cell && any[other]) {
                visit(cell, other, &mut || {
                    let members = self.places(cell).filter(|&place| takes_part[place]);
                    members.into_iter().any(|place| self.meets(place, self.places(other), takes_part))
                });
            }
        });
    }

    /// The least value among the neighbours of each point that is `asked` for, by place.
    pub(super) fn least_around(&self, values: &[Option<u32>], asked: &[bool]) -> Vec<Option<u32>> {
        let found: Vec<Vec<Option<u32>>> = self
            .chunks()
            .map(|chunk| {
                let mut out = Vec::new();
                self.walk(chunk, |cell, columns| {
                    out.extend(self.places(cell).map(|place| {
                        let spans = columns.iter().map(|column| self.span(column)).filter(|_| asked[place]);
                        spans.flat_map(|span| self.least(place, span, values)).min()
                    }));
                });
                out
            })
            .collect();
        found.concat()
    }

    fn chunks(&self) -> impl IndexedParallelIterator<Item = std::ops::Range<usize>> {
        let chunk = |i: usize| i * CHUNK..((i + 1) * CHUNK).min(self.len());
        (0..self.len().div_ceil(CHUNK)).into_par_iter().map(chunk)
    }

    /// Calls `visit` with each cell of a range and the ranges of cells in the columns about it. Columns of cells in
    /// turn only ever move on, so that nothing is searched for.
    fn walk(&self, cells: std::ops::Range<usize>, mut visit: impl FnMut(usize, &[std::ops::Range<usize>; 25])) {
        let Some(&first) = self.keys.get(cells.start) else { return };
        let low = |key: u64, (dx, dy): (i64, i64)| key.wrapping_add_signed((dx << 42) + (dy << 21)) - 2;
        let mut begins = COLUMNS.map(|column| self.keys.partition_point(|&k| k < low(first, column)));
        let mut columns: [_; 25] = std::array::from_fn(|_| 0..0);
        for cell in cells {
            for ((column, begin), out) in COLUMNS.iter().zip(&mut begins).zip(&mut columns) {
                let from = low(self.keys[cell], *column);
                while self.keys.get(*begin).is_some_and(|&k| k < from) {
                    *begin += 1;
                }
                let mut end = *begin;
                while self.keys.get(end).is_some_and(|&k| k <= from + 4) {
                    end += 1;
                }
                *out = *begin..end;
            }
            visit(cell, &columns);
        }
    }

    fn span(&self, cells: &std::ops::Range<usize>) -> std::ops::Range<usize> {
        self.starts[cells.start] as usize..self.starts[cells.end] as usize
    }

    fn at(&self, place: usize) -> [f32; 3] {
        [self.xs[place], self.ys[place], self.zs[place]]
    }

    fn count(&self, place: usize, span: std::ops::Range<usize>) -> usize {
        count_near(&self.at(place), &self.xs[span.clone()], &self.ys[span.clone()], &self.zs[span], self.eps2)
    }

    fn near(&self, place: usize, other: usize) -> bool {
        let ([px, py, pz], [qx, qy, qz]) = (self.at(place), self.at(other));
        let (dx, dy, dz) = (px - qx, py - qy, pz - qz);
        dx * dx + dy * dy + dz * dz <= self.eps2
    }

    fn meets(&self, place: usize, mut others: std::ops::Range<usize>, takes_part: &[bool]) -> bool {
        others.any(|other| takes_part[other] && self.near(place, other))
    }

    fn least(&self, place: usize, mut span: std::ops::Range<usize>, values: &[Option<u32>]) -> Option<u32> {
        let near = span.by_ref().filter(|&other| values[other].is_some() && self.near(place, other));
        near.filter_map(|other| values[other]).min()
    }
}

by_processor! {
    fn count_near(p: &[f32; 3], xs: &[f32], ys: &[f32], zs: &[f32], eps2: f32) -> usize {
        let mut count = 0u32;
        for ((x, y), z) in xs.iter().zip(ys).zip(zs) {
            let (dx, dy, dz) = (p[0] - x, p[1] - y, p[2] - z);
            count += u32::from(dx * dx + dy * dy + dz * dz <= eps2);
        }
        count as usize
    }
}

const fn columns() -> [(i64, i64); 25] {
    let mut out = [(0, 0); 25];
    let (mut n, mut distance2) = (0, 0);
    while n < 25 {
        let mut i = 0;
        while i < 25 {
            let (dx, dy) = (i / 5 - 2, i % 5 - 2);
            if dx * dx + dy * dy == distance2 {
                out[n] = (dx, dy);
                n += 1;
            }
            i += 1;
        }
        distance2 += 1;
    }
    out
}
