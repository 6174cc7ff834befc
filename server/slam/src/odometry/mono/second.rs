//! How many of the map's units a metre is, by a second camera whose mount is known.
//!
//! A point of the map that the first camera shows lies on a known ray; where the second camera shows it, on that ray's
//! image (the epipolar line), tells its distance in metres. Only this one number is asked of each point: a free pose of the
//! second camera would confuse a small turn with a baseline of a few centimetres.
//!
//! **Source**: Hartley and Zisserman, "Multiple View Geometry in Computer Vision", 2004, chapters 9 and 12.

use super::frame::{Frame, Lens, hamming, sigma};
use super::pose::CHI2;
use super::search::NEAR_BITS;
use nalgebra::{Point3, Vector2};
use percept_geometry::Pose;

/// Nothing is nearer to a camera than this, metres: a longer epipolar line brings more false matches.
const MIN_DEPTH_M: f64 = 0.2;
/// The best match is better by this factor than the next one on the line. Lowe's ratio.
const RATIO: f64 = 0.8;

/// A point of the map in the first camera: undistorted pixel, look, and place in the camera, the map's unit.
pub(super) type Shown = (Vector2<f64>, [u64; 4], Point3<f64>);

/// Units of the map in a metre, by the points that both cameras show, and its relative standard error; none if there are
/// fewer than `needed`.
///
/// What a pixel tells is the inverse of a distance, so that the median is of those: it does not lean to near or far. It is
/// weighted, as a far point tells little.
pub(super) fn units_per_metre(
    shown: &[Shown],
    lens: &Lens,
    second: &Frame,
    second_lens: &Lens,
    t_camera_second: &Pose,
    needed: usize,
) -> Option<(f64, f64)> {
    let t_second_camera = t_camera_second.inverse();
    let one = |shown: &Shown| told(shown, lens, second, second_lens, &t_second_camera);
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

/// Units in a metre by one point, and by how many standard deviations of a pixel one unit would move it.
fn told(
    (pixel, look, point): &Shown,
    lens: &Lens,
    second: &Frame,
    second_lens: &Lens,
    t_second_camera: &Pose,
) -> Option<(f64, f64)> {
    // At the inverse distance w (1/m) the point is, in the second camera, on the ray far + w * aside.
    let far = t_second_camera.rotation * pixel.push(lens.focal) / lens.focal;
    let aside = t_second_camera.translation.vector;
    let mut on_line: Vec<(u32, f64, f64)> = vec![];
    for f in 0..second.len() {
        let at = second.pixels[f] / second_lens.focal;
        let (miss, moves) = (far.xy() - at * far.z, aside.xy() - at * aside.z);
        let w = -miss.dot(&moves) / moves.norm_squared();
        let z = far.z + w * aside.z;
        let per_sigma = second_lens.focal / (z * sigma(second.octaves[f]));
        if z <= 1e-6 || (miss + w * moves).norm_squared() * per_sigma * per_sigma > CHI2 {
            continue;
        }
        // A far point is met a little beyond infinity as often as before it.
        let weight = moves.norm() * per_sigma;
        if w * weight >= -CHI2.sqrt() && w <= 1.0 / MIN_DEPTH_M {
            on_line.push((hamming(&second.descriptors[f], look), w, weight));
        }
    }
    let &(bits, w, weight) = on_line.iter().min_by_key(|(bits, ..)| *bits)?;
    // One corner is found on several levels: those are no rivals.
    let is_rival = |other: f64| (other - w).abs() * weight > 2.0 * CHI2.sqrt();
    let rival = on_line.iter().filter(|(_, other, _)| is_rival(*other)).map(|(bits, ..)| *bits).min();
    let is_clear = f64::from(bits) <= RATIO * rival.map_or(f64::INFINITY, f64::from);
    (bits <= NEAR_BITS && is_clear).then_some((w * point.z, weight / point.z))
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
