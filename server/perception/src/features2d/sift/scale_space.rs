//! Gaussians of growing width, in octaves: the image at double size first, then halved again and again.

use percept_geometry::{GrayImage, by_processor};
use rayon::prelude::*;

/// Scales of an octave in which extrema are looked for.
pub(super) const LAYERS: usize = 3;
/// Images of an octave.
pub(super) const IMAGES: usize = LAYERS + 3;
/// Blur of each octave's first image, pixels.
pub(super) const SIGMA: f64 = 1.6;
/// Blur that a camera's image is taken to have, pixels.
const CAMERA_SIGMA: f64 = 0.5;
/// Rows a task.
const ROWS: usize = 32;

/// A place in scale space.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Extremum {
    pub(super) octave: usize,
    /// The Gaussian image nearest in scale.
    pub(super) layer: usize,
    pub(super) row: usize,
    pub(super) column: usize,
    /// Pixels of the octave.
    pub(super) x: f32,
    pub(super) y: f32,
    /// Scale, pixels of the octave.
    pub(super) sigma: f32,
    /// Contrast, of the full range.
    pub(super) response: f32,
}

/// Grey as numbers 0..=255, rows one after another.
#[derive(Debug, Default)]
pub(super) struct Plane {
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) data: Vec<f32>,
}

impl Plane {
    fn shape(&mut self, width: usize, height: usize) {
        (self.width, self.height) = (width, height);
        self.data.resize(width * height, 0.0);
    }

    pub(super) fn row(&self, y: usize) -> &[f32] {
        &self.data[y * self.width..(y + 1) * self.width]
    }
}

/// All octaves; memory is kept from image to image.
#[derive(Debug, Default)]
pub(super) struct ScaleSpace {
    octaves: Vec<[Plane; IMAGES]>,
    count: usize,
    doubled: Plane,
}

impl ScaleSpace {
    /// Of an image; no octaves if a side has less than 8 pixels.
    pub(super) fn build(&mut self, image: &GrayImage) {
        let least = image.width().min(image.height());
        // The smallest octave has 4 to 8 pixels on its shorter side.
        self.count = if least < 8 { 0 } else { (2 * least).ilog2() as usize - 2 };
        if self.octaves.len() < self.count {
            self.octaves.resize_with(self.count, Default::default);
        }
        if self.count == 0 {
            return;
        }
        double(image, &mut self.doubled);
        let first = (SIGMA * SIGMA - (2.0 * CAMERA_SIGMA).powi(2)).sqrt();
        blur(&self.doubled, first, &mut self.octaves[0][0]);
        for o in 0..self.count {
            if o > 0 {
                let (before, now) = self.octaves.split_at_mut(o);
                halve(&before[o - 1][LAYERS], &mut now[0][0]);
            }
            for i in 1..IMAGES {
                let k = 2f64.powf(1.0 / LAYERS as f64);
                let (before, after) = (SIGMA * k.powi(i as i32 - 1), SIGMA * k.powi(i as i32));
                let (done, todo) = self.octaves[o].split_at_mut(i);
                blur(&done[i - 1], (after * after - before * before).sqrt(), &mut todo[0]);
            }
        }
    }

    /// The octaves, each `IMAGES` of growing blur.
    pub(super) fn octaves(&self) -> &[[Plane; IMAGES]] {
        &self.octaves[..self.count]
    }

    /// The image in which an extremum was found.
    pub(super) fn image(&self, e: &Extremum) -> &Plane {
        &self.octaves[e.octave][e.layer]
    }
}

/// Twice the size: pixel (2u, 2v) is the image's (u, v), those between are interpolated.
fn double(image: &GrayImage, out: &mut Plane) {
    let (w, h) = (image.width(), image.height());
    out.shape(2 * w, 2 * h);
    out.data.par_chunks_mut(2 * w * ROWS).enumerate().for_each(|(c, rows)| {
        for (i, row) in rows.chunks_exact_mut(2 * w).enumerate() {
            let y = c * ROWS + i;
            let (top, bottom) = (y / 2, (y.div_ceil(2)).min(h - 1));
            let (top, bottom) = (&image.data()[top * w..(top + 1) * w], &image.data()[bottom * w..(bottom + 1) * w]);
            let grey = |u: usize| (f32::from(top[u]) + f32::from(bottom[u])) * 0.5;
            let mut here = grey(0);
            for u in 0..w {
                let next = grey((u + 1).min(w - 1));
                (row[2 * u], row[2 * u + 1]) = (here, (here + next) * 0.5);
                here = next;
            }
        }
    });
}

/// Every second pixel of every second row.
fn halve(image: &Plane, out: &mut Plane) {
    out.shape(image.width / 2, image.height / 2);
    let width = out.width;
    for (y, row) in out.data.chunks_exact_mut(width).enumerate() {
        row.iter_mut().zip(image.row(2 * y).iter().step_by(2)).for_each(|(o, &p)| *o = p);
    }
}

/// Weights at 0, 1, 2 …, their mirrored sum being 1; cut at 3.5 sigma.
fn kernel(sigma: f64) -> Vec<f32> {
    let radius = (3.5 * sigma).ceil() as usize;
    let weights: Vec<f64> = (0..=radius).map(|i| (-0.5 * (i as f64 / sigma).powi(2)).exp()).collect();
    let sum = weights[0] + 2.0 * weights[1..].iter().sum::<f64>();
    weights.iter().map(|w| (w / sum) as f32).collect()
}

/// Index mirrored at the border (the border itself is not repeated).
fn mirrored(i: isize, n: usize) -> usize {
    let period = 2 * (n as isize - 1);
    let i = if period == 0 { 0 } else { i.rem_euclid(period) };
    (if i >= n as isize { period - i } else { i }) as usize
}

/// Gaussian blur by columns, then by rows, mirrored at the borders.
pub(super) fn blur(image: &Plane, sigma: f64, out: &mut Plane) {
    let (w, h) = (image.width, image.height);
    out.shape(w, h);
    let kernel = kernel(sigma);
    let r = kernel.len() - 1;
    out.data.par_chunks_mut(w * ROWS).enumerate().for_each(|(c, rows)| {
        let mut padded = vec![0.0f32; w + 2 * r];
        let mut taps: Vec<&[f32]> = Vec::with_capacity(2 * r + 1);
        for (i, row) in rows.chunks_exact_mut(w).enumerate() {
            let y = (c * ROWS + i) as isize;
            taps.clear();
            taps.extend((-(r as isize)..=r as isize).map(|d| image.row(mirrored(y + d, h))));
            columns(&taps, &kernel, &mut padded[r..r + w]);
            for k in 1..=r {
                padded[r - k] = padded[r + mirrored(-(k as isize), w)];
                padded[r + w - 1 + k] = padded[r + mirrored((w - 1 + k) as isize, w)];
            }
            line(&padded, &kernel, row);
        }
    });
}

/// Pixels whose sums are kept in registers.
const LANES: usize = 32;

by_processor! {
    fn columns(taps: &[&[f32]], kernel: &[f32], out: &mut [f32]) -> () {
        let (n, r) = (out.len(), kernel.len() - 1);
        let mut at = 0;
        while at + LANES <= n {
            let get = |k: usize| -> &[f32; LANES] { taps[k][at..at + LANES].try_into().unwrap_or(&[0.0; LANES]) };
            let middle = get(r);
            let mut sum: [f32; LANES] = std::array::from_fn(|i| middle[i] * kernel[0]);
            for (k, &weight) in kernel.iter().enumerate().skip(1) {
                let (a, b) = (get(r - k), get(r + k));
                for i in 0..LANES {
                    sum[i] += (a[i] + b[i]) * weight;
                }
            }
            out[at..at + LANES].copy_from_slice(&sum);
            at += LANES;
        }
        for x in at..n {
            out[x] = taps[r][x] * kernel[0];
            for (k, &weight) in kernel.iter().enumerate().skip(1) {
                out[x] += (taps[r - k][x] + taps[r + k][x]) * weight;
            }
        }
    }
}

by_processor! {
    fn line(padded: &[f32], kernel: &[f32], out: &mut [f32]) -> () {
        let (n, r) = (out.len(), kernel.len() - 1);
        let mut at = 0;
        while at + LANES <= n {
            let get = |k: usize| -> &[f32; LANES] { padded[at + k..at + k + LANES].try_into().unwrap_or(&[0.0; LANES]) };
            let middle = get(r);
            let mut sum: [f32; LANES] = std::array::from_fn(|i| middle[i] * kernel[0]);
            for (k, &weight) in kernel.iter().enumerate().skip(1) {
                let (a, b) = (get(r - k), get(r + k));
                for i in 0..LANES {
                    sum[i] += (a[i] + b[i]) * weight;
                }
            }
            out[at..at + LANES].copy_from_slice(&sum);
            at += LANES;
        }
        for x in at..n {
            out[x] = padded[x + r] * kernel[0];
            for (k, &weight) in kernel.iter().enumerate().skip(1) {
                out[x] += (padded[x + r - k] + padded[x + r + k]) * weight;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blurs_add_up_in_squares() {
        let mut image = Plane::default();
        image.shape(70, 50);
        image.data[25 * 70 + 35] = 1.0;
        let (mut a, mut b, mut c) = (Plane::default(), Plane::default(), Plane::default());
        blur(&image, 3.0, &mut a);
        blur(&a, 4.0, &mut b);
        blur(&image, 5.0, &mut c);
        let most = c.data.iter().fold(0.0f32, |m, &x| m.max(x));
        let off = b.data.iter().zip(&c.data).map(|(x, y)| (x - y).abs()).fold(0.0, f32::max);
        assert!(off < 0.01 * most, "{off} of {most}");
        assert!((f64::from(most) - 1.0 / (std::f64::consts::TAU * 25.0)).abs() < 1e-4);
    }

    #[test]
    fn borders_are_mirrored() {
        assert_eq!((mirrored(-2, 5), mirrored(5, 5), mirrored(9, 5), mirrored(-3, 1)), (2, 3, 1, 0));
    }
}
