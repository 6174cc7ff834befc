//! ORB: oriented FAST corners with 256-bit steered BRIEF descriptors.
//!
//! **Source:** Rublee, Rabaud, Konolige and Bradski, "ORB: an efficient alternative to SIFT or SURF", ICCV 2011. The
//! pattern of pixel pairs is our own (see `pattern`), and corners are spread over the image (see `spread`).

use super::fast::{Corner, corners};
use super::pattern::{ANGLES, PAIRS, REACH, pattern};
use super::pyramid::{Level, resize};
use super::{Descriptors, FeatureError, Features, Keypoint, blur::blur, check_size, spread, within};
use percept_geometry::{GrayImage, by_processor};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// How [`Orb`] finds features.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OrbParams {
    /// Most features of an image, 1 to 100000.
    pub max_features: usize,
    /// Pyramid levels, 1 to 16: more see the same thing from farther away.
    pub num_levels: usize,
    /// From one level to the next, 1.05 to 1.95.
    pub scale_factor: f64,
    /// Least difference of grey between a corner and its surroundings, 1 to 254: lower finds more in dim images.
    pub fast_threshold: u8,
}

impl Default for OrbParams {
    fn default() -> Self {
        Self { max_features: 1000, num_levels: 8, scale_factor: 1.2, fast_threshold: 14 }
    }
}

impl OrbParams {
    /// Checks every field.
    ///
    /// # Errors
    /// `OutOfRange` naming the field.
    pub fn validate(&self) -> Result<(), FeatureError> {
        within("max_features", self.max_features as f64, 1.0, 1e5, "between 1 and 100000")?;
        within("num_levels", self.num_levels as f64, 1.0, 16.0, "between 1 and 16")?;
        within("scale_factor", self.scale_factor, 1.05, 1.95, "between 1.05 and 1.95")?;
        within("fast_threshold", f64::from(self.fast_threshold), 1.0, 254.0, "between 1 and 254")
    }
}

/// Radius of the disc whose centroid gives the direction, pixels.
const RADIUS: usize = 15;
/// No keypoint is nearer to the border of its level: descriptors and the blur under them fit in.
const MARGIN: usize = REACH + 4;

/// Finds ORB features.
#[derive(Debug, Clone)]
pub struct Orb {
    params: OrbParams,
}

impl Orb {
    /// With checked parameters.
    ///
    /// # Errors
    /// `OutOfRange` naming the field.
    pub fn new(params: OrbParams) -> Result<Self, FeatureError> {
        params.validate()?;
        Ok(Self { params })
    }

    /// Features of an image, level by level, the most distinct of a level first; none in an image under 39 x 39.
    ///
    /// # Errors
    /// `ImageTooLarge`.
    pub fn extract(&self, image: &GrayImage) -> Result<Features, FeatureError> {
        check_size(image)?;
        let levels = self.pyramid(image);
        let quotas = self.quotas(&levels);
        let found: Vec<(Vec<Keypoint>, Vec<[u64; 4]>)> = levels
            .par_iter()
            .zip(&quotas)
            .map(|(level, &quota)| {
                let scale = (image.width() as f32 / level.width as f32, image.height() as f32 / level.height as f32);
                describe_level(level, quota, self.params.fast_threshold, scale)
            })
            .collect();
        let (mut keypoints, mut descriptors) = (Vec::new(), Vec::new());
        for (octave, (k, d)) in found.into_iter().enumerate() {
            keypoints.extend(k.into_iter().map(|k| Keypoint { octave: octave as i32, ..k }));
            descriptors.extend(d);
        }
        Ok(Features { keypoints, descriptors: Descriptors::Binary(descriptors) })
    }

    fn pyramid(&self, image: &GrayImage) -> Vec<Level> {
        let (width, height) = (image.width(), image.height());
        let mut levels = vec![Level { width, height, stride: width, data: image.data().to_vec() }];
        for k in 1..self.params.num_levels {
            let shrink = self.params.scale_factor.powi(k as i32);
            let (w, h) = ((width as f64 / shrink).round() as usize, (height as f64 / shrink).round() as usize);
            if w <= 2 * MARGIN || h <= 2 * MARGIN {
                break;
            }
            let next = resize(&levels[k - 1], w, h);
            levels.push(next);
        }
        levels
    }

    /// Features of each level in proportion to its side, as in the paper's implementation.
    fn quotas(&self, levels: &[Level]) -> Vec<usize> {
        let sides: Vec<f64> = (0..levels.len()).map(|k| self.params.scale_factor.powi(-(k as i32))).collect();
        let total: f64 = sides.iter().sum();
        let mut left = self.params.max_features;
        let mut quotas: Vec<usize> = Vec::with_capacity(levels.len());
        for side in &sides {
            let quota = ((self.params.max_features as f64 * side / total).round() as usize).min(left);
            left -= quota;
            quotas.push(quota);
        }
        quotas[0] += left;
        quotas
    }
}

fn describe_level(level: &Level, quota: usize, threshold: u8, scale: (f32, f32)) -> (Vec<Keypoint>, Vec<[u64; 4]>) {
    let mut candidates = corners(level, threshold, MARGIN);
    if candidates.is_empty() || quota == 0 {
        return (Vec::new(), Vec::new());
    }
    // Harris' measure for the better half only: twice as many as wanted, as in the paper.
    strongest(&mut candidates, quota * 3);
    let responses: Vec<f32> = candidates.iter().map(|c| harris(&level.data, level.stride, c.u, c.v)).collect();
    let places: Vec<(u16, u16)> = candidates.iter().map(|c| (c.u, c.v)).collect();
    let chosen = spread::select(&places, &responses, quota, level.width, level.height);
    let smooth = blur(level);
    let offsets = offsets(level.stride);
    chosen
        .iter()
        .map(|&i| {
            let (u, v) = places[i as usize];
            let at = usize::from(v) * level.stride + usize::from(u);
            let (mx, my) = moments(&level.data, level.stride, at);
            let angle = (my as f32).atan2(mx as f32);
            let turn = (f64::from(angle) / std::f64::consts::TAU * ANGLES as f64).round() as i32;
            let pairs = &offsets[turn.rem_euclid(ANGLES as i32) as usize];
            let keypoint = Keypoint {
                u: (f32::from(u) + 0.5) * scale.0 - 0.5,
                v: (f32::from(v) + 0.5) * scale.1 - 0.5,
                size_px: (2 * RADIUS + 1) as f32 * scale.0,
                angle_rad: angle,
                response: responses[i as usize],
                octave: 0,
            };
            (keypoint, describe(&smooth.data, at - REACH * level.stride - REACH, pairs))
        })
        .unzip()
}

/// Keeps the `count` corners of largest score (and those equal to the last), in their order.
fn strongest(corners: &mut Vec<Corner>, count: usize) {
    if corners.len() <= count {
        return;
    }
    let mut histogram = [0usize; 256];
    corners.iter().for_each(|c| histogram[usize::from(c.score)] += 1);
    let (mut sum, mut least) = (0, 255);
    for s in (0..256).rev() {
        sum += histogram[s];
        least = s;
        if sum >= count {
            break;
        }
    }
    corners.retain(|c| usize::from(c.score) >= least);
}

by_processor! {
    /// Harris' measure over 7 x 7 Sobel gradients, k = 0.04 (Harris and Stephens 1988).
    fn harris(data: &[u8], stride: usize, u: u16, v: u16) -> f32 {
        let start = (usize::from(v) - 4) * stride + usize::from(u) - 4;
        let rows: [&[u8]; 9] = std::array::from_fn(|k| &data[start + k * stride..start + k * stride + 16]);
        let (mut xx, mut yy, mut xy) = ([0i32; 8], [0i32; 8], [0i32; 8]);
        for w in rows.windows(3) {
            for i in 0..7 {
                let p = |r: usize, k: usize| i32::from(w[r][i + k]);
                let dx = p(0, 2) - p(0, 0) + 2 * (p(1, 2) - p(1, 0)) + p(2, 2) - p(2, 0);
                let dy = p(2, 0) - p(0, 0) + 2 * (p(2, 1) - p(0, 1)) + p(2, 2) - p(0, 2);
                xx[i] += dx * dx;
                yy[i] += dy * dy;
                xy[i] += dx * dy;
            }
        }
        let sum = |s: [i32; 8]| s.iter().sum::<i32>() as f32 / (49.0 * 1020.0 * 1020.0);
        let (a, b, c) = (sum(xx), sum(yy), sum(xy));
        a * b - c * c - 0.04 * (a + b) * (a + b)
    }
}

/// Half width of the disc's row at distance 0..=15 from its centre.
const HALF: [usize; RADIUS + 1] = [15, 15, 15, 15, 14, 14, 14, 13, 13, 12, 11, 10, 9, 8, 6, 3];

/// One row of weights x for each half width, 0 outside; and the same of ones.
const X_WEIGHTS: [[i16; 32]; RADIUS + 1] = weights(false);
const ONES: [[i16; 32]; RADIUS + 1] = weights(true);

const fn weights(ones: bool) -> [[i16; 32]; RADIUS + 1] {
    let mut out = [[0; 32]; RADIUS + 1];
    let mut row = 0;
    while row <= RADIUS {
        let mut x = 0;
        while x <= 2 * RADIUS {
            let away = x.abs_diff(RADIUS);
            if away <= HALF[row] {
                out[row][x] = if ones { 1 } else { x as i16 - RADIUS as i16 };
            }
            x += 1;
        }
        row += 1;
    }
    out
}

by_processor! {
    /// First moments of the disc around a pixel.
    fn moments(data: &[u8], stride: usize, at: usize) -> (i32, i32) {
        let (mut mx, mut my) = (0, 0);
        for dy in 0..=2 * RADIUS {
            let start = at + dy * stride - RADIUS * stride - RADIUS;
            let row: &[u8; 32] = data[start..start + 32].try_into().unwrap_or(&[0; 32]);
            let d = dy.abs_diff(RADIUS);
            let (xs, ones) = (&X_WEIGHTS[d], &ONES[d]);
            let (mut sx, mut s) = (0i32, 0i32);
            for i in 0..32 {
                let grey = i16::from(row[i]);
                sx += i32::from(grey) * i32::from(xs[i]);
                s += i32::from(grey) * i32::from(ones[i]);
            }
            mx += sx;
            my += s * (dy as i32 - RADIUS as i32);
        }
        (mx, my)
    }
}

/// From the top left of a patch, for each angle the first and the second pixels of all pairs.
type Offsets = Vec<[[u32; 2]; PAIRS]>;

fn offsets(stride: usize) -> Offsets {
    let offset = |(x, y): (i8, i8)| {
        let (x, y) = (i64::from(x) + REACH as i64, i64::from(y) + REACH as i64);
        (y * stride as i64 + x) as u32
    };
    pattern().iter().map(|pairs| std::array::from_fn(|i| pairs[i].map(offset))).collect()
}

/// Bit i: the second pixel of pair i is brighter. `corner` is the top left of the patch.
fn describe(data: &[u8], corner: usize, pairs: &[[u32; 2]; PAIRS]) -> [u64; 4] {
    let patch = &data[corner..];
    std::array::from_fn(|word| {
        let mut bits = 0u64;
        for (i, [a, b]) in pairs[word * 64..word * 64 + 64].iter().enumerate() {
            bits |= u64::from(patch[*a as usize] < patch[*b as usize]) << i;
        }
        bits
    })
}
