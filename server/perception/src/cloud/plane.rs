//! The largest plane of a cloud.

use super::local::{Hypothesis, Local, Moments};
use super::{at_least, positive};
use nalgebra::{Point3, Unit, Vector3};
use percept_geometry::{GeometryError, Plane};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

/// Hypotheses drawn between two looks at whether to stop, and if there is no looking.
const BATCH: usize = 32;
const LARGE_BATCH: usize = 1024;
/// Points on which hypotheses are judged before those that may still win are counted on all.
const SAMPLES: [usize; 2] = [4096, 32768];
/// Deviations of a sampled share that a hypothesis is given the benefit of: dropping the best has a chance below 1e-4.
const DOUBT: f64 = 4.0;
/// Fits on the way to rest at most, and the root mean square step, as a share of the distance, that counts as rest.
const MAX_FITS: usize = 20;
const AT_REST: f64 = 2e-3;
/// Chance of having drawn a triple of inliers at which the search ends.
const CONFIDENCE: f64 = 0.999;

/// How [`segment_plane`] searches.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PlaneParams {
    /// Points at most this far from the plane belong to it, metres; two to three deviations of the noise.
    pub distance_m: f64,
    /// Most triples drawn; fewer when a large plane has been found.
    pub max_iterations: usize,
    /// A plane has at least so many points; at least 3.
    pub min_points: usize,
    /// Seed of the draws.
    pub seed: u64,
    /// Whether to stop drawing when a better plane has become improbable; without, all triples are drawn.
    pub early_stop: bool,
}

impl Default for PlaneParams {
    fn default() -> Self {
        Self { distance_m: 0.02, max_iterations: 1000, min_points: 3, seed: 0, early_stop: true }
    }
}

impl PlaneParams {
    /// Checks the bounds.
    ///
    /// # Errors
    /// `OutOfRange` naming the field.
    pub fn validate(&self) -> Result<(), GeometryError> {
        positive("distance_m", self.distance_m)?;
        at_least("max_iterations", self.max_iterations, 1, "at least 1")?;
        at_least("min_points", self.min_points, 3, "at least 3")
    }
}

/// A plane and the points on it.
#[derive(Debug, Clone, PartialEq)]
pub struct PlaneSegment {
    /// The plane; its normal's largest component is positive.
    pub plane: Plane,
    /// Indices of the points within the distance, ascending.
    pub inliers: Vec<usize>,
    /// Root mean square of their distances, metres.
    pub rms_m: f64,
}

/// The plane with the most points, refined to rest: it is the least squares fit of the points within the distance of
/// it. None if no three points span one that has `min_points`.
///
/// Source: Fischler and Bolles, "Random sample consensus", 1981, with their stopping rule. Hypotheses race: all are
/// counted on a stratified random sample, those whose share is within its error of the best on a larger one, and what
/// is left on all points (after Matas and Chum, "Randomized RANSAC with T(d,d) test", 2004, but with both sides of the
/// error, so that the winner is the one that counting everything would find).
///
/// # Errors
/// `OutOfRange` naming the parameter.
pub fn segment_plane(points: &[Point3<f32>], params: &PlaneParams) -> Result<Option<PlaneSegment>, GeometryError> {
    params.validate()?;
    let local = Local::new(points, 0..points.len() as u32);
    Ok(local.and_then(|local| local.find_plane(params, &|_| true)).map(|found| found.0))
}

/// As [`segment_plane`] among `candidates` only, for planes whose normal is `allowed` (either sign comes).
pub(crate) fn segment_among(
    points: &[Point3<f32>],
    candidates: &[u32],
    params: &PlaneParams,
    allowed: impl Fn(&Vector3<f64>) -> bool,
) -> Option<PlaneSegment> {
    Local::new(points, candidates.iter().copied())?.find_plane(params, &allowed).map(|found| found.0)
}

impl Local {
    /// The plane, and the places of its points.
    pub(super) fn find_plane(
        &self,
        params: &PlaneParams,
        allowed: &impl Fn(&Vector3<f64>) -> bool,
    ) -> Option<(PlaneSegment, Vec<u32>)> {
        let n = self.len();
        if n < params.min_points {
            return None;
        }
        let mut rng = ChaCha8Rng::seed_from_u64(params.seed);
        let samples: Vec<Self> =
            SAMPLES.iter().filter(|&&m| 2 * m < n).map(|&m| self.stratified(m, &mut rng)).collect();
        let rough = self.search(&samples, &mut rng, params, allowed)?;
        self.refine(rough, samples.last(), params, allowed)
    }

    fn search(
        &self,
        samples: &[Self],
        rng: &mut ChaCha8Rng,
        params: &PlaneParams,
        allowed: &impl Fn(&Vector3<f64>) -> bool,
    ) -> Option<Hypothesis> {
        let n = self.len();
        let batch = if params.early_stop { BATCH } else { LARGE_BATCH };
        let mut best: Option<(usize, Hypothesis)> = None;
        let (mut drawn, mut needed) = (0, params.max_iterations);
        while drawn < needed {
            let size = batch.min(needed - drawn);
            drawn += size;
            let triples = (0..size).map(|_| std::array::from_fn(|_| rng.random_range(0..n)));
            let hypotheses: Vec<Hypothesis> =
                triples.filter_map(|triple| self.through(&triple)).filter(|h| allowed(&h.normal)).collect();
            let found = self.race(samples, hypotheses, best, params.distance_m);
            if params.early_stop
                && let Some((count, _)) = found
            {
                needed = iterations_for(count as f64 / n as f64).min(params.max_iterations);
            }
            best = found;
        }
        best.map(|(_, hypothesis)| hypothesis)
    }

    /// The best of a batch and of those before, with its count on all points.
    fn race(
        &self,
        samples: &[Self],
        mut hypotheses: Vec<Hypothesis>,
        mut best: Option<(usize, Hypothesis)>,
        distance: f64,
    ) -> Option<(usize, Hypothesis)> {
        for sample in samples {
            let m = sample.len() as f64;
            let shares: Vec<f64> = sample.counts(&hypotheses, distance).iter().map(|&c| c as f64 / m).collect();
            let doubt = |share: f64| DOUBT * (share * (1.0 - share) / m).sqrt() + 1.0 / m;
            let known = best.as_ref().map_or(0.0, |b| b.0 as f64 / self.len() as f64);
            let sure = shares.iter().map(|&s| s - doubt(s)).fold(known, f64::max);
            let mut shares = shares.iter();
            hypotheses.retain(|_| shares.next().is_some_and(|&s| s + doubt(s) >= sure));
        }
        let counts = self.counts(&hypotheses, distance);
        for (count, hypothesis) in counts.into_iter().zip(hypotheses) {
            if best.is_none_or(|(most, _)| count > most) {
                best = Some((count, hypothesis));
            }
        }
        best
    }

    /// One point drawn from each of `m` equal stretches: no more variance than independent draws.
    fn stratified(&self, m: usize, rng: &mut ChaCha8Rng) -> Self {
        let n = self.len();
        let places: Vec<usize> = (0..m).map(|i| rng.random_range(i * n / m..(i + 1) * n / m)).collect();
        self.sample(&places)
    }

    fn through(&self, &[a, b, c]: &[usize; 3]) -> Option<Hypothesis> {
        let (a, ab, ac) = (self.at(a), self.at(b) - self.at(a), self.at(c) - self.at(a));
        let normal = ab.cross(&ac);
        // Nearly on a line (2 arc minutes): the plane would be an accident of rounding.
        if normal.norm() <= 6e-4 * ab.norm() * ac.norm() || normal.norm() == 0.0 {
            return None;
        }
        let normal = normal.normalize();
        Some(Hypothesis { normal, offset: -normal.dot(&a) })
    }

    /// The fixed point of 'least squares on the points within the distance', found on a sample and then on all points.
    fn refine(
        &self,
        rough: Hypothesis,
        sample: Option<&Self>,
        params: &PlaneParams,
        allowed: &impl Fn(&Vector3<f64>) -> bool,
    ) -> Option<(PlaneSegment, Vec<u32>)> {
        let start = sample.map_or(rough, |sample| sample.settle(rough, params.distance_m, allowed).0);
        let mut found = self.settle(start, params.distance_m, allowed);
        if found.1.num_points() < params.min_points {
            // Few points: the sample may have lost them, and so may a fit.
            found = (rough, self.moments(&rough, params.distance_m));
        }
        let (h, moments) = found;
        if moments.num_points() < params.min_points {
            return None;
        }
        let sign = if h.normal[h.normal.iamax()] < 0.0 { -1.0 } else { 1.0 };
        let offset = h.offset - h.normal.dot(&self.anchor.coords);
        let places = self.within(&h, params.distance_m);
        let segment = PlaneSegment {
            plane: Plane { normal: Unit::new_normalize(h.normal * sign), offset: offset * sign },
            rms_m: moments.mean_square(&h).sqrt(),
            inliers: self.indices(&places),
        };
        Some((segment, places))
    }

    /// Fits and gathers in turn until the plane rests. Each step lowers the sum of squared distances, cut off at
    /// `distance`, so that the end depends little on the start, other than the plane of the most points.
    fn settle(
        &self,
        start: Hypothesis,
        distance: f64,
        allowed: &impl Fn(&Vector3<f64>) -> bool,
    ) -> (Hypothesis, Moments) {
        let mut now = (start, self.moments(&start, distance));
        for _ in 0..MAX_FITS {
            let Some(mut fitted) = now.1.fit().filter(|h| allowed(&h.normal)) else { break };
            if fitted.normal.dot(&now.0.normal) < 0.0 {
                fitted = Hypothesis { normal: -fitted.normal, offset: -fitted.offset };
            }
            // How far the plane moved where its points are.
            let moved = now.1.deviation(&now.0, &fitted);
            now = (fitted, self.moments(&fitted, distance));
            if moved < AT_REST * distance {
                break;
            }
        }
        now
    }
}

/// Draws after which a triple of inliers has come with [`CONFIDENCE`], given their share.
fn iterations_for(share: f64) -> usize {
    let miss = 1.0 - share.powi(3);
    if miss <= 0.0 { 1 } else { ((1.0 - CONFIDENCE).ln() / miss.ln()).ceil().min(1e9) as usize }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn noisy_plane(n: usize, outliers: usize, origin: Vector3<f64>) -> Vec<Point3<f32>> {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let mut draw = || rng.random_range(-1.0..1.0f64);
        let on = |x: f64, y: f64, e: f64| Vector3::new(x, y, 0.5 * x - 0.2 * y + e);
        let mut points: Vec<_> = (0..n).map(|_| on(2.0 * draw(), 2.0 * draw(), 0.01 * draw())).collect();
        points.extend((0..outliers).map(|_| Vector3::new(draw(), draw(), draw()) * 2.0));
        points.into_iter().map(|p| Point3::from((p + origin).cast::<f32>())).collect()
    }

    #[test]
    fn a_plane_is_found_among_as_many_outliers() {
        let points = noisy_plane(3000, 3000, Vector3::zeros());
        let found = segment_plane(&points, &PlaneParams::default()).unwrap().unwrap();
        let truth = Vector3::new(-0.5, 0.2, 1.0).normalize();
        assert!(found.plane.normal.dot(&truth) > 0.99999, "{:?}", found.plane);
        assert!(found.plane.offset.abs() < 0.001);
        assert!(found.inliers.iter().filter(|i| **i < 3000).count() == 3000);
        assert!(found.inliers.len() < 3000 + 150);
        // Uniform noise of +-1 cm along z, seen across the slanted plane: 5.1 mm.
        assert!((found.rms_m - 0.0051).abs() < 0.001, "{}", found.rms_m);
    }

    #[test]
    fn the_same_seed_gives_the_same_plane_on_any_number_of_threads() {
        let points = noisy_plane(2000, 4000, Vector3::zeros());
        let on = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| segment_plane(&points, &PlaneParams::default()).unwrap())
        };
        assert_eq!(on(1), on(3));
    }

    #[test]
    fn drawing_all_triples_finds_no_smaller_plane() {
        let points = noisy_plane(4000, 16_000, Vector3::zeros());
        let with = |early_stop| {
            segment_plane(&points, &PlaneParams { early_stop, ..PlaneParams::default() }).unwrap().unwrap()
        };
        let (early, all) = (with(true), with(false));
        assert!(all.inliers.len() + 20 >= early.inliers.len());
        assert!(all.plane.normal.angle(&early.plane.normal) < 2e-3);
        let near = |p: &Point3<f32>| all.plane.distance(&p.cast()).abs() <= 0.02;
        assert!((points.iter().filter(|p| near(p)).count()).abs_diff(all.inliers.len()) <= 1);
    }

    #[test]
    fn a_plane_far_away_is_found_with_the_digits_f32_leaves() {
        // At 1e5 m f32 steps are 8 mm.
        let points = noisy_plane(2000, 200, Vector3::new(1e5, -1e5, 0.0));
        let found = segment_plane(&points, &PlaneParams::default()).unwrap().unwrap();
        assert!(found.inliers.iter().filter(|i| **i < 2000).count() > 1990);
    }

    #[test]
    fn clouds_without_a_plane_have_none() {
        let none = |points: &[Point3<f32>]| segment_plane(points, &PlaneParams::default()).unwrap().is_none();
        assert!(none(&[]));
        assert!(none(&[Point3::origin(), Point3::new(1.0, 0.0, 0.0)]));
        assert!(none(&[Point3::new(1e7, 1.0, 2.0); 100]));
        assert!(none(&(0..100).map(|i| Point3::new(i as f32, 2.0 * i as f32, 0.0)).collect::<Vec<_>>()));
        assert!(none(&[Point3::from([f32::NAN; 3]); 10]));
        let triangle = [Point3::origin(), Point3::new(1.0, 0.0, 0.0), Point3::new(0.0, 1.0, 0.0)];
        assert_eq!(segment_plane(&triangle, &PlaneParams::default()).unwrap().unwrap().inliers, [0, 1, 2]);
    }
}
