//! Main directions of the gradients around a keypoint.

use super::scale_space::{Extremum, Plane};
use std::f32::consts::TAU;

const BINS: usize = 36;

/// Directions whose bin has at least 0.8 of the largest: one, sometimes more; radians, `0..TAU`, from x towards y.
pub(super) fn directions(image: &Plane, e: &Extremum) -> Vec<f32> {
    let histogram = smooth(&histogram(image, e));
    let most = histogram.iter().copied().fold(0.0, f32::max);
    let mut out = Vec::new();
    for i in 0..BINS {
        let (before, here, after) = (histogram[(i + BINS - 1) % BINS], histogram[i], histogram[(i + 1) % BINS]);
        if here > before && here > after && here >= 0.8 * most {
            // Summit of the parabola through the three.
            let bin = i as f32 + 0.5 * (before - after) / (before - 2.0 * here + after);
            out.push((bin * TAU / BINS as f32).rem_euclid(TAU));
        }
    }
    if out.is_empty() {
        out.push(0.0);
    }
    out
}

fn histogram(image: &Plane, e: &Extremum) -> [f32; BINS] {
    let sigma = 1.5 * e.sigma;
    let radius = (3.0 * sigma).round() as usize;
    let weights: Vec<f32> = (0..=radius).map(|i| (-0.5 * (i as f32 / sigma).powi(2)).exp()).collect();
    let (w, h) = (image.width, image.height);
    let rows = e.row.saturating_sub(radius).max(1)..(e.row + radius + 1).min(h - 1);
    let columns = e.column.saturating_sub(radius).max(1)..(e.column + radius + 1).min(w - 1);
    let mut out = [0.0; BINS];
    let (mut bins, mut values) = (vec![0.0; columns.len()], vec![0.0; columns.len()]);
    for y in rows {
        let part = |y: usize, shift: usize| &image.row(y)[columns.start + shift - 1..columns.end + shift - 1];
        super::descriptor::gradients([part(y, 0), part(y, 2), part(y - 1, 1), part(y + 1, 1)], &mut bins, &mut values);
        let wy = weights[y.abs_diff(e.row)];
        for (x, (bin, value)) in columns.clone().zip(bins.iter().zip(&values)) {
            let bin = (bin * (BINS as f32 / TAU) + 0.5) as usize;
            out[if bin >= BINS { bin - BINS } else { bin }] += value * wy * weights[x.abs_diff(e.column)];
        }
    }
    out
}

/// By (1, 4, 6, 4, 1) / 16, around the circle.
fn smooth(h: &[f32; BINS]) -> [f32; BINS] {
    let at = |i: usize| h[i % BINS];
    std::array::from_fn(|i| {
        (at(i + BINS - 2) + at(i + 2)) / 16.0 + (at(i + BINS - 1) + at(i + 1)) * 0.25 + at(i) * 0.375
    })
}
