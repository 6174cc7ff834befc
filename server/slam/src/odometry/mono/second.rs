//! What a second camera whose mount is known says of the first one's features: how far they are, in metres.
//!
//! A feature of the first camera lies on a known ray; where the second camera shows it, on that ray's image (the epipolar
//! line), tells its distance. Only this one number is asked of each: a free pose of the second camera would confuse a small
//! turn with a baseline of a few centimetres.
//!
//! **Source**: Hartley and Zisserman, "Multiple View Geometry in Computer Vision", 2004, chapters 9 and 12.

use super::frame::{Frame, Lens, hamming, sigma};
use super::pose::CHI2;
use super::search::NEAR_BITS;
use nalgebra::{Point3, Vector2};
use percept_geometry::Pose;
use rayon::prelude::*;

/// Nothing is nearer to a camera than this, metres: a longer epipolar line brings more false matches.
const MIN_DEPTH_M: f64 = 0.2;
/// The best match is better by this factor than the next one on the line. Lowe's ratio.
const RATIO: f64 = 0.8;

/// A point of the map in the first camera: undistorted pixel, look, and place in the camera, the map's unit.
pub(super) type Shown = (Vector2<f64>, [u64; 4], Point3<f64>);

/// How far a feature is along its camera's axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct InverseDepth {
    /// 1/m. What a pixel tells is this, so that its error is the same near and far.
    pub(super) value: f64,
    /// By how many standard deviations of a pixel 1/m moves it.
    pub(super) weight: f64,
}

impl InverseDepth {
    /// How far it is off for a point at `z`, in standard deviations.
    #[inline]
    pub(super) fn residual(&self, z: f64) -> f64 {
        (1.0 / z - self.value) * self.weight
    }
}

/// A second camera's image, and how it is mounted.
pub(super) struct SecondView {
    frame: Frame,
    lens: Lens,
    t_second_camera: Pose,
}

impl SecondView {
    pub(super) fn new(frame: Frame, lens: Lens, t_camera_second: &Pose) -> Self {
        Self { frame, lens, t_second_camera: t_camera_second.inverse() }
    }

    /// Units of the map in a metre, by the points that both cameras show, and its relative standard error; none if there are
    /// fewer than `needed`.
    ///
    /// The median is of inverse distances: it does not lean to near or far. It is weighted, as a far point tells little.
    pub(super) fn units_per_metre(&self, shown: &[Shown], lens: &Lens, needed: usize) -> Option<(f64, f64)> {
        let one = |(pixel, look, point): &Shown| {
            let told = self.depth(pixel, look, lens)?;
            Some((told.value * point.z, told.weight / point.z))
        };
        let mut told: Vec<(f64, f64)> = shown.iter().filter_map(one).collect();
        if told.len() < needed {
            return None;
        }
        let units = weighted_median(&mut told);
        let mut off: Vec<(f64, f64)> = told.iter().map(|(u, w)| ((u / units - 1.0).abs(), *w)).collect();
        // 1.4826 makes the median deviation a standard deviation, 1.25 is the median's loss against the mean.
        let error = 1.25 * 1.4826 * weighted_median(&mut off) / (told.len() as f64).sqrt();
        (units > 0.0 && units.is_finite()).then_some((units, error))
    }

    /// How far each feature of the first camera's image is; none for those that this camera does not show.
    pub(super) fn depths(&self, frame: &Frame, lens: &Lens) -> Vec<Option<InverseDepth>> {
        (0..frame.len()).into_par_iter().map(|f| self.depth(&frame.pixels[f], &frame.descriptors[f], lens)).collect()
    }

    /// How far a feature of the first camera is, if this one shows it.
    fn depth(&self, pixel: &Vector2<f64>, look: &[u64; 4], lens: &Lens) -> Option<InverseDepth> {
        // At the inverse distance w (1/m) the point is, in the second camera, on the ray far + w * aside.
        let far = self.t_second_camera.rotation * pixel.push(lens.focal) / lens.focal;
        let aside = self.t_second_camera.translation.vector;
        let mut on_line: Vec<(u32, f64, f64)> = vec![];
        for f in 0..self.frame.len() {
            let at = self.frame.pixels[f] / self.lens.focal;
            let (miss, moves) = (far.xy() - at * far.z, aside.xy() - at * aside.z);
            let w = -miss.dot(&moves) / moves.norm_squared();
            let z = far.z + w * aside.z;
            let per_sigma = self.lens.focal / (z * sigma(self.frame.octaves[f]));
            if z <= 1e-6 || (miss + w * moves).norm_squared() * per_sigma * per_sigma > CHI2 {
                continue;
            }
            // A far point is met a little beyond infinity as often as before it.
            let weight = moves.norm() * per_sigma;
            if w * weight >= -CHI2.sqrt() && w <= 1.0 / MIN_DEPTH_M {
                on_line.push((hamming(&self.frame.descriptors[f], look), w, weight));
            }
        }
        let &(bits, value, weight) = on_line.iter().min_by_key(|(bits, ..)| *bits)?;
        // One corner is found on several levels: those are no rivals.
        let is_rival = |other: f64| (other - value).abs() * weight > 2.0 * CHI2.sqrt();
        let rival = on_line.iter().filter(|(_, other, _)| is_rival(*other)).map(|(bits, ..)| *bits).min();
        let is_clear = f64::from(bits) <= RATIO * rival.map_or(f64::INFINITY, f64::from);
        (bits <= NEAR_BITS && is_clear).then_some(InverseDepth { value, weight })
    }
}

/// Where half of the weight is; values and weights.
fn weighted_median(values: &mut [(f64, f64)]) -> f64 {
    values.sort_by(|a, b| a.0.total_cmp(&b.0));
    let half = 0.5 * values.iter().map(|v| v.1).sum::<f64>();
    let mut before = 0.0;
    let reached = values.iter().find(|v| {
        before += v.1;
        before >= half
    });
    reached.map_or(f64::NAN, |v| v.0)
}
