//! Coordinates side by side, and what planes need of them.

use super::{Scatter, symmetric_eigen3};
use nalgebra::{Point3, Vector3};
use percept_geometry::{by_processor, cloud::is_finite};
use rayon::prelude::*;

/// Points that stay in the nearest cache (24 kB) while a block of hypotheses is tested on them.
const CHUNK: usize = 2048;
/// Lanes of the sums in f64: ten of them fill ten of sixteen AVX registers.
const LANES: usize = 4;

/// Coordinates about an anchor, as f32 side by side: far from the origin they keep their digits.
pub(super) struct Local {
    pub(super) anchor: Point3<f64>,
    xs: Vec<f32>,
    ys: Vec<f32>,
    zs: Vec<f32>,
    /// Index of each in the cloud.
    indices: Vec<u32>,
}

/// `normal . p + offset`, about the anchor.
#[derive(Debug, Clone, Copy)]
pub(super) struct Hypothesis {
    pub(super) normal: Vector3<f64>,
    pub(super) offset: f64,
}

impl Hypothesis {
    fn coefficients(&self) -> [f32; 4] {
        [self.normal.x as f32, self.normal.y as f32, self.normal.z as f32, self.offset as f32]
    }
}

impl Local {
    /// The finite ones of the points with these indices; none if there is none.
    pub(super) fn new(points: &[Point3<f32>], candidates: impl Iterator<Item = u32>) -> Option<Self> {
        let mut candidates = candidates.filter(|&i| is_finite(&points[i as usize])).peekable();
        let anchor = points[*candidates.peek()? as usize];
        let capacity = candidates.size_hint().1.unwrap_or(0);
        let with_room = || Vec::with_capacity(capacity);
        let mut out = Self {
            anchor: anchor.cast(),
            xs: with_room(),
            ys: with_room(),
            zs: with_room(),
            indices: Vec::with_capacity(capacity),
        };
        for i in candidates {
            // Rounded once, as the difference in f64 would be.
            let p = points[i as usize] - anchor;
            out.xs.push(p.x);
            out.ys.push(p.y);
            out.zs.push(p.z);
            out.indices.push(i);
        }
        Some(out)
    }

    pub(super) fn len(&self) -> usize {
        self.xs.len()
    }

    pub(super) fn at(&self, i: usize) -> Vector3<f64> {
        Vector3::new(self.xs[i], self.ys[i], self.zs[i]).cast()
    }

    /// The points at these places.
    pub(super) fn sample(&self, places: &[usize]) -> Self {
        let pick = |v: &[f32]| places.iter().map(|&i| v[i]).collect();
        let indices = places.iter().map(|&i| self.indices[i]).collect();
        Self { anchor: self.anchor, xs: pick(&self.xs), ys: pick(&self.ys), zs: pick(&self.zs), indices }
    }

    /// How many points lie within `distance` of each plane: chunk by chunk, so that each is read once.
    pub(super) fn counts(&self, hypotheses: &[Hypothesis], distance: f64) -> Vec<usize> {
        let planes: Vec<[f32; 4]> = hypotheses.iter().map(Hypothesis::coefficients).collect();
        let chunks = self.xs.par_chunks(CHUNK).zip(self.ys.par_chunks(CHUNK)).zip(self.zs.par_chunks(CHUNK));
        let counted = chunks.map(|((xs, ys), zs)| {
            planes.iter().map(|plane| count_within(xs, ys, zs, plane, distance as f32)).collect::<Vec<usize>>()
        });
        let add = |mut a: Vec<usize>, b: Vec<usize>| {
            a.iter_mut().zip(b).for_each(|(a, b)| *a += b);
            a
        };
        counted.reduce(|| vec![0; planes.len()], add)
    }

    /// First and second moments of the points within `distance` of a plane.
    pub(super) fn moments(&self, h: &Hypothesis, distance: f64) -> Moments {
        let plane = h.coefficients();
        let chunks = self.xs.par_chunks(CHUNK).zip(self.ys.par_chunks(CHUNK)).zip(self.zs.par_chunks(CHUNK));
        let parts: Vec<[f64; 10]> =
            chunks.map(|((xs, ys), zs)| sums_within(xs, ys, zs, &plane, -distance as f32, distance as f32)).collect();
        let mut sums = [0.0; 10];
        parts.iter().for_each(|part| sums.iter_mut().zip(part).for_each(|(s, p)| *s += p));
        Moments(Scatter::from_sums(Point3::origin(), &sums))
    }

    /// Places of the points within `distance` of a plane, ascending.
    pub(super) fn within(&self, h: &Hypothesis, distance: f64) -> Vec<u32> {
        let mut out = vec![0; self.len()];
        let n = list_within(&self.xs, &self.ys, &self.zs, &h.coefficients(), distance as f32, &mut out);
        out.truncate(n);
        out
    }

    /// Indices in the cloud of the points at these places.
    pub(super) fn indices(&self, places: &[u32]) -> Vec<usize> {
        places.iter().map(|&i| self.indices[i as usize] as usize).collect()
    }

    /// Takes out the points at these places (ascending).
    pub(super) fn remove(&mut self, places: &[u32]) {
        let mut keep = vec![true; self.len()];
        places.iter().for_each(|&i| keep[i as usize] = false);
        let mut kept = 0;
        for (i, keep) in keep.iter().enumerate() {
            self.xs[kept] = self.xs[i];
            self.ys[kept] = self.ys[i];
            self.zs[kept] = self.zs[i];
            self.indices[kept] = self.indices[i];
            kept += usize::from(*keep);
        }
        self.xs.truncate(kept);
        self.ys.truncate(kept);
        self.zs.truncate(kept);
        self.indices.truncate(kept);
    }
}

/// Moments of the points near a plane, about the anchor.
pub(super) struct Moments(Scatter);

impl Moments {
    pub(super) fn num_points(&self) -> usize {
        self.0.num_points()
    }

    /// The plane of least squares; none if the points are on a line.
    pub(super) fn fit(&self) -> Option<Hypothesis> {
        let eigen = symmetric_eigen3(&self.0.covariance());
        let normal = eigen.vectors[0];
        (self.num_points() >= 3 && eigen.values[1] > 1e-10 * eigen.values[2])
            .then(|| Hypothesis { normal, offset: -normal.dot(&self.0.mean().coords) })
    }

    /// Root mean square, over the points, of the distance between two planes.
    pub(super) fn deviation(&self, a: &Hypothesis, b: &Hypothesis) -> f64 {
        self.mean_square(&Hypothesis { normal: a.normal - b.normal, offset: a.offset - b.offset }).sqrt()
    }

    /// Mean of the squared distances from a plane.
    pub(super) fn mean_square(&self, h: &Hypothesis) -> f64 {
        let bias = h.normal.dot(&self.0.mean().coords) + h.offset;
        (h.normal.dot(&(self.0.covariance() * h.normal)) + bias * bias).max(0.0)
    }
}

by_processor! {
    fn count_within(xs: &[f32], ys: &[f32], zs: &[f32], plane: &[f32; 4], distance: f32) -> usize {
        let [a, b, c, d] = *plane;
        let mut count = 0u32;
        for ((x, y), z) in xs.iter().zip(ys).zip(zs) {
            count += u32::from((a * x + b * y + c * z + d).abs() <= distance);
        }
        count as usize
    }
}

by_processor! {
    /// Number, sum and products (xx, xy, xz, yy, yz, zz) of the points whose signed distance is from `low` to `high`.
    pub(crate) fn sums_within(xs: &[f32], ys: &[f32], zs: &[f32], plane: &[f32; 4], low: f32, high: f32) -> [f64; 10] {
        let [a, b, c, d] = *plane;
        let mut sums = [[0.0f64; LANES]; 10];
        let mut take = |xs: &[f32; LANES], ys: &[f32; LANES], zs: &[f32; LANES], valid: usize| {
            for l in 0..LANES {
                let height = a * xs[l] + b * ys[l] + c * zs[l] + d;
                let near = low <= height && height <= high && l < valid;
                let weight = if near { 1.0f64 } else { 0.0 };
                let (x, y, z) = (f64::from(xs[l]), f64::from(ys[l]), f64::from(zs[l]));
                let (wx, wy, wz) = (weight * x, weight * y, weight * z);
                let terms = [weight, wx, wy, wz, wx * x, wx * y, wx * z, wy * y, wy * z, wz * z];
                for (sum, term) in sums.iter_mut().zip(terms) {
                    sum[l] += term;
                }
            }
        };
        let ((xs, x_end), (ys, y_end), (zs, z_end)) = (xs.as_chunks(), ys.as_chunks(), zs.as_chunks());
        for ((x, y), z) in xs.iter().zip(ys).zip(zs) {
            take(x, y, z, LANES);
        }
        let padded = |end: &[f32]| {
            let mut out = [0.0; LANES];
            out[..end.len()].copy_from_slice(end);
            out
        };
        take(&padded(x_end), &padded(y_end), &padded(z_end), x_end.len());
        sums.map(|lanes| lanes.iter().sum())
    }
}

by_processor! {
    fn list_within(xs: &[f32], ys: &[f32], zs: &[f32], plane: &[f32; 4], distance: f32, out: &mut [u32]) -> usize {
        let [a, b, c, d] = *plane;
        let mut n = 0;
        for (i, ((x, y), z)) in xs.iter().zip(ys).zip(zs).enumerate() {
            // Written always, kept if near: no branch to guess.
            out[n] = i as u32;
            n += usize::from((a * x + b * y + c * z + d).abs() <= distance);
        }
        n
    }
}
