//! 4 x 4 histograms of 8 directions, relative to the keypoint's direction.

use super::scale_space::{Extremum, Plane};
use percept_geometry::by_processor;
use std::f32::consts::{FRAC_PI_2, PI, TAU};

const SIDE: usize = 4;
const BINS: usize = 8;
/// Histograms with a border of one on each side, and one more direction at each cell's end for the way round.
const PADDED: usize = SIDE + 2;
const CELL: usize = BINS + 1;

/// 128 bytes: cell by cell, row-major, 8 directions each (Lowe 2004, section 6).
pub(super) fn describe(image: &Plane, e: &Extremum, angle: f32, root: bool) -> [u8; 128] {
    let sums = accumulate(image, e, angle);
    let mut out = [0.0f32; 128];
    for r in 0..SIDE {
        for c in 0..SIDE {
            let cell = &sums[((r + 1) * PADDED + c + 1) * CELL..][..CELL];
            let to = &mut out[(r * SIDE + c) * BINS..][..BINS];
            to.copy_from_slice(&cell[..BINS]);
            to[0] += cell[BINS];
        }
    }
    normalise(&mut out, root)
}

fn accumulate(image: &Plane, e: &Extremum, angle: f32) -> [f32; PADDED * PADDED * CELL] {
    let mut sums = [0.0; PADDED * PADDED * CELL];
    // A cell is three sigmas wide.
    let width = 3.0 * e.sigma;
    let (sin, cos) = (angle.sin() / width, angle.cos() / width);
    let radius = (width * std::f32::consts::SQRT_2 * (SIDE as f32 + 1.0) * 0.5 + 0.5) as usize;
    let (w, h) = (image.width, image.height);
    let (x0, y0) = (e.x, e.y);
    let rows = (e.row.saturating_sub(radius)).max(1)..(e.row + radius + 1).min(h - 1);
    let mut scratch = Samples::default();
    for y in rows {
        let dy = y as f32 - y0;
        let Some((from, to)) = span(dy, sin, cos, x0, w) else { continue };
        let part = |y: usize, shift: usize| &image.row(y)[from + shift - 1..to + shift - 1];
        let n = to - from;
        scratch.resize(n);
        let Samples { angles, values, rows, columns } = &mut scratch;
        gradients([part(y, 0), part(y, 2), part(y - 1, 1), part(y + 1, 1)], angles, values);
        place(from as f32 - x0, dy, sin, cos, angle, angles, values, rows, columns);
        for i in 0..n {
            add(&mut sums, rows[i], columns[i], angles[i], values[i]);
        }
    }
    sums
}

#[derive(Default)]
struct Samples {
    angles: Vec<f32>,
    values: Vec<f32>,
    rows: Vec<f32>,
    columns: Vec<f32>,
}

impl Samples {
    fn resize(&mut self, n: usize) {
        for v in [&mut self.angles, &mut self.values, &mut self.rows, &mut self.columns] {
            v.resize(n, 0.0);
        }
    }
}

/// Columns of a row whose samples lie within the turned square, and have both neighbours.
fn span(dy: f32, sin: f32, cos: f32, x0: f32, width: usize) -> Option<(usize, usize)> {
    const HALF: f32 = 0.5 * SIDE as f32 + 0.5;
    let (mut low, mut high) = (1.0 - x0, width as f32 - 2.0 - x0);
    // |slope dx + offset| < HALF, for both axes of the square.
    for (slope, offset) in [(cos, sin * dy), (-sin, cos * dy)] {
        if slope.abs() < 1e-9 {
            if offset.abs() >= HALF {
                return None;
            }
            continue;
        }
        let (a, b) = ((-HALF - offset) / slope, (HALF - offset) / slope);
        low = low.max(a.min(b));
        high = high.min(a.max(b));
    }
    let (from, to) = ((low + x0).ceil().max(1.0), (high + x0).floor() + 1.0);
    (to > from).then_some((from as usize, (to as usize).min(width - 1))).filter(|(a, b)| b > a)
}

by_processor! {
    /// Directions, `0..=TAU`, and sizes of gradients from left, right, upper and lower neighbours.
    pub(super) fn gradients(around: [&[f32]; 4], angles: &mut [f32], values: &mut [f32]) -> () {
        let n = angles.len();
        let [left, right, up, down] = around.map(|s| &s[..n]);
        let values = &mut values[..n];
        for i in 0..n {
            let (dx, dy) = (right[i] - left[i], down[i] - up[i]);
            values[i] = (dx * dx + dy * dy).sqrt();
            angles[i] = direction(dx, dy);
        }
    }
}

/// atan2(y, x), `0..=TAU`, within 2e-4: enough for bins of 45 degrees.
#[inline(always)]
fn direction(x: f32, y: f32) -> f32 {
    let (ax, ay) = (x.abs(), y.abs());
    let (small, large) = if ax < ay { (ax, ay) } else { (ay, ax) };
    let t = small / (large + 1e-20);
    let t2 = t * t;
    let a = t * (0.999_866 + t2 * (-0.330_299_5 + t2 * (0.180_141 + t2 * (-0.085_133 + t2 * 0.020_835_1))));
    let a = if ay > ax { FRAC_PI_2 - a } else { a };
    let a = if x < 0.0 { PI - a } else { a };
    if y < 0.0 { TAU - a } else { a }
}

by_processor! {
    /// Samples in the turned square: cells (the first whole one at 1), directions in bins, values weighted.
    fn place(
        first: f32, dy: f32, sin: f32, cos: f32, angle: f32,
        angles: &mut [f32], values: &mut [f32], rows: &mut [f32], columns: &mut [f32],
    ) -> () {
        let n = angles.len();
        let (values, rows, columns) = (&mut values[..n], &mut rows[..n], &mut columns[..n]);
        for i in 0..n {
            let dx = first + i as i32 as f32;
            let (c, r) = (cos * dx + sin * dy, cos * dy - sin * dx);
            // Gaussian of half the square's width: exp(-(r^2 + c^2) / 8), as the square of its series.
            let t = (r * r + c * c) * (-1.0 / 16.0);
            let half = 1.0 + t * (1.0 + t * (0.5 + t * (1.0 / 6.0 + t * (1.0 / 24.0 + t * (1.0 / 120.0)))));
            values[i] *= half * half;
            columns[i] = c + 2.5;
            rows[i] = r + 2.5;
            let turned = angles[i] - angle;
            angles[i] = (if turned < 0.0 { turned + TAU } else { turned }) * (BINS as f32 / TAU);
        }
    }
}

/// Shares a value among the 8 nearest bins.
#[inline(always)]
fn add(sums: &mut [f32; PADDED * PADDED * CELL], row: f32, column: f32, bin: f32, value: f32) {
    // Positions are not negative but for rounding: casts cut as floor does.
    let (r, c, b) = ((row as usize).min(SIDE), (column as usize).min(SIDE), (bin as usize).min(BINS - 1));
    let (fr, fc, fb) = (row - r as f32, column - c as f32, bin - b as f32);
    let (lower, upper) = (value * fr, value - value * fr);
    let at = (r * PADDED + c) * CELL + b;
    let Some(top) = sums.get_mut(at..at + CELL + 2) else { return };
    let right = upper * fc;
    let left = upper - right;
    top[0] += left - left * fb;
    top[1] += left * fb;
    top[CELL] += right - right * fb;
    top[CELL + 1] += right * fb;
    let at = at + PADDED * CELL;
    let Some(bottom) = sums.get_mut(at..at + CELL + 2) else { return };
    let right = lower * fc;
    let left = lower - right;
    bottom[0] += left - left * fb;
    bottom[1] += left * fb;
    bottom[CELL] += right - right * fb;
    bottom[CELL + 1] += right * fb;
}

/// To length 512 with no part above 0.2 of it; or, rooted, the square roots of parts that sum to 512 squared.
fn normalise(parts: &mut [f32; 128], root: bool) -> [u8; 128] {
    let length = |p: &[f32; 128]| p.iter().map(|v| v * v).sum::<f32>().sqrt();
    let cut = 0.2 * length(parts);
    parts.iter_mut().for_each(|v| *v = v.min(cut));
    if root {
        let sum = parts.iter().sum::<f32>().max(f32::MIN_POSITIVE);
        return parts.map(|v| ((v / sum).sqrt() * 512.0 + 0.5) as u8);
    }
    let scale = 512.0 / length(parts).max(f32::MIN_POSITIVE);
    parts.map(|v| (v * scale + 0.5) as u8)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn directions_are_those_of_atan2() {
        for i in 0..1000 {
            let a = i as f32 * TAU / 1000.0;
            let (y, x) = (a.sin() * 3.0, a.cos() * 3.0);
            let off = (direction(x, y) - y.atan2(x)).rem_euclid(TAU);
            assert!(off.min(TAU - off) < 2e-4, "{a} {off}");
        }
        assert_eq!(direction(0.0, 0.0), 0.0);
    }

    #[test]
    fn an_even_gradient_fills_one_direction() {
        let (w, h) = (80, 80);
        let data = (0..w * h).map(|i| (i % w) as f32).collect();
        let image = Plane { width: w, height: h, data };
        let e = Extremum { octave: 0, layer: 1, row: 40, column: 40, x: 40.0, y: 40.0, sigma: 2.0, response: 1.0 };
        let d = describe(&image, &e, FRAC_PI_2, false);
        // Along x, seen from a keypoint turned by 90 degrees: 270 degrees, bin 6.
        for cell in d.chunks_exact(8) {
            assert!(cell[6] > 50 && cell.iter().enumerate().all(|(b, &v)| b == 6 || v <= 2), "{cell:?}");
        }
    }
}
