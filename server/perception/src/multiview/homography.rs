//! The map between two images of one plane, or of any scene from one place.

use super::essential::Pair;
use super::ransac::{Problem, search};
use super::{MultiviewError, RansacParams, finite, same_length};
use nalgebra::{Matrix3, Point2, SMatrix, SVector, Vector2};

/// A plane-to-plane map.
#[derive(Debug, Clone, PartialEq)]
pub struct HomographyEstimate {
    /// `b ~ H a` for homogeneous points, with the last entry 1 where that is possible, else norm 1.
    pub homography: Matrix3<f64>,
    /// Correspondences that fit, ascending.
    pub inliers: Vec<usize>,
    /// Root mean square of the inliers' transfer error (the mean over both images), pixels.
    pub rmse_px: f64,
    /// Samples that were drawn.
    pub iterations: usize,
}

/// Estimates the homography from pixels `a[i]` to `b[i]`: four-point samples, scored by the symmetric transfer error,
/// refined on their inliers by a normalised linear fit and Gauss-Newton. Pixels are taken as they are: undistort first.
///
/// Source: Hartley and Zisserman, "Multiple view geometry", 2004, chapter 4.
///
/// # Errors
/// `Input` for parameters or lengths; `TooFew` below five finite pairs; `NoModel` if nothing fits five.
pub fn estimate_homography(
    a: &[Point2<f64>],
    b: &[Point2<f64>],
    params: &RansacParams,
) -> Result<HomographyEstimate, MultiviewError> {
    params.validate()?;
    same_length("points_b", a.len(), b.len())?;
    let usable: Vec<usize> = (0..a.len()).filter(|&i| finite(&a[i]) && finite(&b[i])).collect();
    let pairs: Vec<Pair> = usable.iter().map(|&i| (a[i].coords, b[i].coords)).collect();
    if pairs.len() < MIN_INLIERS {
        return Err(MultiviewError::TooFew { got: pairs.len(), needed: MIN_INLIERS });
    }
    let nothing = MultiviewError::NoModel { got: pairs.len(), needed: MIN_INLIERS };
    let problem = PlaneToPlane::new(&pairs, params.threshold_px);
    let found = search(&problem, params).ok_or_else(|| nothing.clone())?;
    if found.inliers.len() < MIN_INLIERS {
        return Err(nothing);
    }
    let squares: f64 = found.inliers.iter().map(|&i| problem.error2(&found.model, i)).sum();
    let h = found.model.h;
    Ok(HomographyEstimate {
        homography: if h[(2, 2)].abs() > 1e-12 * h.norm() { h / h[(2, 2)] } else { h / h.norm() },
        rmse_px: (squares / found.inliers.len() as f64).sqrt() * params.threshold_px,
        inliers: found.inliers.iter().map(|&i| usable[i]).collect(),
        iterations: found.iterations,
    })
}

/// Four give the model; a fifth has to agree.
const MIN_INLIERS: usize = 5;

/// A map and its inverse.
#[derive(Debug, Clone)]
pub(super) struct Both {
    pub(super) h: Matrix3<f64>,
    inverse: Matrix3<f64>,
}

pub(super) struct PlaneToPlane<'a> {
    pairs: &'a [Pair],
    inverse2: f64,
}

impl<'a> PlaneToPlane<'a> {
    pub(super) fn new(pairs: &'a [Pair], threshold: f64) -> Self {
        Self { pairs, inverse2: 1.0 / (threshold * threshold) }
    }
}

impl Problem for PlaneToPlane<'_> {
    type Model = Both;
    const SAMPLE: usize = 4;

    fn len(&self) -> usize {
        self.pairs.len()
    }

    fn solve(&self, sample: &[usize], out: &mut Vec<Both>) {
        let pairs: Vec<Pair> = sample.iter().map(|&i| self.pairs[i]).collect();
        // Three points in a line, or a mirrored quadrilateral, are no view of a plane.
        let turn = |p: &[Vector2<f64>; 4], i: usize| {
            let [a, b, c] = [0, 1, 2].map(|k| p[(i + k) % 4]);
            (b - a).perp(&(c - b))
        };
        let (from, to) = ([0, 1, 2, 3].map(|i| pairs[i].0), [0, 1, 2, 3].map(|i| pairs[i].1));
        if (0..4).any(|i| turn(&from, i) * turn(&to, i) <= 0.0) {
            return;
        }
        out.extend(linear(&pairs));
    }

    #[inline]
    fn error2(&self, m: &Both, i: usize) -> f64 {
        let (a, b) = &self.pairs[i];
        0.5 * (transfer2(&m.h, a, b) + transfer2(&m.inverse, b, a)) * self.inverse2
    }

    fn refine(&self, model: &Both, inliers: &[usize]) -> Option<Both> {
        let pairs: Vec<Pair> = inliers.iter().map(|&i| self.pairs[i]).collect();
        let start = linear(&pairs).unwrap_or_else(|| model.clone());
        gauss_newton(start, &pairs)
    }
}

#[inline]
fn transfer2(h: &Matrix3<f64>, from: &Vector2<f64>, to: &Vector2<f64>) -> f64 {
    let p = h * from.push(1.0);
    (p.xy() / p.z - to).norm_squared()
}

fn both(h: Matrix3<f64>) -> Option<Both> {
    let norm = h.norm();
    let h = h / norm;
    let inverse = h.try_inverse()?;
    (h.iter().chain(inverse.iter()).all(|v| v.is_finite())).then_some(Both { h, inverse })
}

/// The similarity that moves points to mean 0 and mean distance sqrt 2.
fn normaliser(points: impl Iterator<Item = Vector2<f64>> + Clone) -> Option<Matrix3<f64>> {
    let n = points.clone().count() as f64;
    let mean = points.clone().sum::<Vector2<f64>>() / n;
    let spread = points.map(|p| (p - mean).norm()).sum::<f64>() / n;
    let s = std::f64::consts::SQRT_2 / spread;
    s.is_finite().then(|| Matrix3::new(s, 0.0, -s * mean.x, 0.0, s, -s * mean.y, 0.0, 0.0, 1.0))
}

/// The algebraic least-squares fit in normalised coordinates (at least four pairs).
fn linear(pairs: &[Pair]) -> Option<Both> {
    let (na, nb) = (normaliser(pairs.iter().map(|p| p.0))?, normaliser(pairs.iter().map(|p| p.1))?);
    let mut m = SMatrix::<f64, 9, 9>::zeros();
    for (a, b) in pairs {
        let (p, q) = (na * a.push(1.0), nb * b.push(1.0));
        let rows = [
            [0.0, 0.0, 0.0, -p.x, -p.y, -1.0, q.y * p.x, q.y * p.y, q.y],
            [p.x, p.y, 1.0, 0.0, 0.0, 0.0, -q.x * p.x, -q.x * p.y, -q.x],
        ];
        for row in rows.map(SVector::<f64, 9>::from) {
            m.syger(1.0, &row, &row, 1.0);
        }
    }
    m.fill_upper_triangle_with_lower_triangle();
    let eigen = m.symmetric_eigen();
    let h = Matrix3::from_row_slice(eigen.eigenvectors.column(eigen.eigenvalues.imin()).as_slice());
    both(nb.try_inverse()? * h * na)
}

/// Minimises the transfer error into the second image.
fn gauss_newton(start: Both, pairs: &[Pair]) -> Option<Both> {
    let mut h = start.h;
    for _ in 0..3 {
        let (mut normal, mut gradient) = (SMatrix::<f64, 8, 8>::zeros(), SVector::<f64, 8>::zeros());
        let scale = h[(2, 2)];
        if scale.abs() < 1e-12 {
            return Some(start);
        }
        h /= scale;
        for (a, b) in pairs {
            let p = h * a.push(1.0);
            let (u, v, w) = (p.x / p.z, p.y / p.z, 1.0 / p.z);
            let (x, y) = (a.x * w, a.y * w);
            let ju = SVector::<f64, 8>::from([x, y, w, 0.0, 0.0, 0.0, -u * x, -u * y]);
            let jv = SVector::<f64, 8>::from([0.0, 0.0, 0.0, x, y, w, -v * x, -v * y]);
            for (j, r) in [(ju, u - b.x), (jv, v - b.y)] {
                normal.syger(1.0, &j, &j, 1.0);
                gradient.axpy(r, &j, 1.0);
            }
        }
        normal.fill_upper_triangle_with_lower_triangle();
        let Some(step) = normal.cholesky().map(|c| c.solve(&gradient)) else { return Some(start) };
        let s = |i: usize| h[(i / 3, i % 3)] - step[i];
        h = Matrix3::new(s(0), s(1), s(2), s(3), s(4), s(5), s(6), s(7), 1.0);
    }
    both(h).or(Some(start))
}
