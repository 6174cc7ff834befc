//! Pairs of points that look alike: each the other's nearest by feature.

use super::super::fpfh::{FPFH_LEN, Fpfh};
use super::keypoints::Keys;
use nalgebra::Point3;
use rayon::prelude::*;

/// Features compared side by side.
const LANES: usize = 16;
/// Source features of one task.
const ROWS: usize = 128;
/// More pairs than this cost more than they bring; those with the most alike features are kept.
const MAX_PAIRS: usize = 2000;

/// A pair of points, metres, each in its own cloud's frame.
#[derive(Debug, Clone, Copy)]
pub(super) struct Pair {
    pub(super) source: Point3<f64>,
    pub(super) target: Point3<f64>,
    /// Squared distance of their features.
    unlike: f32,
}

/// Mutual nearest neighbours of features, most alike first.
pub(super) fn pairs(source: &Keys, target: &Keys) -> Vec<Pair> {
    let (rows, columns) = nearest(&source.features, &target.features);
    let mutual = |(i, &(unlike, j)): (usize, &(f32, u32))| {
        let back = columns.get(j as usize)?.1;
        let pair = || Pair { source: source.positions[i], target: target.positions[j as usize], unlike };
        (back as usize == i).then(pair)
    };
    let mut out: Vec<Pair> = rows.iter().enumerate().filter_map(mutual).collect();
    out.sort_by(|a, b| a.unlike.total_cmp(&b.unlike));
    out.truncate(MAX_PAIRS);
    out
}

/// Squared distance and index.
type Nearest = (f32, u32);

/// Nearest of `b` for every feature of `a`, and the reverse; of equals the first.
fn nearest(a: &[Fpfh], b: &[Fpfh]) -> (Vec<Nearest>, Vec<Nearest>) {
    let blocks = Block::of(b);
    let parts: Vec<(Vec<Nearest>, Vec<Nearest>)> = a
        .par_chunks(ROWS)
        .enumerate()
        .map(|(c, rows)| {
            let mut of_rows = vec![(f32::INFINITY, u32::MAX); rows.len()];
            let mut of_columns = vec![(f32::INFINITY, u32::MAX); b.len()];
            compare(rows, (c * ROWS) as u32, &blocks, &mut of_rows, &mut of_columns);
            (of_rows, of_columns)
        })
        .collect();
    let mut columns = vec![(f32::INFINITY, u32::MAX); b.len()];
    let mut rows = Vec::with_capacity(a.len());
    for (of_rows, of_columns) in parts {
        rows.extend(of_rows);
        for (best, found) in columns.iter_mut().zip(of_columns) {
            if found.0 < best.0 {
                *best = found;
            }
        }
    }
    (rows, columns)
}

/// Features side by side: one number of all of them after the other.
struct Block {
    numbers: [[f32; LANES]; FPFH_LEN],
    squares: [f32; LANES],
    used: usize,
}

impl Block {
    fn of(features: &[Fpfh]) -> Vec<Self> {
        let block = |chunk: &[Fpfh]| {
            // What no feature fills is infinitely far from all.
            let mut out =
                Self { numbers: [[0.0; LANES]; FPFH_LEN], squares: [f32::INFINITY; LANES], used: chunk.len() };
            for (lane, f) in chunk.iter().enumerate() {
                (0..FPFH_LEN).for_each(|k| out.numbers[k][lane] = f[k]);
                out.squares[lane] = f.iter().map(|v| v * v).sum();
            }
            out
        };
        features.chunks(LANES).map(block).collect()
    }
}

percept_geometry::by_processor! {
    fn compare(rows: &[Fpfh], first: u32, blocks: &[Block], of_rows: &mut [Nearest], of_columns: &mut [Nearest]) {
        // The nearest of each row so far, a lane for the columns of its own; without branches.
        let mut best = vec![[f32::INFINITY; LANES]; rows.len()];
        let mut best_block = vec![[u32::MAX; LANES]; rows.len()];
        let squares: Vec<f32> = rows.iter().map(|row| row.iter().map(|v| v * v).sum()).collect();
        for (b, block) in blocks.iter().enumerate() {
            let (mut column, mut column_row) = ([f32::INFINITY; LANES], [u32::MAX; LANES]);
            for (r, row) in rows.iter().enumerate() {
                let mut dot = [0.0f32; LANES];
                for (x, numbers) in row.iter().zip(&block.numbers) {
                    dot.iter_mut().zip(numbers).for_each(|(d, n)| *d += x * n);
                }
                let (best, best_block) = (&mut best[r], &mut best_block[r]);
                for lane in 0..LANES {
                    let distance2 = squares[r] + block.squares[lane] - 2.0 * dot[lane];
                    let nearer = distance2 < best[lane];
                    best[lane] = if nearer { distance2 } else { best[lane] };
                    best_block[lane] = if nearer { b as u32 } else { best_block[lane] };
                    let nearer = distance2 < column[lane];
                    column[lane] = if nearer { distance2 } else { column[lane] };
                    column_row[lane] = if nearer { first + r as u32 } else { column_row[lane] };
                }
            }
            for lane in 0..block.used {
                of_columns[b * LANES + lane] = (column[lane], column_row[lane]);
            }
        }
        for (r, of_row) in of_rows.iter_mut().enumerate() {
            let lanes = (0..LANES).filter(|&lane| best_block[r][lane] != u32::MAX);
            let found = lanes.map(|lane| (best[r][lane], best_block[r][lane] * LANES as u32 + lane as u32));
            *of_row = found.min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1))).unwrap_or(*of_row);
        }
    }
}
