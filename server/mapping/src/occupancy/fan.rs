//! The cells that beams from one place pass, filled as a whole instead of beam by beam.
//!
//! In a row of cells a beam passes the columns between where it enters the row and where it leaves it. Near the sensor what
//! neighbouring beams pass there overlaps or touches, so that of many beams only the first and the last matter. Beams that leave
//! the sensor's row upwards are looked at from left to right, and those downwards likewise:
//!
//! - Two neighbours **join** in a row that both pass through, if the second enters at most a cell behind where the first one leaves.
//!   As beams diverge, this holds up to some row. Joined beams make runs, and all between the ends of a run is passed.
//! - What a beam that ends a run passes is marked itself, and the run is filled between two **edges**: the parity of
//!   edges left of a cell, or in it, says whether it lies in a run (as polygons are filled). Where two runs overlap, parity is
//!   wrong only in cells that their ends marked themselves.
//! - In the row in which it ends, a beam is marked itself. In the sensor's row all beams share a cell: one stretch.
//!
//! Where beams cross borders between rows is computed in parts of cells of 2^-40, without a step of rounding that adds up. The walk
//! rounds each crossing; both are off by less than [`NEAR`] (below). No crossing that decides is as near to a border between columns, or
//! the caller is told to walk: so both give the same cells, always. Other crossings lie between ones that decide.
//!
//! How far off: with M = size of coordinates in cells and slope s (columns a row), the walk places a crossing within 2 eps M (1 + |s|) by
//! rounding borders and within eps/2 * steps * columns by adding up (2^-53 * 4000 * 2000 = 9e-10); this code within 2 eps M (1 + |s|) and
//! 2^-40 * rows (2e-9). Beams with M (1 + |s|) over 2^24 are walked; for the others both together are below 2e-8 of a cell.
//!
//! Bound: what is read and written is the words of the rectangle, three times; then a few operations for each row that a beam ends a
//! run in, eight rows at once. Source: none known; walks are Amanatides and Woo's (1987).

use super::beams::Beam;
use super::mark::Mark;
use super::planar::PlanarMarks;
use nalgebra::Point2;
use percept_geometry::grid::walk;
use percept_geometry::{GridGeometry, by_processor};

/// Bits behind the point of columns.
const FRACTION: u32 = 40;
/// So near to a border between columns, in parts of cells, rounding may decide: 2^-24 of a cell.
const NEAR: i64 = 1 << (FRACTION - 24);
/// Beams of more columns a row are walked, whatever their coordinates: parts of cells have to fit.
const STEEPEST: f64 = 4096.0;
/// See the file's head.
const LARGEST: f64 = (1 << 24) as f64;
/// Neighbours join only if that much nearer than a cell, of one.
const MARGIN: f64 = 1e-6;
/// Rows at once.
const LANES: usize = 8;

/// All bits of the first so many rows.
const KEEP: [[u64; LANES]; LANES + 1] = {
    let mut keep = [[0; LANES]; LANES + 1];
    let mut count = 0;
    while count <= LANES {
        let mut i = 0;
        while i < count {
            keep[count][i] = u64::MAX;
            i += 1;
        }
        count += 1;
    }
    keep
};

/// A beam that leaves the sensor's row.
struct Line {
    /// Columns a row away from the sensor.
    slope: f64,
    /// Borders between rows that it crosses.
    rows: i32,
    /// The column in which it ends.
    end: i64,
}

/// Where a fan starts, in the rectangle.
struct Start {
    x: f64,
    y: f64,
    column: i64,
    row: i64,
}

/// Bits that are marked, and the rectangle's rows.
struct Area<'a> {
    free: &'a mut [u64],
    edges: &'a mut [u64],
    height: usize,
    /// Negative once a crossing was too near to a border.
    near: [i64; LANES],
}

/// Which edge of a run a beam is.
#[derive(Clone, Copy, PartialEq)]
enum Edge {
    Left,
    Right,
    None,
}

/// Frees the cells that beams `from` a point (metres) pass, the last of each included. False if rounding may decide about one: then what is
/// marked is of no use.
pub(super) fn free(marks: &mut PlanarMarks, geometry: &GridGeometry, from: &Point2<f64>, beams: &[Beam]) -> bool {
    let Some(cell) = geometry.cell(from) else { return false };
    if beams.is_empty() {
        return true;
    }
    let (first, height) = (marks.first(), marks.height());
    let place = |v: f64, origin: f64, first: i32| (v - origin) / geometry.resolution_m - f64::from(first);
    let start = Start {
        x: place(from.x, geometry.origin.x, first.x),
        y: place(from.y, geometry.origin.y, first.y),
        column: i64::from(cell.x) - i64::from(first.x),
        row: i64::from(cell.y) - i64::from(first.y),
    };
    let coordinates = from.x.abs() + from.y.abs() + geometry.origin.x.abs() + geometry.origin.y.abs();
    let size = coordinates / geometry.resolution_m + (marks.free.len() / height * 64 + height) as f64;
    let steepest = STEEPEST.min(LARGEST / size - 1.0);
    let (mut up, mut down) = (Vec::with_capacity(beams.len()), Vec::with_capacity(beams.len()));
    let (mut low, mut high) = (start.column, start.column);
    for beam in beams {
        let (rows, end) = (beam.end.y - cell.y, i64::from(beam.end.x) - i64::from(first.x));
        if rows == 0 {
            (low, high) = (low.min(end), high.max(end));
            continue;
        }
        let d = beam.to - from;
        let line = Line { slope: d.x / d.y.abs(), rows: rows.abs(), end };
        if line.slope.abs() <= steepest {
            if rows > 0 { &mut up } else { &mut down }.push(line);
        } else {
            let heights = marks.heights;
            walk(geometry, from, &beam.to, |cell| marks.mark(cell, Mark::Free(heights)));
        }
    }
    let mut edges = vec![0; marks.free.len()];
    let mut area = Area { free: &mut marks.free, edges: &mut edges, height, near: [0; LANES] };
    for (lines, is_up) in [(&mut up, true), (&mut down, false)] {
        lines.sort_by(|a, b| a.slope.total_cmp(&b.slope));
        let joins = joins(lines, &start, is_up);
        let columns = draw(lines, &joins, &start, is_up, &mut area);
        (low, high) = (low.min(columns.0), high.max(columns.1));
    }
    let is_sure = area.near.iter().all(|near| *near >= 0);
    if is_sure {
        span(area.free, height, start.row as usize, low as u64, high as u64);
        fill(area.edges, area.free, height);
    }
    is_sure
}

/// Up to which row, counted from the sensor's, each line joins the next one.
fn joins(lines: &[Line], start: &Start, is_up: bool) -> Vec<i32> {
    // To the first border.
    let part = if is_up { start.row as f64 + 1.0 - start.y } else { start.y - start.row as f64 };
    let join = |pair: &[Line]| {
        let (a, b) = (pair[0].slope, pair[1].slope);
        // How far the nearer to upright of both goes on towards the other one within a row.
        let on = if a > 0.0 { a } else { (-b).max(0.0) };
        ((1.0 - MARGIN) * (1.0 + on) / (b - a) + 1.0 - part) as i32
    };
    lines.windows(2).map(join).collect()
}

by_processor! {
    [avx512]
    /// Marks what the ends of runs pass in rows that they pass through, and all lines in the rows in which they end. Returns the first and
    /// the last column that lines pass in the sensor's row, its own if there are none.
    fn draw(lines: &[Line], joins: &[i32], start: &Start, is_up: bool, area: &mut Area<'_>) -> (i64, i64) {
        let (mut first, mut last) = (start.column, start.column);
        for (k, line) in lines.iter().enumerate() {
            // Columns a row upwards, and where it crosses the lower border of the sensor's row.
            let slope = if is_up { line.slope } else { -line.slope };
            let by = parts(slope);
            let passing = line.rows - 1;
            let left = if k > 0 { joins[k - 1].min(lines[k - 1].rows - 1) } else { 0 };
            let right = if k + 1 < lines.len() { joins[k].min(lines[k + 1].rows - 1) } else { 0 };
            let one = left.max(right).min(passing);
            let both = left.min(right).min(passing);
            let edge = if left < right { Edge::Left } else { Edge::Right };
            for (above, to, edge) in [(both, one, edge), (one, passing, Edge::None)] {
                if above < to {
                    let bottom = if is_up { start.row + i64::from(above) + 1 } else { start.row - i64::from(to) };
                    let at = parts(start.x + (bottom as f64 - start.y) * slope);
                    stretch(area, bottom as usize, (to - above) as usize, at, by, edge);
                }
            }
            // Where it comes into the row in which it ends.
            let (row, border) = if is_up {
                (start.row + i64::from(line.rows), start.row + i64::from(line.rows))
            } else {
                (start.row - i64::from(line.rows), start.row - i64::from(line.rows) + 1)
            };
            let column = crossed(area, parts(start.x + (border as f64 - start.y) * slope));
            span(area.free, area.height, row as usize, column.min(line.end) as u64, column.max(line.end) as u64);
            if k == 0 || k + 1 == lines.len() {
                let border = start.row + i64::from(is_up);
                let column = crossed(area, parts(start.x + (border as f64 - start.y) * slope));
                (first, last) = (first.min(column), last.max(column));
            }
        }
        (first, last)
    }
}

/// In parts of cells.
#[inline(always)]
fn parts(columns: f64) -> i64 {
    (columns * (1u64 << FRACTION) as f64) as i64
}

/// Negative if a place is too near to a border between columns.
#[inline(always)]
fn near(place: i64) -> i64 {
    (place.wrapping_add(NEAR) & ((1 << FRACTION) - 1)) - 2 * NEAR
}

/// The column of a crossing.
#[inline(always)]
fn crossed(area: &mut Area<'_>, place: i64) -> i64 {
    area.near[0] |= near(place);
    place >> FRACTION
}

/// Marks the columns that a line passes in so many rows from `bottom` on, whose lower border it crosses `at`, and edges of runs there.
#[inline(always)]
fn stretch(area: &mut Area<'_>, bottom: usize, rows: usize, at: i64, by: i64, edge: Edge) {
    // From here the columns of a row begin, and they end so much farther.
    let (mut at, wide) = (at + by.min(0), by.abs());
    let steps: [i64; LANES] = std::array::from_fn(|i| by.wrapping_mul(i as i64));
    for begin in (0..rows).step_by(LANES) {
        let count = (rows - begin).min(LANES);
        let last = at.wrapping_add(by.wrapping_mul(count as i64 - 1));
        let least = at.min(last) as u64 >> FRACTION;
        let most = (at.max(last).wrapping_add(wide) as u64 >> FRACTION) + 1;
        let low = steps.map(|step| at.wrapping_add(step));
        let high = low.map(|low| low.wrapping_add(wide));
        area.near.iter_mut().zip(low.iter().zip(&high)).for_each(|(all, (low, high))| *all |= near(*low) | near(*high));
        let [low, high] = [low, high].map(|places| places.map(|place| place as u64 >> FRACTION));
        at = at.wrapping_add(by.wrapping_mul(LANES as i64));
        let row = bottom + begin;
        let word = (least >> 6) as usize * area.height + row;
        let (Some(free), Some(edges)) = (area.free.get_mut(word..word + LANES), area.edges.get_mut(word..word + LANES))
        else {
            // Out of the rectangle, which holds all beams: walk.
            area.near[0] = -1;
            continue;
        };
        if least >> 6 != most >> 6 {
            // Not all in one column of words.
            for i in 0..count {
                span(area.free, area.height, row + i, low[i], high[i]);
                let column = if edge == Edge::Left { low[i] } else { high[i] + 1 };
                if edge != Edge::None {
                    area.edges[(column >> 6) as usize * area.height + row + i] ^= 1 << (column & 63);
                }
            }
            continue;
        }
        let keep = &KEEP[count];
        for (((free, keep), low), high) in free.iter_mut().zip(keep).zip(&low).zip(&high) {
            *free |= keep & (2u64 << (high & 63)).wrapping_sub(1 << (low & 63));
        }
        if edge != Edge::None {
            let columns = if edge == Edge::Left { low } else { high.map(|high| high + 1) };
            for ((edges, keep), column) in edges.iter_mut().zip(keep).zip(columns) {
                *edges ^= keep & 1 << (column & 63);
            }
        }
    }
}

/// Marks columns of a row, from `low` to `high`, both included.
#[inline(always)]
fn span(free: &mut [u64], height: usize, row: usize, low: u64, high: u64) {
    let (from, to) = (u64::MAX << (low & 63), u64::MAX >> (63 - (high & 63)));
    let (first, last) = ((low >> 6) as usize, (high >> 6) as usize);
    if first == last {
        free[first * height + row] |= from & to;
        return;
    }
    free[first * height + row] |= from;
    for column in first + 1..last {
        free[column * height + row] = u64::MAX;
    }
    free[last * height + row] |= to;
}

by_processor! {
    [avx512]
    /// Marks the cells from each edge, itself included, up to the next one of the row.
    fn fill(edges: &[u64], free: &mut [u64], height: usize) {
        // All bits of rows in which a run goes on.
        let mut inside = vec![0u64; height];
        for (edges, free) in edges.chunks_exact(height).zip(free.chunks_exact_mut(height)) {
            for ((edges, free), inside) in edges.iter().zip(free).zip(&mut inside) {
                let mut bits = *edges;
                for shift in [1, 2, 4, 8, 16, 32] {
                    bits ^= bits << shift;
                }
                bits ^= *inside;
                *inside = 0u64.wrapping_sub(bits >> 63);
                *free |= bits;
            }
        }
    }
}

#[cfg(test)]
mod tests;
