//! What a keyframe keeps of a depth image: a point of each block of pixels, whose depth is what all of the block say.

use super::KeyframeParams;
use crate::scan::DepthScan;
use nalgebra::Point3;
use percept_geometry::{DepthImage, PointCloud};

/// Columns of a depth image that [`KeyframeParams::depth_stride_px`] is meant for.
pub(crate) const FULL_WIDTH: usize = 640;
/// Pixels on both sides of one say as much of a surface as that one if their mean differs from it by less, in inverse metres. Noise of
/// structured light and of stereo is one of disparity: it is the same there at any depth, 0.0019 and more for a Kinect (Nguyen, Izadi
/// and Lovell, "Modeling Kinect sensor noise", 2012). Three standard deviations of that difference.
const ALIKE: f32 = 3.0 * 1.225 * 0.002;
/// So much of a block belongs to the surface, or it lies at an edge: then the pixel stays what it is.
const LEAST_SHARE: f32 = 0.4;
/// Of the pixels around one that lies between what is nearer and what is farther, so many are like it, or it is on neither: the sensor
/// has mixed both. A wire has as few, and nothing nearer beside it. Of both sides there has to be half a row: at edges many pixels
/// have no return.
const ITS_OWN_SHARE: f32 = 0.35;
/// Two pixels on both sides of one that are farther from it than so many times [`ALIKE`] are a steep surface if those twice as far away
/// go on as steeply, by half at least, and an edge otherwise, in whose middle the sensor has mixed both sides.
const STEEP: f32 = 3.0;

/// Rows and columns from one point that is kept to the next, of an image so many columns wide.
fn stride(params: &KeyframeParams, width: usize) -> usize {
    (params.depth_stride_px * width.min(FULL_WIDTH)).div_ceil(FULL_WIDTH).max(1)
}

/// The points that are kept, base frame, with the colour of their pixel.
pub(super) fn depth_hits(params: &KeyframeParams, s: &DepthScan) -> PointCloud {
    let (width, height) = (s.depth.width(), s.depth.height());
    let color = s.color.as_ref().filter(|c| c.width() == width && c.height() == height);
    let stride = stride(params, width);
    let mut hits = PointCloud::default();
    let mut colors = vec![];
    for v in (stride / 2..height).step_by(stride) {
        for u in (stride / 2..width).step_by(stride) {
            let z = f64::from(smoothed(&s.depth, (u, v), stride / 2));
            if z > 0.0 && z <= params.max_depth_m {
                let p = s.intrinsics.ray(u as f64, v as f64).coords * z;
                hits.positions.push((s.t_base_sensor * Point3::from(p)).cast());
                colors.extend(color.map(|c| c.at(u, v)));
            }
        }
    }
    hits.colors = color.map(|_| colors);
    hits
}

/// Depth of the surface at a pixel, metres, by the square of pixels around that reaches so many to each side; 0 without a return, and
/// of a pixel that lies on no surface ([`is_mixed`]).
///
/// The inverse depth of a plane is linear in the image: so the mean of two pixels that lie opposite to each other is that of the pixel
/// between them, however the plane is inclined. Pairs that lie on something else, or on both sides of an edge, do not count.
fn smoothed(depth: &DepthImage, (u, v): (usize, usize), reach: usize) -> f32 {
    let z = depth.at(u, v);
    // Images of which every pixel is kept have a surface around each as well.
    let around = reach.max(1);
    if z <= 0.0 || u < around || v < around || u + around >= depth.width() || v + around >= depth.height() {
        return z;
    }
    let (mut sum, mut num) = (1.0 / z, 1.0f32);
    let side = 2 * reach + 1;
    for offset in offsets(reach) {
        if let Some(mean) = between(depth, (u, v), offset) {
            (sum, num) = (sum + 2.0 * mean, num + 2.0);
        }
    }
    if reach > 0 && num >= LEAST_SHARE * (side * side) as f32 {
        num / sum
    } else if is_mixed(depth, (u, v), around) {
        0.0
    } else {
        z
    }
}

/// Half of the square of pixels around one: those before it, row by row.
fn offsets(reach: usize) -> impl Iterator<Item = (isize, isize)> {
    let (reach, side) = (reach as isize, 2 * reach as isize + 1);
    (0..side * side / 2).map(move |k| (k % side - reach, k / side - reach))
}

/// Inverse depth, offset by so many pixels; infinite without a return.
fn inverse(depth: &DepthImage, (u, v): (usize, usize), (x, y): (isize, isize)) -> Option<f32> {
    let at = u.checked_add_signed(x).zip(v.checked_add_signed(y));
    let (x, y) = at.filter(|(u, v)| *u < depth.width() && *v < depth.height())?;
    Some(1.0 / depth.at(x, y))
}

/// The mean of two pixels that lie opposite to each other, if they say as much of a surface as the pixel between them.
fn between(depth: &DepthImage, at: (usize, usize), (x, y): (isize, isize)) -> Option<f32> {
    let here = inverse(depth, at, (0, 0))?;
    let (a, b) = (inverse(depth, at, (x, y))?, inverse(depth, at, (-x, -y))?);
    let mean = 0.5 * (a + b);
    // Whether what is off at one of them goes on to be so twice as far away.
    let goes_on = |(x, y): (isize, isize), off: f32| {
        let twice = inverse(depth, at, (2 * x, 2 * y)).map_or(f32::NAN, |far| (far - here) / off);
        (1.5..2.5).contains(&twice)
    };
    let is_alike = (mean - here).abs() < ALIKE;
    let is_flat = (a - here).abs() <= STEEP * ALIKE;
    (is_alike && (is_flat || goes_on((x, y), a - here) || goes_on((-x, -y), b - here))).then_some(mean)
}

/// Whether a pixel at an edge floats between what stands before and what is behind it: of one that has a return, in an image that reaches
/// so far around it.
fn is_mixed(depth: &DepthImage, at: (usize, usize), reach: usize) -> bool {
    let side = 2 * reach + 1;
    let (mut alike, mut nearer, mut farther) = (1, 0, 0);
    for (x, y) in offsets(reach) {
        if between(depth, at, (x, y)).is_some() {
            alike += 2;
            continue;
        }
        for offset in [(x, y), (-x, -y)] {
            let off = |there: f32| there - 1.0 / depth.at(at.0, at.1);
            let Some(off) = inverse(depth, at, offset).filter(|there| there.is_finite()).map(off) else { continue };
            alike += usize::from(off.abs() < ALIKE);
            nearer += usize::from(off >= ALIKE);
            farther += usize::from(off <= -ALIKE);
        }
    }
    (alike as f32) < ITS_OWN_SHARE * (side * side) as f32 && 2 * nearer >= side && 2 * farther >= side
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(of: impl Fn(usize, usize) -> f32) -> DepthImage {
        DepthImage::new(20, 20, (0..400).map(|i| of(i % 20, i / 20)).collect()).unwrap()
    }

    /// Noise of unit variance, uniform.
    fn noise(i: usize) -> f32 {
        let spread = ((i as u32).wrapping_mul(2_654_435_761) ^ 0x5bd1_e995).wrapping_mul(2_246_822_519) >> 8;
        (spread as f32 / (1u32 << 24) as f32 - 0.5) * 12f32.sqrt()
    }

    #[test]
    fn small_images_are_thinned_less_and_none_more_than_asked_for() {
        let params = KeyframeParams::default();
        let kept = [80, 160, 240, 320, 424, 640, 848, 1280].map(|width| width / stride(&params, width));
        assert_eq!(kept, [80, 160, 120, 160, 141, 160, 212, 320]);
        let coarse = KeyframeParams { depth_stride_px: 16, ..params.clone() };
        let all = KeyframeParams { depth_stride_px: 1, ..params };
        assert_eq!([160, 320, 640, 1280].map(|width| stride(&coarse, width)), [4, 8, 16, 16]);
        assert_eq!([1, 160, 640].map(|width| stride(&all, width)), [1; 3]);
    }

    #[test]
    fn an_inclined_plane_keeps_its_depth_and_loses_its_noise() {
        let plane = |u: usize, v: usize| 0.25 + 0.002 * (u as f32 - 10.0) - 0.001 * (v as f32 - 10.0);
        let exact = image(|u, v| 1.0 / plane(u, v));
        assert!((smoothed(&exact, (10, 10), 2) - 4.0).abs() < 1e-4);
        let noisy = image(|u, v| 1.0 / (plane(u, v) + 0.002 * noise(20 * v + u)));
        let at = |u: usize, v: usize| (smoothed(&noisy, (u, v), 2), noisy.at(u, v), 1.0 / plane(u, v));
        let places: Vec<_> = (3..17).flat_map(|v| (3..17).map(move |u| (u, v))).map(|(u, v)| at(u, v)).collect();
        let rms = |off: &dyn Fn(&(f32, f32, f32)) -> f32| {
            (places.iter().map(|p| off(p) * off(p)).sum::<f32>() / places.len() as f32).sqrt()
        };
        let (smooth, raw) = (rms(&|p| p.0 - p.2), rms(&|p| p.1 - p.2));
        // 25 pixels instead of one: a fifth.
        assert!(raw > 0.025 && smooth < 0.3 * raw, "{smooth} {raw}");
    }

    #[test]
    fn edges_stay_where_they_are_and_what_is_not_there_does_not_come() {
        let step = image(|u, _| if u < 10 { 1.5 } else { 3.0 });
        for u in 3..17 {
            let wanted = if u < 10 { 1.5 } else { 3.0 };
            assert!((smoothed(&step, (u, 10), 2) - wanted).abs() < 1e-6, "{u}");
        }
        // A wire before a wall, and a hole in it.
        let wire = image(|u, v| {
            if u == 10 {
                2.0
            } else if v == 5 {
                0.0
            } else {
                3.0
            }
        });
        assert_eq!((smoothed(&wire, (10, 10), 2), smoothed(&wire, (7, 5), 2)), (2.0, 0.0));
        assert!((smoothed(&wire, (7, 6), 2) - 3.0).abs() < 1e-6);
        // What a sensor mixes of both sides of an edge, column by column or here and there, is on neither.
        let mixed = image(|u, v| match u {
            0..10 => 1.5,
            10 => 2.2 + 0.05 * noise(v),
            _ => 3.0,
        });
        assert!((5..15).all(|v| smoothed(&mixed, (10, v), 2) == 0.0));
        let here_and_there = image(|u, v| match u {
            0..10 => 1.5,
            10 if v % 3 == 1 => 2.2,
            _ => 3.0,
        });
        assert!((5..15).all(|v| (smoothed(&here_and_there, (10, v), 0) == 0.0) == (v % 3 == 1)));
        assert!((5..15).all(|v| smoothed(&mixed, (9, v), 2) == 1.5 && smoothed(&mixed, (11, v), 2) == 3.0));
        // A sensor that mixes both sides by halves, and loses every third pixel there; and a floor that is seen as flat as that is steep.
        let lossy = image(|u, v| match u {
            0..10 => 1.5,
            10 => 2.0,
            11 if v % 3 == 0 => 0.0,
            _ => 3.0,
        });
        assert!((5..15).all(|v| smoothed(&lossy, (10, v), 1) == 0.0 && smoothed(&lossy, (10, v), 2) == 0.0));
        let floor = image(|_, v| 1.0 / (0.1 + 0.03 * v as f32));
        assert!((5..15).all(|v| (smoothed(&floor, (10, v), 1) - floor.at(10, v)).abs() < 1e-4));
        assert!((5..15).all(|v| smoothed(&floor, (10, v), 0) == floor.at(10, v)), "of few pixels, too");
        // At the rim of the image.
        assert_eq!(smoothed(&wire, (1, 10), 2), 3.0);
    }
}
