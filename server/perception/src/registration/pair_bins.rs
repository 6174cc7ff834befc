//! Angles between a point and its neighbours, as bins of histograms, many neighbours side by side.

use nalgebra::{Point3, Vector3};

/// Bins of each of the three angles.
pub(super) const BINS: usize = 11;
/// Neighbours side by side.
pub(super) const LANES: usize = 16;

type Lanes = [f32; LANES];

/// Cosines and sines of the borders between the bins of the angle about the line, in the upper half turn: the lower one
/// mirrors it, and no border lies between.
const BORDERS: [[f32; 2]; 5] = [
    [0.959_493, 0.281_732_56],
    [0.654_860_73, 0.755_749_6],
    [0.142_314_84, 0.989_821_44],
    [-0.415_415, 0.909_632],
    [-0.841_253_5, 0.540_640_83],
];

/// A point and some of its neighbours.
pub(super) struct PairBins {
    point: [f32; 3],
    normal: [f32; 3],
    points: [Lanes; 3],
    normals: [Lanes; 3],
}

impl PairBins {
    #[inline(always)]
    pub(super) fn new(point: &Point3<f32>, normal: &Vector3<f32>) -> Self {
        let none = [[0.0; LANES]; 3];
        Self { point: point.coords.into(), normal: (*normal).into(), points: none, normals: none }
    }

    #[inline(always)]
    pub(super) fn put(&mut self, lane: usize, point: &Point3<f32>, normal: &Vector3<f32>) {
        for axis in 0..3 {
            self.points[axis][lane] = point[axis];
            self.normals[axis][lane] = normal[axis];
        }
    }

    /// Bins of the angle about the line, of the cosine of the second normal against the plane of line and first normal,
    /// and of the cosine of the first normal against the line. Pairs without these angles are in the middle.
    #[inline(always)]
    pub(super) fn bins(&self) -> [[i32; LANES]; 3] {
        let mut out = [[0; LANES]; 3];
        for lane in 0..LANES {
            let of = |a: &[Lanes; 3]| [a[0][lane], a[1][lane], a[2][lane]];
            let [theta, alpha, phi] = pair(&self.point, &self.normal, &of(&self.points), &of(&self.normals));
            let bin = |cosine: f32| ((BINS as f32 * 0.5) * (cosine + 1.0)) as i32;
            (out[0][lane], out[1][lane], out[2][lane]) = (theta as i32, bin(alpha), bin(phi));
        }
        out
    }
}

/// Bin of the first angle, and the two cosines. No branches: side by side, all of it is vector instructions.
#[inline(always)]
fn pair(p1: &[f32; 3], n1: &[f32; 3], p2: &[f32; 3], n2: &[f32; 3]) -> [f32; 3] {
    let line: [f32; 3] = std::array::from_fn(|k| p2[k] - p1[k]);
    let length = dot(&line, &line).sqrt();
    let inverse = if length > 0.0 { 1.0 / length } else { 0.0 };
    let (along1, along2) = (dot(n1, &line) * inverse, dot(n2, &line) * inverse);
    // The normal nearer to the line comes first.
    let swap = along1.abs() < along2.abs();
    let sign = if swap { -1.0 } else { 1.0 };
    let phi = if swap { -along2 } else { along1 };
    let first: [f32; 3] = std::array::from_fn(|k| if swap { n2[k] } else { n1[k] });
    let second: [f32; 3] = std::array::from_fn(|k| if swap { n1[k] } else { n2[k] });
    let across = cross(&line, &first);
    let width = dot(&across, &across).sqrt();
    let defined = (length > 0.0) & (width > 0.0);
    let inverse = if width > 0.0 { sign / width } else { 0.0 };
    let v = across.map(|x| x * inverse);
    let w = cross(&first, &v);
    let (y, x) = (dot(&w, &second), dot(&first, &second));
    let passed: f32 = BORDERS.iter().map(|[cos, sin]| if cos * y.abs() >= sin * x { 1.0 } else { 0.0 }).sum();
    let theta = if y < 0.0 { 5.0 - passed } else { 5.0 + passed };
    [if defined { theta } else { 5.0 }, if defined { dot(&v, &second) } else { 0.0 }, if defined { phi } else { 0.0 }]
}

#[inline(always)]
fn dot(a: &[f32; 3], b: &[f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[inline(always)]
fn cross(a: &[f32; 3], b: &[f32; 3]) -> [f32; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use std::f64::consts::PI;

    /// The same by the formulas of the paper in double precision, positions within the histograms 0 to 11.
    fn plain(p1: Vector3<f64>, n1: Vector3<f64>, p2: Vector3<f64>, n2: Vector3<f64>) -> [f64; 3] {
        let mut u = (p2 - p1).normalize();
        let (mut a, mut b) = (n1, n2);
        if n1.dot(&u).abs() < n2.dot(&u).abs() {
            (a, b, u) = (n2, n1, -u);
        }
        let v = u.cross(&a).normalize();
        let w = a.cross(&v);
        let theta = w.dot(&b).atan2(a.dot(&b));
        [11.0 * (theta + PI) / (2.0 * PI), 5.5 * (v.dot(&b) + 1.0), 5.5 * (a.dot(&u) + 1.0)]
    }

    #[test]
    fn bins_are_those_of_the_formulas_in_double_precision() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        for _ in 0..500 {
            let mut random = || Vector3::from_fn(|_, _| rng.random_range(-1.0..1.0f32));
            let (p, n) = (random(), random().normalize());
            let mut pairs = PairBins::new(&p.into(), &n);
            let others: Vec<_> = (0..LANES).map(|_| (random(), random().normalize())).collect();
            others.iter().enumerate().for_each(|(lane, (q, m))| pairs.put(lane, &(*q).into(), m));
            let bins = pairs.bins();
            for (lane, (q, m)) in others.iter().enumerate() {
                let wanted = plain(p.cast(), n.cast(), q.cast(), m.cast());
                for (k, want) in wanted.iter().enumerate() {
                    let at_border = (want - want.round()).abs() < 1e-4;
                    assert!(at_border || bins[k][lane] == want.floor() as i32, "{k} {want} {}", bins[k][lane]);
                }
            }
        }
    }

    #[test]
    fn a_pair_without_a_line_or_with_the_normal_in_it_is_in_the_middle() {
        let mut pairs = PairBins::new(&Point3::origin(), &Vector3::z());
        pairs.put(0, &Point3::origin(), &Vector3::x());
        pairs.put(1, &Point3::new(0.0, 0.0, 2.0), &Vector3::x());
        let bins = pairs.bins();
        assert!(bins.iter().all(|of_angle| of_angle[..2] == [5, 5]), "{bins:?}");
    }
}
