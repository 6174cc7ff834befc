//! The first two views: two images with enough parallax tell where points are, but for the scale.

use super::frame::{Frame, Lens, sigma};
use super::pose::CHI2;
use crate::tracking::Waiting;
use nalgebra::{Point2, Point3};
use percept_geometry::{Pose, Timestamp};
use percept_perception::features2d::{MatchParams, match_features};
use percept_perception::multiview::{RansacParams, TwoViewEstimate, TwoViewOutcome, estimate_two_view};

/// Fewer matches than this do not start a map. ORB-SLAM2's code has 100, of twice as many features. ATE of `evaluate
/// mono rgbd-7scenes-a` is 27.3 mm halved, doubled and as it is.
const MIN_MATCHES: usize = 80;
/// Fewer points than this do not either. As in ORB-SLAM2's code.
pub(super) const MIN_POINTS: usize = 50;
/// Pixels that half of the matches have to move before the two-view geometry is tried. Halved and doubled 25.1
/// ([`super`]).
const MIN_MOVED_PX: f64 = 8.0;
/// Parallax that a point needs, radians: 1 degree, as ORB-SLAM has it.
pub(super) const MIN_PARALLAX: f64 = 0.0175;
/// A plane needs more: its two solutions differ little from near by. Halved and doubled 25.1 ([`super`]).
const PLANE_PARALLAX: f64 = 0.06;
/// The reference image is replaced after so many images. Two seconds at 30 Hz.
const MAX_AGE: usize = 60;

/// The image that the second view is sought for.
#[derive(Debug, Clone)]
pub(super) struct Reference {
    pub(super) frame: Frame,
    pub(super) stamp: Timestamp,
    age: usize,
}

/// Two views and what both see.
#[derive(Debug, Clone)]
pub(super) struct TwoViews {
    pub(super) t_second_first: Pose,
    pub(super) points: Vec<Shared>,
}

/// What both views show: feature of the first, of the second, position in the first camera.
pub(super) type Shared = (u32, u32, Point3<f64>);

impl Reference {
    pub(super) fn new(frame: Frame, stamp: Timestamp) -> Self {
        Self { frame, stamp, age: 0 }
    }

    /// Tries an image as the second view. The reference that failed for good is replaced by the image.
    pub(super) fn pair_with(
        &mut self,
        frame: &Frame,
        stamp: Timestamp,
        lens: &Lens,
        ratio: f64,
    ) -> Result<TwoViews, Waiting> {
        self.age += 1;
        let params = MatchParams { ratio, mutual: true, max_distance: None };
        let matches = match_features(&self.frame.binary(), &frame.binary(), &params).unwrap_or_default();
        if matches.len() < MIN_MATCHES || self.age > MAX_AGE {
            *self = Self::new(frame.clone(), stamp);
            return Err(if matches.len() < MIN_MATCHES { Waiting::FewMatches } else { Waiting::NoParallax });
        }
        let pairs: Vec<(u32, u32)> = matches.iter().map(|m| (m.query_index, m.train_index)).collect();
        let mut moved: Vec<f64> =
            pairs.iter().map(|&(a, b)| (self.frame.pixels[a as usize] - frame.pixels[b as usize]).norm()).collect();
        moved.sort_by(f64::total_cmp);
        if moved[moved.len() / 2] < MIN_MOVED_PX {
            return Err(Waiting::NoParallax);
        }
        self.two_views(frame, &pairs, lens)
    }

    fn two_views(&self, frame: &Frame, pairs: &[(u32, u32)], lens: &Lens) -> Result<TwoViews, Waiting> {
        let a: Vec<Point2<f64>> = pairs.iter().map(|p| Point2::from(self.frame.pixels[p.0 as usize])).collect();
        let b: Vec<Point2<f64>> = pairs.iter().map(|p| Point2::from(frame.pixels[p.1 as usize])).collect();
        let k = lens.intrinsics();
        let params = RansacParams { threshold_px: 1.5, max_iterations: 500, ..RansacParams::default() };
        let found = estimate_two_view(&a, &b, &k, &k, &params).map_err(|_| Waiting::FewMatches)?;
        if found.outcome == TwoViewOutcome::LittleParallax {
            return Err(Waiting::NoParallax);
        }
        let points = self.triangulate(frame, pairs, &found, lens);
        let needed = if found.outcome == TwoViewOutcome::Planar { PLANE_PARALLAX } else { MIN_PARALLAX };
        let wide = points.iter().filter(|p| p.1 > needed).count();
        if wide < MIN_POINTS || wide * 2 < found.essential.inliers.len() {
            return Err(Waiting::NoParallax);
        }
        let points = points.into_iter().filter(|p| p.1 > 0.5 * MIN_PARALLAX).map(|p| p.0).collect();
        Ok(TwoViews { t_second_first: found.essential.t_b_a, points })
    }

    /// The inliers' points that lie in front and fit, with their parallax (radians).
    fn triangulate(
        &self,
        frame: &Frame,
        pairs: &[(u32, u32)],
        found: &TwoViewEstimate,
        lens: &Lens,
    ) -> Vec<(Shared, f64)> {
        let t = &found.essential.t_b_a;
        let one = |&i: &usize| {
            let (f, g) = pairs[i];
            let rays = (Ray::of(&self.frame, f, lens), Ray::of(frame, g, lens));
            let (p, parallax) = meet(t, &rays.0, &rays.1, lens.focal)?;
            Some(((f, g, p), parallax))
        };
        found.essential.inliers.iter().filter_map(one).collect()
    }
}

/// A feature as a ray of depth 1 and the standard deviation of its pixel.
#[derive(Debug, Clone, Copy)]
pub(super) struct Ray {
    pub(super) at: Point3<f64>,
    pub(super) sigma: f64,
}

impl Ray {
    pub(super) fn of(frame: &Frame, feature: u32, lens: &Lens) -> Self {
        let pixel = frame.pixels[feature as usize] / lens.focal;
        Self { at: Point3::new(pixel.x, pixel.y, 1.0), sigma: sigma(frame.octaves[feature as usize]) }
    }

    fn fits(&self, p: &Point3<f64>, focal: f64) -> bool {
        let e = (p.coords.xy() / p.z - self.at.coords.xy()) * focal;
        p.z > 0.0 && e.norm_squared() < CHI2 * self.sigma * self.sigma
    }
}

/// The point of two rays in the first camera and its parallax; none if it lies behind one or does not fit both.
///
/// The middle of the shortest line between the rays, moved once along the epipolar constraint's gradient.
pub(super) fn meet(t_second_first: &Pose, a: &Ray, b: &Ray, focal: f64) -> Option<(Point3<f64>, f64)> {
    // Sampson's correction: both pixels moved by the least so that (nearly) the rays meet.
    let r = t_second_first.rotation.to_rotation_matrix();
    let e = t_second_first.translation.vector.cross_matrix() * r.matrix();
    let (l, lt) = (e * a.at.coords, e.tr_mul(&b.at.coords));
    let (wa, wb) = (a.sigma * a.sigma, b.sigma * b.sigma);
    let scale = b.at.coords.dot(&l) / (wb * l.xy().norm_squared() + wa * lt.xy().norm_squared());
    if !scale.is_finite() {
        return None;
    }
    let (mut ra, mut rb) = (a.at.coords, b.at.coords);
    ra.x -= scale * wa * lt.x;
    ra.y -= scale * wa * lt.y;
    rb.x -= scale * wb * l.x;
    rb.y -= scale * wb * l.y;
    // Depths d_a r ra + t = d_b rb in the least-squares sense.
    let (ra2, t) = (r * ra, t_second_first.translation.vector);
    let (aa, ab, bb) = (ra2.norm_squared(), ra2.dot(&rb), rb.norm_squared());
    let det = aa * bb - ab * ab;
    if det < 1e-12 * aa * bb {
        return None;
    }
    let depth = (ab * rb.dot(&t) - bb * ra2.dot(&t)) / det;
    let p = Point3::from(ra * depth);
    let q = t_second_first * p;
    (a.fits(&p, focal) && b.fits(&q, focal)).then(|| (p, ra2.angle(&rb)))
}
