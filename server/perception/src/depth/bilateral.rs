//! Smoothing that keeps edges and holes.

use super::{positive, size};
use percept_geometry::{DepthImage, GeometryError, by_processor};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// How strongly [`bilateral`] smooths.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BilateralParams {
    /// Radius of the round window, pixels, 1 to 16.
    pub radius_px: usize,
    /// Standard deviation over the image, pixels.
    pub sigma_px: f64,
    /// Standard deviation over depth, metres.
    pub sigma_depth_m: f64,
}

impl Default for BilateralParams {
    fn default() -> Self {
        Self { radius_px: 2, sigma_px: 5.0, sigma_depth_m: 0.03 }
    }
}

impl BilateralParams {
    /// Checks the bounds.
    ///
    /// # Errors
    /// `OutOfRange` naming the field.
    pub fn validate(&self) -> Result<(), GeometryError> {
        positive("sigma_px", self.sigma_px)?;
        positive("sigma_depth_m", self.sigma_depth_m)?;
        if !(1..=16).contains(&self.radius_px) {
            let value = self.radius_px as f64;
            return Err(GeometryError::OutOfRange { field: "radius_px", value, requirement: "between 1 and 16" });
        }
        Ok(())
    }

    /// The window's pixels after its centre, in reading order, with the base-2 logarithm of their weight: the pixels
    /// before the centre see the same pair from its other end.
    fn pairs(&self) -> Vec<Pair> {
        let r = self.radius_px as isize;
        let after = (0..=r).flat_map(|dy| (-r..=r).map(move |dx| (dx, dy)));
        let after = after.filter(|&(dx, dy)| (dy > 0 || dx > 0) && dx * dx + dy * dy <= r * r);
        let log = |d2: isize| -0.5 * d2 as f64 / self.sigma_px.powi(2) * std::f64::consts::LOG2_E;
        let pair = |(dx, dy): (isize, isize)| Pair { dx, dy: dy as usize, log: log(dx * dx + dy * dy) as f32 };
        after.map(pair).collect()
    }
}

#[derive(Clone, Copy)]
struct Pair {
    dx: isize,
    dy: usize,
    log: f32,
}

/// Smooths noise and keeps edges; pixels without return stay so and do not count. Pixels beyond the border do not count
/// either.
///
/// Each pair of pixels is weighed once for both. Weights are good to 1e-4 of themselves, results to some micrometres.
///
/// Source: Tomasi and Manduchi, "Bilateral filtering for gray and color images", 1998.
///
/// # Errors
/// `OutOfRange` naming the parameter.
pub fn bilateral(depth: &DepthImage, params: &BilateralParams) -> Result<DepthImage, GeometryError> {
    params.validate()?;
    let (w, h) = size(depth);
    let mut out = vec![0.0; depth.data().len()];
    if out.is_empty() {
        return Ok(depth.clone());
    }
    let (pairs, r) = (params.pairs(), params.radius_px);
    let scale = (-0.5 / params.sigma_depth_m.powi(2) * std::f64::consts::LOG2_E) as f32;
    out.par_chunks_mut(w * BAND).enumerate().for_each(|(i, rows)| {
        smooth(depth.data(), w, i * BAND, r, &pairs, scale, rows);
    });
    DepthImage::new(w, h, out)
}

/// Rows of one unit of work; fixed, so that results do not depend on threads.
const BAND: usize = 60;
/// Pixels that are worked on together.
const BLOCK: usize = 32;
/// Where a hole is put: so far off that its weight is 2^-126 of a neighbour's.
const NOWHERE: f32 = -1e9;

/// 2^x for x in -126..=0: a polynomial on -0.5..0.5, the rest by the exponent's bits. Relative error below 1e-4.
#[inline(always)]
fn exp2(x: f32) -> f32 {
    const ROUND: f32 = 12_582_912.0;
    let x = if x > -126.0 { x } else { -126.0 };
    let whole = x + ROUND;
    let f = x - (whole - ROUND);
    let p = 1.0 + f * (std::f32::consts::LN_2 + f * (0.240_227 + f * (0.055_504 + f * 0.009_618)));
    f32::from_bits(p.to_bits().wrapping_add(whole.to_bits() << 23))
}

by_processor! {
    [avx512]
    /// Smooths the rows from `v0` on, as many as `out` holds.
    fn smooth(data: &[f32], w: usize, v0: usize, r: usize, pairs: &[Pair], scale: f32, out: &mut [f32]) {
        let (h, pad) = (data.len() / w, 32);
        let room = w.next_multiple_of(BLOCK) + 2 * pad;
        let num_rows = out.len() / w;
        // The band with r rows more on either side, holes and surroundings far off.
        let mut source = vec![NOWHERE; room * (num_rows + 2 * r)];
        for (i, row) in source.chunks_mut(room).enumerate() {
            let v = (v0 + i).wrapping_sub(r);
            if v < h {
                for (s, &d) in row[pad..pad + w].iter_mut().zip(&data[v * w..(v + 1) * w]) {
                    *s = if d > 0.0 { d } else { NOWHERE };
                }
            }
        }
        // Weights of each pair, for the last dy + 1 rows of its upper pixel.
        let mut weights: Vec<Vec<f32>> = pairs.iter().map(|p| vec![0.0; room * (p.dy + 1)]).collect();
        for i in 0..num_rows + r {
            for (pair, weights) in pairs.iter().zip(&mut weights) {
                let upper = &source[i * room..(i + 1) * room];
                let lower = &source[(i + pair.dy) * room..(i + pair.dy + 1) * room];
                let ring = &mut weights[i % (pair.dy + 1) * room..][..room];
                // From the first pixel on whose partner may lie in the image.
                for x in (0..room - pad).step_by(BLOCK) {
                    let x = x.min(room - pad - BLOCK).max(pad - r);
                    let mut block = [0.0f32; BLOCK];
                    let a = &upper[x..x + BLOCK];
                    let b = &lower[x.wrapping_add_signed(pair.dx)..][..BLOCK];
                    for j in 0..BLOCK {
                        let e = a[j] - b[j];
                        block[j] = exp2(e * e * scale + pair.log);
                    }
                    ring[x..x + BLOCK].copy_from_slice(&block);
                }
            }
            if i < r {
                continue;
            }
            let centre = &source[i * room..(i + 1) * room];
            let out = &mut out[(i - r) * w..(i - r + 1) * w];
            for x in (0..w).step_by(BLOCK) {
                let (mut sum, mut weight) = ([0.0f32; BLOCK], [1.0f32; BLOCK]);
                let c = &centre[pad + x..pad + x + BLOCK];
                for (pair, weights) in pairs.iter().zip(&weights) {
                    let (here, there) = (i % (pair.dy + 1), (i - pair.dy) % (pair.dy + 1));
                    let after = (pad + x).wrapping_add_signed(pair.dx);
                    let before = (pad + x).wrapping_add_signed(-pair.dx);
                    let wa = &weights[here * room + pad + x..][..BLOCK];
                    let wb = &weights[there * room + before..][..BLOCK];
                    let a = &source[(i + pair.dy) * room + after..][..BLOCK];
                    let b = &source[(i - pair.dy) * room + before..][..BLOCK];
                    for j in 0..BLOCK {
                        // Differences from the centre: sums keep all digits.
                        sum[j] += wa[j] * (a[j] - c[j]) + wb[j] * (b[j] - c[j]);
                        weight[j] += wa[j] + wb[j];
                    }
                }
                let mut block = [0.0f32; BLOCK];
                for j in 0..BLOCK {
                    let smooth = c[j] + sum[j] / weight[j];
                    block[j] = if c[j] > 0.0 { smooth } else { 0.0 };
                }
                let n = BLOCK.min(w - x);
                out[x..x + n].copy_from_slice(&block[..n]);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    fn step(w: usize, h: usize, noise: f32) -> DepthImage {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(5);
        let at = |i: usize| if i % w < w / 2 { 1.0 } else { 2.0 };
        let data = (0..w * h).map(|i| at(i) + noise * rng.random_range(-1.0..1.0f32)).collect();
        DepthImage::new(w, h, data).unwrap()
    }

    fn plain(depth: &DepthImage, params: &BilateralParams) -> Vec<f64> {
        let (w, h, r) = (depth.width() as isize, depth.height() as isize, params.radius_px as isize);
        let at = |u: isize, v: isize| f64::from(depth.at(u as usize, v as usize));
        let pixel = |u: isize, v: isize| {
            let (mut sum, mut weight) = (0.0, 0.0);
            for (x, y) in (-r..=r).flat_map(|y| (-r..=r).map(move |x| (x, y))) {
                let inside = (0..w).contains(&(u + x)) && (0..h).contains(&(v + y));
                if x * x + y * y > r * r || !inside || at(u + x, v + y) == 0.0 {
                    continue;
                }
                let e = (at(u + x, v + y) - at(u, v)) / params.sigma_depth_m;
                let k = (-0.5 * e * e - 0.5 * (x * x + y * y) as f64 / params.sigma_px.powi(2)).exp();
                sum += k * at(u + x, v + y);
                weight += k;
            }
            if at(u, v) > 0.0 { sum / weight } else { 0.0 }
        };
        (0..h).flat_map(|v| (0..w).map(move |u| (u, v))).map(|(u, v)| pixel(u, v)).collect()
    }

    #[test]
    fn the_fast_filter_is_the_plain_one() {
        for (w, h, radius_px, sigma_px) in
            [(1, 1, 2, 5.0), (7, 70, 3, 1.0), (100, 9, 2, 5.0), (33, 130, 5, 2.0), (20, 20, 16, 8.0)]
        {
            let mut data = step(w, h, 0.04).data().to_vec();
            data.iter_mut().step_by(11).for_each(|d| *d = 0.0);
            let depth = DepthImage::new(w, h, data).unwrap();
            let params = BilateralParams { radius_px, sigma_px, ..Default::default() };
            let smooth = bilateral(&depth, &params).unwrap();
            for (i, (a, b)) in smooth.data().iter().zip(plain(&depth, &params)).enumerate() {
                assert!((f64::from(*a) - b).abs() < 1e-5, "{w} x {h}, pixel {i}: {a} {b}");
            }
        }
    }

    #[test]
    fn bilateral_smooths_each_side_of_an_edge_by_itself() {
        let (noisy, truth) = (step(40, 30, 0.01), step(40, 30, 0.0));
        let smooth = bilateral(&noisy, &BilateralParams { radius_px: 3, ..Default::default() }).unwrap();
        let rms = |image: &DepthImage| {
            let e: f32 = image.data().iter().zip(truth.data()).map(|(a, b)| (a - b).powi(2)).sum();
            (e / 1200.0).sqrt()
        };
        // Uniform noise of 1 cm has a deviation of 5.8 mm; a window of 29 pixels takes most of it away.
        assert!(rms(&noisy) > 0.005 && rms(&smooth) < 0.0025, "{} {}", rms(&noisy), rms(&smooth));
    }

    #[test]
    fn holes_stay_holes() {
        let mut data = step(40, 30, 0.0).data().to_vec();
        data[100] = 0.0;
        let smooth = bilateral(&DepthImage::new(40, 30, data).unwrap(), &BilateralParams::default()).unwrap();
        assert_eq!(smooth.data()[100], 0.0);
        assert_eq!(smooth.data()[101], 2.0);
    }
}
