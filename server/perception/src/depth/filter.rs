//! Noise and edges of depth images.

use super::positive;
use percept_geometry::{DepthImage, GeometryError};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// When two neighbouring pixels lie on two surfaces.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct EdgeParams {
    /// Part of the depth by which the farther pixel has to lie behind the nearer one.
    pub min_jump_fraction: f64,
    /// Pixels around an edge that are marked too: flying pixels sit there.
    pub margin_px: usize,
}

impl Default for EdgeParams {
    fn default() -> Self {
        Self { min_jump_fraction: 0.05, margin_px: 1 }
    }
}

/// Which pixels lie at a depth discontinuity, `H x W` row-major: those that jump against one of their four
/// neighbours, and all within the margin around them (a square). Pixels without return make no edge.
///
/// # Errors
/// `OutOfRange` naming the parameter.
pub fn edge_mask(depth: &DepthImage, params: &EdgeParams) -> Result<Vec<bool>, GeometryError> {
    positive("min_jump_fraction", params.min_jump_fraction)?;
    if params.margin_px > 64 {
        let value = params.margin_px as f64;
        return Err(GeometryError::OutOfRange { field: "margin_px", value, requirement: "at most 64" });
    }
    let (w, h, data) = (depth.width(), depth.height(), depth.data());
    let jump = params.min_jump_fraction as f32;
    let differs = |a: f32, b: f32| a > 0.0 && b > 0.0 && (a - b).abs() > jump * a.min(b);
    let mut mask = vec![false; data.len()];
    for v in 0..h {
        for u in 0..w {
            let i = v * w + u;
            if u + 1 < w && differs(data[i], data[i + 1]) {
                (mask[i], mask[i + 1]) = (true, true);
            }
            if v + 1 < h && differs(data[i], data[i + w]) {
                (mask[i], mask[i + w]) = (true, true);
            }
        }
    }
    Ok(if params.margin_px == 0 { mask } else { dilate(&mask, w, h, params.margin_px) })
}

/// A square dilation, rows then columns.
fn dilate(mask: &[bool], w: usize, h: usize, margin: usize) -> Vec<bool> {
    let mut rows = vec![false; mask.len()];
    for (i, _) in mask.iter().enumerate().filter(|(_, m)| **m) {
        let (u, row) = (i % w, i - i % w);
        rows[row + u.saturating_sub(margin)..=row + (u + margin).min(w - 1)].fill(true);
    }
    let mut out = vec![false; mask.len()];
    for (i, _) in rows.iter().enumerate().filter(|(_, m)| **m) {
        let (u, v) = (i % w, i / w);
        for y in v.saturating_sub(margin)..=(v + margin).min(h - 1) {
            out[y * w + u] = true;
        }
    }
    out
}

/// How strongly [`bilateral`] smooths.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BilateralParams {
    /// Half the window's side, pixels, 1 to 16.
    pub radius_px: usize,
    /// Standard deviation over the image, pixels.
    pub sigma_px: f64,
    /// Standard deviation over depth, as a part of the depth.
    pub sigma_depth_fraction: f64,
}

impl Default for BilateralParams {
    fn default() -> Self {
        Self { radius_px: 3, sigma_px: 2.0, sigma_depth_fraction: 0.015 }
    }
}

/// Smooths noise and keeps edges; pixels without return stay so and do not count.
///
/// Source: Tomasi and Manduchi, "Bilateral filtering for gray and color images", 1998. Over inverse-free
/// depth with a width that grows with the depth, cut off at three deviations.
///
/// # Errors
/// `OutOfRange` naming the parameter.
pub fn bilateral(depth: &DepthImage, params: &BilateralParams) -> Result<DepthImage, GeometryError> {
    positive("sigma_px", params.sigma_px)?;
    positive("sigma_depth_fraction", params.sigma_depth_fraction)?;
    if !(1..=16).contains(&params.radius_px) {
        let value = params.radius_px as f64;
        return Err(GeometryError::OutOfRange { field: "radius_px", value, requirement: "between 1 and 16" });
    }
    let r = params.radius_px as isize;
    let spatial: Vec<f32> = (0..=r).map(|d| (-0.5 * (d as f64 / params.sigma_px).powi(2)).exp() as f32).collect();
    let (w, h, data) = (depth.width(), depth.height(), depth.data());
    let mut out = vec![0.0; data.len()];
    out.par_chunks_mut(w.max(1)).enumerate().for_each(|(v, row)| {
        for (u, pixel) in row.iter_mut().enumerate() {
            let d = data[v * w + u];
            if d == 0.0 {
                continue;
            }
            let inverse = 1.0 / (params.sigma_depth_fraction as f32 * d);
            let (mut sum, mut weight) = (0.0, 0.0);
            for y in v.saturating_sub(r as usize)..=(v + r as usize).min(h - 1) {
                for x in u.saturating_sub(r as usize)..=(u + r as usize).min(w - 1) {
                    let q = data[y * w + x];
                    let e = (q - d) * inverse;
                    if q > 0.0 && e.abs() < 3.0 {
                        let k = spatial[y.abs_diff(v)] * spatial[x.abs_diff(u)] * (-0.5 * e * e).exp();
                        sum += k * q;
                        weight += k;
                    }
                }
            }
            *pixel = sum / weight;
        }
    });
    DepthImage::new(w, h, out)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    fn step(noise: f32) -> DepthImage {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(5);
        let data = (0..40 * 30)
            .map(|i| if i % 40 < 20 { 1.0 } else { 2.0 } + noise * rng.random_range(-1.0..1.0f32))
            .collect();
        DepthImage::new(40, 30, data).unwrap()
    }

    #[test]
    fn edges_are_marked_on_both_sides_and_nowhere_else() {
        let mask = edge_mask(&step(0.0), &EdgeParams { margin_px: 0, ..Default::default() }).unwrap();
        assert!(mask.iter().enumerate().all(|(i, m)| *m == (19..=20).contains(&(i % 40))));
        let mask = edge_mask(&step(0.0), &EdgeParams { margin_px: 2, ..Default::default() }).unwrap();
        assert!(mask.iter().enumerate().all(|(i, m)| *m == (17..=22).contains(&(i % 40))));
    }

    #[test]
    fn bilateral_smooths_each_side_of_an_edge_by_itself() {
        let (noisy, truth) = (step(0.01), step(0.0));
        let smooth = bilateral(&noisy, &BilateralParams::default()).unwrap();
        let rms = |image: &DepthImage| {
            let e: f32 = image.data().iter().zip(truth.data()).map(|(a, b)| (a - b).powi(2)).sum();
            (e / 1200.0).sqrt()
        };
        // Uniform noise of 1 cm has a deviation of 5.8 mm; a window of 49 pixels takes most of it away.
        assert!(rms(&noisy) > 0.005 && rms(&smooth) < 0.0025, "{} {}", rms(&noisy), rms(&smooth));
    }

    #[test]
    fn holes_stay_holes() {
        let mut data = step(0.0).data().to_vec();
        data[100] = 0.0;
        let smooth = bilateral(&DepthImage::new(40, 30, data).unwrap(), &BilateralParams::default()).unwrap();
        assert_eq!(smooth.data()[100], 0.0);
        assert_eq!(smooth.data()[101], 2.0);
    }
}
