//! The largest plane of a cloud.

use super::{Scatter, at_least, positive, symmetric_eigen3};
use nalgebra::{Point3, Unit, Vector3};
use percept_geometry::{GeometryError, Plane, cloud::is_finite};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Hypotheses drawn between two looks at whether to stop.
const BATCH: usize = 32;
/// Hypotheses are judged on at most about so many points, evenly picked; the winner on all.
const JUDGED: usize = 20_000;
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
}

impl Default for PlaneParams {
    fn default() -> Self {
        Self { distance_m: 0.02, max_iterations: 1000, min_points: 3, seed: 0 }
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

/// The plane with the most points, refined by least squares on them; none if no three points span one that
/// has `min_points`.
///
/// Source: Fischler and Bolles, "Random sample consensus", 1981, with their stopping rule.
///
/// # Errors
/// `OutOfRange` naming the parameter.
pub fn segment_plane(points: &[Point3<f32>], params: &PlaneParams) -> Result<Option<PlaneSegment>, GeometryError> {
    params.validate()?;
    let all: Vec<u32> = (0..points.len() as u32).collect();
    Ok(segment_among(points, &all, params, |_| true))
}

/// As [`segment_plane`] among `candidates` only, for planes whose normal is `allowed` (either sign comes).
pub(crate) fn segment_among(
    points: &[Point3<f32>],
    candidates: &[u32],
    params: &PlaneParams,
    allowed: impl Fn(&Vector3<f64>) -> bool + Sync,
) -> Option<PlaneSegment> {
    let finite: Vec<u32> = candidates.iter().copied().filter(|&i| is_finite(&points[i as usize])).collect();
    let anchor: Point3<f64> = points[*finite.first()? as usize].cast();
    let local = Local::new(points, &finite, anchor);
    let rough = local.search(params, &allowed)?;
    local.refine(rough, &finite, params, &allowed)
}

/// Coordinates about an anchor, as f32 side by side: far from the origin they keep their digits.
struct Local {
    anchor: Point3<f64>,
    xs: Vec<f32>,
    ys: Vec<f32>,
    zs: Vec<f32>,
}

/// `normal . p + offset`, about the anchor.
#[derive(Clone, Copy)]
struct Hypothesis {
    normal: Vector3<f64>,
    offset: f64,
}

impl Local {
    fn new(points: &[Point3<f32>], finite: &[u32], anchor: Point3<f64>) -> Self {
        let axis = |a: usize| finite.iter().map(|&i| (f64::from(points[i as usize][a]) - anchor[a]) as f32).collect();
        Self { anchor, xs: axis(0), ys: axis(1), zs: axis(2) }
    }

    fn len(&self) -> usize {
        self.xs.len()
    }

    fn at(&self, i: usize) -> Vector3<f64> {
        Vector3::new(self.xs[i], self.ys[i], self.zs[i]).cast()
    }

    fn search(&self, params: &PlaneParams, allowed: &(impl Fn(&Vector3<f64>) -> bool + Sync)) -> Option<Hypothesis> {
        let n = self.len();
        if n < params.min_points {
            return None;
        }
        let mut rng = ChaCha8Rng::seed_from_u64(params.seed);
        let judged = self.thinned(n.div_ceil(JUDGED));
        let mut best: Option<(usize, Hypothesis)> = None;
        let (mut drawn, mut needed) = (0, params.max_iterations);
        while drawn < needed {
            let batch: Vec<[usize; 3]> =
                (0..BATCH.min(needed - drawn)).map(|_| std::array::from_fn(|_| rng.random_range(0..n))).collect();
            drawn += batch.len();
            let counts: Vec<Option<(usize, Hypothesis)>> = batch
                .par_iter()
                .map(|triple| {
                    let hypothesis = self.through(triple).filter(|h| allowed(&h.normal))?;
                    Some((judged.count(&hypothesis, params.distance_m as f32), hypothesis))
                })
                .collect();
            for (count, hypothesis) in counts.into_iter().flatten() {
                if best.is_none_or(|(most, _)| count > most) {
                    best = Some((count, hypothesis));
                    let share = count as f64 / judged.len() as f64;
                    needed = iterations_for(share).min(params.max_iterations);
                }
            }
        }
        best.map(|(_, hypothesis)| hypothesis)
    }

    fn thinned(&self, stride: usize) -> Self {
        let pick = |v: &[f32]| v.iter().step_by(stride).copied().collect();
        Self { anchor: self.anchor, xs: pick(&self.xs), ys: pick(&self.ys), zs: pick(&self.zs) }
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

    fn count(&self, h: &Hypothesis, distance: f32) -> usize {
        let (n, o) = (h.normal.cast::<f32>(), h.offset as f32);
        let mut count = 0u32;
        for ((x, y), z) in self.xs.iter().zip(&self.ys).zip(&self.zs) {
            count += u32::from((n.x * x + n.y * y + n.z * z + o).abs() <= distance);
        }
        count as usize
    }

    fn inliers(&self, h: &Hypothesis, distance: f64) -> Vec<u32> {
        (0..self.len() as u32).filter(|&i| (h.normal.dot(&self.at(i as usize)) + h.offset).abs() <= distance).collect()
    }

    /// Least squares on the inliers, then inliers of that plane, until they do not grow any more.
    fn refine(
        &self,
        rough: Hypothesis,
        finite: &[u32],
        params: &PlaneParams,
        allowed: &impl Fn(&Vector3<f64>) -> bool,
    ) -> Option<PlaneSegment> {
        let mut best = (rough, self.inliers(&rough, params.distance_m));
        for _ in 0..5 {
            let Some(fitted) = self.fit(&best.1).filter(|h| allowed(&h.normal)) else { break };
            let inliers = self.inliers(&fitted, params.distance_m);
            // A fit of the same points is still the better plane; fewer points are not.
            let grew = inliers.len() > best.1.len();
            if inliers.len() >= best.1.len() {
                best = (fitted, inliers);
            }
            if !grew {
                break;
            }
        }
        let (h, inliers) = best;
        if inliers.len() < params.min_points {
            return None;
        }
        let squares: f64 = inliers.iter().map(|&i| (h.normal.dot(&self.at(i as usize)) + h.offset).powi(2)).sum();
        let sign = if h.normal[h.normal.iamax()] < 0.0 { -1.0 } else { 1.0 };
        let offset = h.offset - h.normal.dot(&self.anchor.coords);
        Some(PlaneSegment {
            plane: Plane { normal: Unit::new_normalize(h.normal * sign), offset: offset * sign },
            rms_m: (squares / inliers.len() as f64).sqrt(),
            inliers: inliers.into_iter().map(|i| finite[i as usize] as usize).collect(),
        })
    }

    fn fit(&self, inliers: &[u32]) -> Option<Hypothesis> {
        let mut scatter = Scatter::new(Point3::from(self.at(*inliers.first()? as usize)));
        inliers.iter().for_each(|&i| scatter.add(&Point3::from(self.at(i as usize))));
        let eigen = symmetric_eigen3(&scatter.covariance());
        let normal = eigen.vectors[0];
        (eigen.values[1] > 1e-10 * eigen.values[2])
            .then(|| Hypothesis { normal, offset: -normal.dot(&scatter.mean().coords) })
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
