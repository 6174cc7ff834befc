//! Extrema of the difference of Gaussians, placed between pixels and scales, of enough contrast, not on edges.

use super::SiftParams;
use super::scale_space::{Extremum, IMAGES, LAYERS, Plane, SIGMA, ScaleSpace};
use nalgebra::{Matrix3, Vector3};
use percept_geometry::by_processor;
use rayon::prelude::*;

/// Pixels next to the border are not looked at.
const BORDER: usize = 5;
/// Rows a task.
const ROWS: usize = 32;
/// Differences between neighbouring Gaussians of an octave.
const DIFFERENCES: usize = IMAGES - 1;

/// All extrema, octave by octave, row by row.
pub(super) fn find(space: &ScaleSpace, params: &SiftParams) -> Vec<Extremum> {
    let mut out = Vec::new();
    for (octave, images) in space.octaves().iter().enumerate() {
        let (w, h) = (images[0].width, images[0].height);
        if w <= 2 * BORDER || h <= 2 * BORDER {
            continue;
        }
        let starts: Vec<usize> = (BORDER..h - BORDER).step_by(ROWS).collect();
        let parts: Vec<Vec<Extremum>> = starts
            .par_iter()
            .map(|&start| {
                let mut found = Vec::new();
                scan(images, start..(start + ROWS).min(h - BORDER), params, |layer, row, column| {
                    found.extend(refine(images, octave, [layer, row, column], params));
                });
                found
            })
            .collect();
        out.extend(parts.into_iter().flatten());
    }
    out
}

/// Calls back for each pixel that is above, or below, its 26 neighbours: layer, row, column.
fn scan(
    images: &[Plane; IMAGES],
    rows: std::ops::Range<usize>,
    params: &SiftParams,
    mut candidate: impl FnMut(usize, usize, usize),
) {
    let w = images[0].width;
    // Half of the final threshold: refining may find more.
    let least = (0.5 * params.contrast_threshold / LAYERS as f64 * 255.0) as f32;
    // Differences of three rows, by turns.
    let mut ring: [Vec<f32>; 3] = std::array::from_fn(|_| vec![0.0; DIFFERENCES * w]);
    let fill = |row: &mut [f32], y: usize| {
        for (d, part) in row.chunks_exact_mut(w).enumerate() {
            subtract(images[d + 1].row(y), images[d].row(y), part);
        }
    };
    fill(&mut ring[(rows.start - 1) % 3], rows.start - 1);
    fill(&mut ring[rows.start % 3], rows.start);
    let (mut high, mut low) = (vec![0.0; DIFFERENCES * w], vec![0.0; DIFFERENCES * w]);
    let mut marks = vec![0u8; w];
    for y in rows {
        fill(&mut ring[(y + 1) % 3], y + 1);
        spans(&ring[0], &ring[1], &ring[2], &mut high, &mut low);
        for layer in 1..=LAYERS {
            let from = layer * w;
            let part = |s: &'_ [f32]| -> [std::ops::Range<usize>; 3] {
                debug_assert!(s.len() >= from + 2 * w);
                [from - w..from, from..from + w, from + w..from + 2 * w]
            };
            let [a, b, c] = part(&high);
            if !mark(
                &ring[y % 3][from..from + w],
                [&high[a.clone()], &high[b.clone()], &high[c.clone()]],
                [&low[a], &low[b], &low[c]],
                least,
                &mut marks,
            ) {
                continue;
            }
            for (x, &marked) in marks.iter().enumerate().take(w - BORDER).skip(BORDER) {
                if marked != 0 {
                    candidate(layer, y, x);
                }
            }
        }
    }
}

by_processor! {
    fn subtract(a: &[f32], b: &[f32], out: &mut [f32]) -> () {
        let n = out.len();
        let (a, b) = (&a[..n], &b[..n]);
        for i in 0..n {
            out[i] = a[i] - b[i];
        }
    }
}

#[inline(always)]
fn larger(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

#[inline(always)]
fn smaller(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

by_processor! {
    /// Largest and least of three rows.
    fn spans(a: &[f32], b: &[f32], c: &[f32], high: &mut [f32], low: &mut [f32]) -> () {
        let n = high.len();
        let (a, b, c, low) = (&a[..n], &b[..n], &c[..n], &mut low[..n]);
        for i in 0..n {
            high[i] = larger(larger(a[i], b[i]), c[i]);
            low[i] = smaller(smaller(a[i], b[i]), c[i]);
        }
    }
}

by_processor! {
    /// Marks values that are the largest or the least of their 27; whether there are any.
    fn mark(values: &[f32], high: [&[f32]; 3], low: [&[f32]; 3], least: f32, marks: &mut [u8]) -> bool {
        let n = values.len();
        let m = n - 2;
        let (values, marks) = (&values[1..n - 1], &mut marks[1..n - 1]);
        let [a, b, c] = high.map(|s| &s[..n]);
        let [d, e, f] = low.map(|s| &s[..n]);
        let mut any = 0u8;
        let mut at = 0;
        while at < m {
            let end = (at + 32).min(m);
            let mut strong = 0u32;
            for value in &values[at..end] {
                strong |= u32::from(value.abs() > least);
            }
            if strong == 0 {
                marks[at..end].fill(0);
                at = end;
                continue;
            }
            for i in at..end {
                let column = |k: usize| larger(larger(a[k], b[k]), c[k]);
                let most = larger(larger(column(i), column(i + 1)), column(i + 2));
                let column = |k: usize| smaller(smaller(d[k], e[k]), f[k]);
                let fewest = smaller(smaller(column(i), column(i + 1)), column(i + 2));
                let v = values[i];
                let is = u8::from((v > least) & (v >= most)) | u8::from((v < -least) & (v <= fewest));
                marks[i] = is;
                any |= is;
            }
            at = end;
        }
        any != 0
    }
}

/// Fits a parabola in x, y and scale and moves to its summit (Lowe 2004, section 4).
fn refine(images: &[Plane; IMAGES], octave: usize, at: [usize; 3], params: &SiftParams) -> Option<Extremum> {
    let (w, h) = (images[0].width, images[0].height);
    let [mut layer, mut row, mut column] = at;
    for _ in 0..5 {
        let d = |dl: i32, dy: i32, dx: i32| {
            let l = (layer as i32 + dl) as usize;
            let i = (row as i32 + dy) as usize * w + (column as i32 + dx) as usize;
            f64::from(images[l + 1].data[i] - images[l].data[i]) / 255.0
        };
        let v = d(0, 0, 0);
        let gradient = Vector3::new(d(0, 0, 1) - d(0, 0, -1), d(0, 1, 0) - d(0, -1, 0), d(1, 0, 0) - d(-1, 0, 0)) * 0.5;
        let xx = d(0, 0, 1) + d(0, 0, -1) - 2.0 * v;
        let yy = d(0, 1, 0) + d(0, -1, 0) - 2.0 * v;
        let ss = d(1, 0, 0) + d(-1, 0, 0) - 2.0 * v;
        let xy = (d(0, 1, 1) - d(0, 1, -1) - d(0, -1, 1) + d(0, -1, -1)) * 0.25;
        let xs = (d(1, 0, 1) - d(1, 0, -1) - d(-1, 0, 1) + d(-1, 0, -1)) * 0.25;
        let ys = (d(1, 1, 0) - d(1, -1, 0) - d(-1, 1, 0) + d(-1, -1, 0)) * 0.25;
        let hessian = Matrix3::new(xx, xy, xs, xy, yy, ys, xs, ys, ss);
        let step = -(hessian.try_inverse()? * gradient);
        if !step.iter().all(|s| s.abs() < 1e6) {
            return None;
        }
        if step.iter().all(|s| s.abs() < 0.5) {
            let contrast = (v + 0.5 * gradient.dot(&step)).abs();
            let (trace, det) = (xx + yy, xx * yy - xy * xy);
            let edge = params.edge_threshold;
            let on_edge = det <= 0.0 || trace * trace * edge >= (edge + 1.0).powi(2) * det;
            if contrast * (LAYERS as f64) < params.contrast_threshold || on_edge {
                return None;
            }
            let sigma = SIGMA * 2f64.powf((layer as f64 + step.z) / LAYERS as f64);
            return Some(Extremum {
                octave,
                layer,
                row,
                column,
                x: (column as f64 + step.x) as f32,
                y: (row as f64 + step.y) as f32,
                sigma: sigma as f32,
                response: contrast as f32,
            });
        }
        let moved = |i: usize, s: f64, low: usize, high: usize| {
            let to = i as f64 + s.round();
            (to >= low as f64 && to < high as f64).then_some(to as usize)
        };
        column = moved(column, step.x, BORDER, w - BORDER)?;
        row = moved(row, step.y, BORDER, h - BORDER)?;
        layer = moved(layer, step.z, 1, LAYERS + 1)?;
    }
    None
}
