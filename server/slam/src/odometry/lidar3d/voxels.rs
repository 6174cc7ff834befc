//! Voxels with a Gaussian each.

use nalgebra::{Matrix3, Point3, Vector3};
use rayon::prelude::*;
use rustc_hash::FxHashMap;

/// Key of a voxel: 21 bits an axis.
pub(crate) type Key = u64;

/// Key of the voxel that holds `p`; coordinates wrap after 2^21 voxels, far beyond a lidar's range.
#[inline]
pub(crate) fn key(p: &Point3<f64>, inverse_size: f64) -> Key {
    let i = |x: f64| (x * inverse_size).floor() as i64 as u64 & 0x1f_ffff;
    i(p.x) << 42 | i(p.y) << 21 | i(p.z)
}

/// The neighbour of a voxel.
#[inline]
fn neighbour(key: Key, axis: u32, up: bool) -> Key {
    let shift = 21 * axis;
    let mask = 0x1f_ffff << shift;
    let one = 1u64 << shift;
    let moved = if up { (key & mask).wrapping_add(one) } else { (key & mask).wrapping_sub(one) };
    (key & !mask) | (moved & mask)
}

/// What a voxel's points look like.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Shape {
    /// Too few points, or a line: says nothing reliable.
    Unknown,
    /// A plane with unit normal and thickness variance (m^2).
    Plane(Vector3<f64>, f64),
    /// No plane: the axes of the points' scatter, unit vectors in columns, and the variances along them, m^2.
    Scatter(Matrix3<f64>, Vector3<f64>),
}

/// Points of a voxel as a Gaussian.
#[derive(Debug, Clone)]
pub(crate) struct Gaussian {
    pub(crate) key: Key,
    num: f64,
    pub(crate) mean: Point3<f64>,
    /// Sum of outer products of offsets from the mean.
    scatter: Matrix3<f64>,
    pub(crate) shape: Shape,
    /// Variance of a plane's tilt about each axis in it, rad^2, from noise and number of its points.
    pub(crate) tilt: f64,
    /// The clock's way when it was last seen.
    seen: f64,
    dirty: bool,
}

/// Fewest points that make a shape. Halved 397 and 12.3, doubled 11.6 and 8.7 ([`super`]): three fix a plane, and what
/// is left has to tell noise.
const MIN_POINTS: f64 = 5.0;
/// More count as so many, so that old points fade: too soon, and a voxel follows the sweeps instead of holding them
/// (dense rings bring 25 points a sweep, so that 200 were forgotten in a second). Halved 15.2 and 11.1, doubled 11.6
/// and 9.7 ([`super`]).
const MAX_POINTS: f64 = 500.0;

/// Drift that makes a difference, and the most that what was seen before is thought to be off by, finest voxels. The
/// first halved 13.3 and 9.3, doubled 274 and 9.8; the second halved 10.9 and 9.7, doubled 12.1 and 9.9 ([`super`]).
const NOTICED: f64 = 0.075;
const MOST_DRIFT: f64 = 0.125;

/// A plane's variance across it is less than this share of that along it. A plane that crosses a square voxel has 1/12 of its size
/// squared along it, so that this is a thickness (one standard deviation) of 0.08 of the size.
pub(super) const FLAT: f64 = 0.08;

/// A plane is wider than what ranges' noise makes of a line: three standard deviations, squared. Of 4, 9 and 16 none is
/// better on every recording.
const RIBBON: f64 = 9.0;

/// So many voxels tell how thick planes are. A median of 2000 is good to 3 % of the spread; halved and doubled 12.0 and
/// 9.9 ([`super`]).
const THICKNESS_OF: usize = 2000;

/// Least variance that a plane is given, m^2: voxels' planes differ from each other.
pub(crate) fn floor(size: f64) -> f64 {
    (0.02 * size).powi(2)
}

impl Gaussian {
    fn new(key: Key, p: &Point3<f64>, seen: f64) -> Self {
        let (scatter, shape) = (Matrix3::zeros(), Shape::Unknown);
        Self { key, num: 1.0, mean: *p, scatter, shape, tilt: 0.0, seen, dirty: true }
    }

    /// Seen again: what was seen long ago may be off by what the odometry has drifted since, and fades.
    fn refresh(&mut self, clock: &Clock) {
        let variance = self.stale(clock);
        self.seen = clock.way;
        if variance > 0.0 {
            let num = (self.num / (1.0 + variance / (NOTICED * clock.size).powi(2))).max(1.0);
            self.scatter *= num / self.num;
            self.num = num;
        }
    }

    /// Source: Welford, "Note on a method for calculating corrected sums of squares and products", 1962.
    fn add(&mut self, p: &Point3<f64>) {
        if self.num >= MAX_POINTS {
            let keep = (MAX_POINTS - 1.0) / self.num;
            self.num *= keep;
            self.scatter *= keep;
        }
        self.num += 1.0;
        let before = p - self.mean;
        self.mean += before / self.num;
        self.scatter += before * (p - self.mean).transpose();
        self.dirty = true;
    }

    /// Takes in the points of another.
    fn merge(&mut self, other: &Self) {
        let (n, all) = (self.num, self.num + other.num);
        let between = other.mean - self.mean;
        self.mean += between * (other.num / all);
        self.scatter += other.scatter + between * between.transpose() * (n * other.num / all);
        self.num = all;
        self.seen = self.seen.max(other.seen);
    }

    /// Variance of where it is now, by what the odometry may have drifted since it was seen, m^2.
    #[inline]
    pub(crate) fn stale(&self, clock: &Clock) -> f64 {
        (clock.sigma * (clock.way - self.seen)).min(MOST_DRIFT * clock.size).powi(2)
    }

    /// `ranges`: of the newest sweep, if it was one.
    fn describe(&mut self, size: f64, ranges: Option<&Ranges>) {
        self.dirty = false;
        self.shape = Shape::Unknown;
        if self.num < MIN_POINTS {
            return;
        }
        let c = self.scatter / (self.num - 1.0);
        let c = (c + c.transpose()) * 0.5;
        let (values, normal) = smallest(&c);
        // A line (one ring of the lidar) fixes no plane, though noise makes a ribbon of it along the beam.
        let smeared = ranges.map_or(0.0, |r| RIBBON * r.within(&self.mean, &normal));
        if values[1] < (0.04 * values[2]).max(smeared) || values[2] < 1e-4 * size * size {
            return;
        }
        self.tilt = values[0].max(0.0) / (self.num * values[1]);
        self.shape = if values[0] < FLAT * values[1] {
            Shape::Plane(normal, values[0].max(0.0) + floor(size))
        } else {
            let eigen = c.symmetric_eigen();
            let soft = (0.1 * size).powi(2);
            Shape::Scatter(eigen.eigenvectors, eigen.eigenvalues.map(|v| v.max(0.0) + soft))
        };
    }
}

/// Eigenvalues, ascending, and the unit eigenvector of the smallest.
///
/// Source: Smith, "Eigenvalues of a symmetric 3x3 matrix", 1961 (trigonometric form); the vector is the
/// largest cross product of two rows of `A - lambda I`.
fn smallest(a: &Matrix3<f64>) -> ([f64; 3], Vector3<f64>) {
    let q = a.trace() / 3.0;
    let off = a[(0, 1)].powi(2) + a[(0, 2)].powi(2) + a[(1, 2)].powi(2);
    let d = Vector3::new(a[(0, 0)] - q, a[(1, 1)] - q, a[(2, 2)] - q);
    let p = ((d.norm_squared() + 2.0 * off) / 6.0).sqrt();
    if p <= 0.0 {
        return ([q; 3], Vector3::z());
    }
    let r = ((a - Matrix3::identity() * q) / p).determinant() / 2.0;
    let phi = r.clamp(-1.0, 1.0).acos() / 3.0;
    let high = q + 2.0 * p * phi.cos();
    let low = q + 2.0 * p * (phi + std::f64::consts::TAU / 3.0).cos();
    let m = a - Matrix3::identity() * low;
    let rows: [Vector3<f64>; 3] = std::array::from_fn(|i| m.row(i).transpose());
    let best = [rows[0].cross(&rows[1]), rows[0].cross(&rows[2]), rows[1].cross(&rows[2])]
        .into_iter()
        .fold(Vector3::zeros(), |a, b| if b.norm_squared() > a.norm_squared() { b } else { a });
    let normal = best.try_normalize(1e-300).unwrap_or_else(Vector3::z);
    ([low, 3.0 * q - high - low, high], normal)
}

/// From where a sweep's points were seen, and how noisy their ranges are.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Ranges {
    pub(super) origin: Point3<f64>,
    /// Square metres.
    pub(super) variance: f64,
}

impl Ranges {
    /// What of the ranges' variance lies within a plane through a point, m^2.
    fn within(&self, p: &Point3<f64>, normal: &Vector3<f64>) -> f64 {
        let beam = p - self.origin;
        let across = beam.dot(normal) / beam.norm().max(1e-9);
        self.variance * (1.0 - across * across)
    }
}

/// A map of Gaussians in odom.
#[derive(Debug, Default)]
pub(crate) struct GaussianMap {
    size: f64,
    inverse: f64,
    index: FxHashMap<Key, u32>,
    voxels: Vec<Gaussian>,
    pub(super) clock: Clock,
}

/// What the odometry's drift goes by.
#[derive(Debug, Default, Clone, Copy)]
pub(crate) struct Clock {
    /// How many times the whole view was new since the map began.
    pub(crate) way: f64,
    /// Drift for each time, metres.
    pub(crate) sigma: f64,
    /// Of the finest voxels, metres.
    pub(crate) size: f64,
}

impl GaussianMap {
    pub(crate) fn new(size: f64) -> Self {
        Self::beginning(size, Clock::default())
    }

    /// An empty one, at this time.
    pub(crate) fn beginning(size: f64, clock: Clock) -> Self {
        Self { size, inverse: 1.0 / size, clock, ..Self::default() }
    }

    pub(crate) fn size(&self) -> f64 {
        self.size
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.voxels.is_empty()
    }

    /// Bytes, about.
    pub(crate) fn memory_bytes(&self) -> usize {
        self.voxels.capacity() * size_of::<Gaussian>() + self.index.capacity() * (size_of::<(Key, u32)>() + 1)
    }

    /// How thick the planes are: median variance across them, m^2; none if they are few.
    pub(crate) fn thickness(&self) -> Option<f64> {
        let thick = |v: &Gaussian| match v.shape {
            Shape::Plane(_, variance) => Some(variance - floor(self.size)),
            _ => None,
        };
        let step = (self.voxels.len() / THICKNESS_OF).max(1);
        let mut all: Vec<f64> = self.voxels.iter().step_by(step).filter_map(thick).collect();
        let middle = all.len() / 2;
        (middle >= 10).then(|| *all.select_nth_unstable_by(middle, f64::total_cmp).1)
    }

    /// Adds points of odom and brings the shapes up to date. Answers with the share that lies where nothing was.
    pub(crate) fn insert(&mut self, points: impl Iterator<Item = Point3<f64>>, ranges: Option<&Ranges>) -> f64 {
        let (before, mut new, mut all) = (self.voxels.len(), 0u32, 0u32);
        for p in points {
            let k = key(&p, self.inverse);
            let i = *self.index.entry(k).or_insert(self.voxels.len() as u32) as usize;
            match self.voxels.get_mut(i) {
                Some(voxel) => {
                    voxel.refresh(&self.clock);
                    voxel.add(&p);
                }
                None => self.voxels.push(Gaussian::new(k, &p, self.clock.way)),
            }
            new += u32::from(i >= before);
            all += 1;
        }
        let size = self.size;
        self.voxels.par_iter_mut().with_min_len(1024).filter(|v| v.dirty).for_each(|v| v.describe(size, ranges));
        f64::from(new) / f64::from(all.max(1))
    }

    /// The same points in voxels of twice the size.
    pub(crate) fn doubled(&self) -> Self {
        let mut out = Self::beginning(2.0 * self.size, self.clock);
        for v in &self.voxels {
            let k = key(&v.mean, out.inverse);
            match out.index.entry(k) {
                std::collections::hash_map::Entry::Occupied(i) => out.voxels[*i.get() as usize].merge(v),
                std::collections::hash_map::Entry::Vacant(slot) => {
                    slot.insert(out.voxels.len() as u32);
                    out.voxels.push(Gaussian { key: k, ..v.clone() });
                }
            }
        }
        out.voxels.iter_mut().for_each(|v| v.describe(out.size, None));
        out
    }

    /// Forgets voxels farther than `radius` from `center`.
    pub(crate) fn remove_far_from(&mut self, center: &Point3<f64>, radius: f64) {
        self.voxels.retain(|v| (v.mean - center).norm_squared() <= radius * radius);
        self.index.clear();
        self.index.extend(self.voxels.iter().enumerate().map(|(i, v)| (v.key, i as u32)));
    }

    /// The voxel at `p`, if it is described.
    #[inline]
    pub(crate) fn own(&self, p: &Point3<f64>) -> Option<&Gaussian> {
        self.described(key(p, self.inverse))
    }

    #[inline]
    fn described(&self, key: Key) -> Option<&Gaussian> {
        let v = &self.voxels[*self.index.get(&key)? as usize];
        (v.shape != Shape::Unknown).then_some(v)
    }

    /// The described voxel at `p`, else the described face neighbour with the nearest mean.
    #[inline]
    pub(crate) fn at(&self, p: &Point3<f64>) -> Option<&Gaussian> {
        let k = key(p, self.inverse);
        if let Some(v) = self.described(k) {
            return Some(v);
        }
        let mut best: Option<(f64, &Gaussian)> = None;
        for side in 0..6 {
            if let Some(v) = self.described(neighbour(k, side / 2, side % 2 == 1)) {
                let d = (v.mean - p).norm_squared();
                if best.is_none_or(|b| d < b.0) {
                    best = Some((d, v));
                }
            }
        }
        best.filter(|b| b.0 < self.size * self.size).map(|b| b.1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_fast_eigenvector_agrees_with_the_plain_one() {
        for seed in 0..200 {
            let m = Matrix3::from_fn(|i, j| ((seed * 31 + i * 7 + j * 3 + i * j * seed) as f64 * 0.7).sin());
            let a = m * m.transpose() + Matrix3::from_diagonal(&Vector3::new(0.01, 0.1, 0.5));
            let plain = a.symmetric_eigen();
            let i = plain.eigenvalues.imin();
            let (values, normal) = smallest(&a);
            assert!((values[0] - plain.eigenvalues[i]).abs() < 1e-9);
            assert!(normal.dot(&plain.eigenvectors.column(i)).abs() > 1.0 - 1e-9);
        }
    }

    #[test]
    fn a_patch_is_a_plane_and_a_ring_is_not() {
        let mut map = GaussianMap::new(1.0);
        let grid = |i: usize| Point3::new(0.1 * (i % 9) as f64 + 0.05, 0.1 * (i / 9) as f64 + 0.05, 0.5);
        map.insert((0..81).map(grid), None);
        let Shape::Plane(n, variance) = map.at(&Point3::new(0.5, 0.5, 0.4)).unwrap().shape else { panic!() };
        assert!(n.z.abs() > 1.0 - 1e-9 && (variance - 4e-4).abs() < 1e-9);
        let mut line = GaussianMap::new(1.0);
        line.insert((0..9).map(grid), None);
        assert!(line.at(&Point3::new(0.5, 0.05, 0.5)).is_none());
    }

    /// Nine points on each of some lines of a floor, `apart` metres apart along x, ranges off by `noise` from the origin.
    fn rings(lines: i32, apart: f64, noise: f64) -> GaussianMap {
        let mut map = GaussianMap::new(1.0);
        let origin = Point3::new(-6.0, 0.5, 2.5);
        let at = |line: i32, i: i32| {
            let p = Point3::new(0.2 + apart * f64::from(line), 0.1 + 0.1 * f64::from(i % 9), 0.5);
            p + (p - origin).normalize() * (noise * (1.7 * f64::from(i)).sin())
        };
        let points = (0..lines).flat_map(|line| (0..90).map(move |i| at(line, i)));
        map.insert(points, Some(&Ranges { origin, variance: 0.02f64.powi(2) }));
        map
    }

    #[test]
    fn noise_along_the_beam_makes_no_plane_of_one_ring() {
        let middle = Point3::new(0.4, 0.5, 0.5);
        // 3 cm of noise in the mean: a ribbon that is tilted by 18 degrees, as the beams are.
        assert!(rings(1, 0.0, 0.04).at(&middle).is_none());
        let two = rings(2, 0.5, 0.04);
        let Shape::Plane(normal, _) = two.at(&middle).unwrap().shape else { panic!() };
        assert!(normal.z.abs() > 0.99, "{normal}");
    }

    #[test]
    fn an_edge_tells_across_it_whichever_way_it_runs() {
        // A floor and a wall meet in the voxel's middle, along x and along the diagonal.
        for along in [Vector3::x(), Vector3::new(1.0, 1.0, 0.0).normalize()] {
            let across = Vector3::z().cross(&along);
            let mut map = GaussianMap::new(1.0);
            let (middle, side) = (Vector3::repeat(0.5), |i: i32| 0.04 * f64::from(i));
            let all = (-9..=9).flat_map(|i| (0..=6).map(move |k| (i, k)));
            let points = all.flat_map(|(i, k)| {
                let on = middle + along * side(i);
                [on + across * side(k), on + Vector3::z() * side(k)].map(Point3::from)
            });
            map.insert(points, None);
            let Shape::Scatter(axes, variances) = map.at(&Point3::from(middle)).unwrap().shape else { panic!() };
            let told = |v: &Vector3<f64>| (0..3).map(|k| axes.column(k).dot(v).powi(2) / variances[k]).sum::<f64>();
            assert!(told(&across) > 2.0 * told(&along), "{} {}", told(&along), told(&across));
            assert!((told(&along) - 1.0 / (0.01 + side(1).powi(2) * 30.0)).abs() < 0.5, "{}", told(&along));
        }
    }

    #[test]
    fn doubled_voxels_are_those_of_the_same_points() {
        let points: Vec<_> = (0..2000)
            .map(|i| Point3::from(Vector3::from_fn(|k, _| 3.0 * (f64::from(i * (k as i32 + 3)) * 0.37).sin())))
            .collect();
        let (mut small, mut large) = (GaussianMap::new(0.5), GaussianMap::new(1.0));
        small.insert(points.iter().copied(), None);
        large.insert(points.iter().copied(), None);
        let doubled = small.doubled();
        assert_eq!(doubled.voxels.len(), large.voxels.len());
        for v in &large.voxels {
            let d = &doubled.voxels[doubled.index[&v.key] as usize];
            assert!((d.mean - v.mean).norm() < 1e-9 && (d.scatter - v.scatter).norm() < 1e-9);
        }
    }

    #[test]
    fn neighbours_wrap_without_touching_other_axes() {
        let k = key(&Point3::new(-0.5, 0.5, -0.5), 1.0);
        assert_eq!(neighbour(neighbour(k, 2, true), 2, false), k);
        assert_eq!(neighbour(k, 2, true), key(&Point3::new(0.5, 0.5, -0.5), 1.0));
        assert_eq!(neighbour(k, 0, false), key(&Point3::new(-0.5, 0.5, -1.5), 1.0));
    }
}
