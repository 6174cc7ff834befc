//! A local map of points hashed by voxel, for registering scans against.

use crate::cloud::symmetric_eigen3;
use nalgebra::{Matrix3, Point3, Vector3};
use percept_geometry::{GeometryError, Voxel};
use rustc_hash::FxHashMap;
use serde::{Deserialize, Serialize};

/// How a [`VoxelHashMap`] thins what it takes in.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct VoxelMapParams {
    /// Edge of a voxel, metres; about 1 % of the sensor's range.
    pub voxel_size_m: f64,
    /// Points kept in a voxel, 1 to 255.
    pub max_points_per_voxel: usize,
}

impl Default for VoxelMapParams {
    /// KISS-ICP's values for a 100 m lidar.
    fn default() -> Self {
        Self { voxel_size_m: 1.0, max_points_per_voxel: 20 }
    }
}

impl VoxelMapParams {
    /// Checks the bounds.
    ///
    /// # Errors
    /// `OutOfRange` naming the field.
    pub fn validate(&self) -> Result<(), GeometryError> {
        if !(self.voxel_size_m.is_finite() && self.voxel_size_m > 0.0) {
            return Err(GeometryError::OutOfRange {
                field: "voxel_size_m",
                value: self.voxel_size_m,
                requirement: "positive and finite",
            });
        }
        if !(1..=255).contains(&self.max_points_per_voxel) {
            return Err(GeometryError::OutOfRange {
                field: "max_points_per_voxel",
                value: self.max_points_per_voxel as f64,
                requirement: "between 1 and 255",
            });
        }
        Ok(())
    }

    /// Points of a voxel are at least this far apart, metres: so that the voxel's points fill a face.
    pub fn min_spacing_m(&self) -> f64 {
        self.voxel_size_m / (self.max_points_per_voxel as f64).sqrt()
    }
}

/// The nearest map point to a query.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MapNeighbor {
    /// The point, map's frame.
    pub point: Point3<f64>,
    /// Squared distance to the query, square metres.
    pub distance2: f64,
    /// The voxel that holds the point; ask [`VoxelHashMap::stats`] or [`VoxelHashMap::normal`] about it.
    pub voxel: Voxel,
}

/// Distribution of all points that a voxel has been given, also of those it did not keep.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VoxelStats {
    /// How many.
    pub num_points: usize,
    /// Mean, map's frame.
    pub mean: Point3<f64>,
    /// Covariance, square metres.
    pub covariance: Matrix3<f64>,
}

/// Points hashed by voxel: inserted scan by scan with a minimum spacing, removed when far.
///
/// Coordinates are kept as f32 relative to the voxel's corner, so that a map 10 km from its origin is as
/// sharp as one at its origin. Everything depends on the order of insertion alone, never on hashes.
///
/// Source: Vizzo et al., "KISS-ICP: in defense of point-to-point ICP", 2023, section III-C.
#[derive(Debug, Clone)]
pub struct VoxelHashMap {
    params: VoxelMapParams,
    slots: FxHashMap<Voxel, u32>,
    blocks: Vec<Block>,
    /// `blocks x 3 x max_points_per_voxel`: x, y and z of a block's points lie side by side.
    coordinates: Vec<f32>,
}

#[derive(Debug, Clone)]
struct Block {
    voxel: Voxel,
    len: u8,
    count: u32,
    /// Sums over offsets from the voxel's corner.
    sum: Vector3<f64>,
    /// xx, xy, xz, yy, yz, zz.
    squares: [f64; 6],
    /// Unit normal if flat, as of the last count at which it was computed.
    normal: Option<Vector3<f32>>,
}

/// Points a voxel must have seen before its normal means something.
const NORMAL_FROM: u32 = 6;
/// Smallest over middle eigenvalue up to which a voxel counts as flat (sigma ratio 0.3).
const FLAT_UP_TO: f64 = 0.09;

impl VoxelHashMap {
    /// An empty map.
    ///
    /// # Errors
    /// `OutOfRange` naming the parameter.
    pub fn new(params: VoxelMapParams) -> Result<Self, GeometryError> {
        params.validate()?;
        Ok(Self { params, slots: FxHashMap::default(), blocks: Vec::new(), coordinates: Vec::new() })
    }

    /// The parameters.
    pub fn params(&self) -> &VoxelMapParams {
        &self.params
    }

    /// Number of points kept.
    pub fn len(&self) -> usize {
        self.blocks.iter().map(|b| usize::from(b.len)).sum()
    }

    /// Whether nothing is kept.
    pub fn is_empty(&self) -> bool {
        self.blocks.is_empty()
    }

    /// Number of voxels that hold something.
    pub fn num_voxels(&self) -> usize {
        self.blocks.len()
    }

    /// Forgets everything.
    pub fn clear(&mut self) {
        self.slots.clear();
        self.blocks.clear();
        self.coordinates.clear();
    }

    /// Takes in points, map's frame; those not finite are passed over. A voxel keeps a point only while it
    /// has room and no kept point of it is nearer than the spacing; its statistics take every point.
    pub fn insert(&mut self, points: impl IntoIterator<Item = Point3<f64>>) {
        let spacing2 = self.params.min_spacing_m().powi(2) as f32;
        let mut touched = Vec::new();
        for p in points {
            let Some(voxel) = Voxel::containing(&p, self.params.voxel_size_m) else { continue };
            let slot = self.slot_of(voxel);
            let offset = p - self.corner(voxel);
            if self.blocks[slot].add(&offset) {
                touched.push(slot);
            }
            self.keep_if_apart(slot, offset.cast::<f32>(), spacing2);
        }
        for slot in touched {
            self.blocks[slot].update_normal();
        }
    }

    /// Drops every voxel whose centre is farther than `radius_m` from `center`.
    pub fn remove_far_from(&mut self, center: &Point3<f64>, radius_m: f64) {
        let stride = self.stride();
        let mut slot = 0;
        while slot < self.blocks.len() {
            let voxel = self.blocks[slot].voxel;
            if (voxel.center(self.params.voxel_size_m) - center).norm_squared() <= radius_m * radius_m {
                slot += 1;
                continue;
            }
            self.slots.remove(&voxel);
            self.blocks.swap_remove(slot);
            let last = self.blocks.len();
            self.coordinates.copy_within(last * stride..(last + 1) * stride, slot * stride);
            self.coordinates.truncate(last * stride);
            if slot < last {
                self.slots.insert(self.blocks[slot].voxel, slot as u32);
            }
        }
    }

    /// The nearest kept point within `max_distance_m`, looked for in the query's voxel and the 26 around it:
    /// exact while `max_distance_m` is at most the voxel size. Ties: the first in the order of voxels.
    pub fn nearest(&self, query: &Point3<f64>, max_distance_m: f64) -> Option<MapNeighbor> {
        let size = self.params.voxel_size_m;
        let home = Voxel::containing(query, size)?;
        let offset = query - self.corner(home);
        let mut limit2 = (max_distance_m * max_distance_m) as f32;
        let mut best = None;
        for step in AROUND {
            // Voxels whose nearest face is beyond the best so far cannot help.
            if face_distance2(&offset, step, size) as f32 > limit2 {
                continue;
            }
            let Some(voxel) = neighbor(home, step) else { continue };
            let Some(&slot) = self.slots.get(&voxel) else { continue };
            let q = (query - self.corner(voxel)).cast::<f32>();
            if let Some((i, d2)) = self.nearest_in(slot as usize, &q, limit2) {
                limit2 = d2;
                best = Some((slot as usize, i));
            }
        }
        let (slot, i) = best?;
        let point = self.point(slot, i);
        Some(MapNeighbor { point, distance2: (point - query).norm_squared(), voxel: self.blocks[slot].voxel })
    }

    /// Distribution of the points given to a voxel; none if it holds nothing.
    pub fn stats(&self, voxel: Voxel) -> Option<VoxelStats> {
        let block = &self.blocks[*self.slots.get(&voxel)? as usize];
        let mean = block.sum / f64::from(block.count);
        Some(VoxelStats {
            num_points: block.count as usize,
            mean: self.corner(voxel) + mean,
            covariance: block.covariance(),
        })
    }

    /// Unit normal of a voxel's points, sign arbitrary; none if there are fewer than six or they are not flat.
    pub fn normal(&self, voxel: Voxel) -> Option<Vector3<f64>> {
        self.blocks[*self.slots.get(&voxel)? as usize].normal.map(|n| n.cast())
    }

    /// Every kept point, map's frame, in an order that depends on the history alone.
    pub fn points(&self) -> impl Iterator<Item = Point3<f64>> + '_ {
        (0..self.blocks.len())
            .flat_map(move |slot| (0..usize::from(self.blocks[slot].len)).map(move |i| self.point(slot, i)))
    }

    fn stride(&self) -> usize {
        3 * self.params.max_points_per_voxel
    }

    fn corner(&self, voxel: Voxel) -> Point3<f64> {
        let size = self.params.voxel_size_m;
        Point3::new(f64::from(voxel.x) * size, f64::from(voxel.y) * size, f64::from(voxel.z) * size)
    }

    fn point(&self, slot: usize, i: usize) -> Point3<f64> {
        let cap = self.params.max_points_per_voxel;
        let at = slot * self.stride() + i;
        let c = |axis: usize| f64::from(self.coordinates[at + axis * cap]);
        self.corner(self.blocks[slot].voxel) + Vector3::new(c(0), c(1), c(2))
    }

    fn slot_of(&mut self, voxel: Voxel) -> usize {
        let next = self.blocks.len();
        let slot = *self.slots.entry(voxel).or_insert(next as u32) as usize;
        if slot == next {
            self.blocks.push(Block::new(voxel));
            self.coordinates.resize((next + 1) * self.stride(), 0.0);
        }
        slot
    }

    fn keep_if_apart(&mut self, slot: usize, offset: Vector3<f32>, spacing2: f32) {
        let (cap, len) = (self.params.max_points_per_voxel, usize::from(self.blocks[slot].len));
        // The border itself counts as too near, so that a point given twice is kept once.
        if len == cap || self.nearest_in(slot, &offset, spacing2).is_some() {
            return;
        }
        let at = slot * self.stride() + len;
        for axis in 0..3 {
            self.coordinates[at + axis * cap] = offset[axis];
        }
        self.blocks[slot].len += 1;
    }

    /// Index and squared distance of the block's point nearest to `q` (relative to the block's corner), if
    /// nearer than `limit2`; a point just at the limit counts.
    #[inline]
    fn nearest_in(&self, slot: usize, q: &Vector3<f32>, limit2: f32) -> Option<(usize, f32)> {
        let (cap, len) = (self.params.max_points_per_voxel, usize::from(self.blocks[slot].len));
        let block = &self.coordinates[slot * self.stride()..(slot + 1) * self.stride()];
        let (xs, ys, zs) = (&block[..len], &block[cap..cap + len], &block[2 * cap..2 * cap + len]);
        let (mut best, mut best2) = (usize::MAX, f32::INFINITY);
        for i in 0..len {
            let (dx, dy, dz) = (q.x - xs[i], q.y - ys[i], q.z - zs[i]);
            let d2 = dx * dx + dy * dy + dz * dz;
            if d2 < best2 {
                (best, best2) = (i, d2);
            }
        }
        (best2 <= limit2 && best != usize::MAX).then_some((best, best2))
    }
}

impl Block {
    fn new(voxel: Voxel) -> Self {
        Self { voxel, len: 0, count: 0, sum: Vector3::zeros(), squares: [0.0; 6], normal: None }
    }

    /// Takes a point into the statistics; whether the normal is worth computing anew.
    fn add(&mut self, o: &Vector3<f64>) -> bool {
        // Beyond a million points a voxel has learnt its plane; sums stay exact enough below.
        if self.count >= 1_000_000 {
            return false;
        }
        self.count += 1;
        self.sum += o;
        let products = [o.x * o.x, o.x * o.y, o.x * o.z, o.y * o.y, o.y * o.z, o.z * o.z];
        for (s, p) in self.squares.iter_mut().zip(products) {
            *s += p;
        }
        // Every point while there are few, then some eight times between a count and its double.
        self.count >= NORMAL_FROM && self.count.is_multiple_of((self.count.next_power_of_two() / 16).max(1))
    }

    fn covariance(&self) -> Matrix3<f64> {
        let n = f64::from(self.count);
        let mean = self.sum / n;
        let [xx, xy, xz, yy, yz, zz] = self.squares.map(|s| s / n);
        Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz) - mean * mean.transpose()
    }

    fn update_normal(&mut self) {
        let eigen = symmetric_eigen3(&self.covariance());
        let [low, middle, _] = eigen.values;
        self.normal = (low <= FLAT_UP_TO * middle && middle > 0.0).then(|| eigen.vectors[0].cast());
    }
}

fn neighbor(home: Voxel, step: [i32; 3]) -> Option<Voxel> {
    Some(Voxel::new(home.x.checked_add(step[0])?, home.y.checked_add(step[1])?, home.z.checked_add(step[2])?))
}

/// Squared distance from a point at `offset` in its voxel to the voxel `step` away.
fn face_distance2(offset: &Vector3<f64>, step: [i32; 3], size: f64) -> f64 {
    (0..3)
        .map(|i| match step[i] {
            0 => 0.0,
            1 => (size - offset[i]).max(0.0).powi(2),
            _ => offset[i].max(0.0).powi(2),
        })
        .sum()
}

/// The voxel itself, then those sharing a face, an edge, a corner: the nearest point tends to come early.
const AROUND: [[i32; 3]; 27] = {
    let mut out = [[0; 3]; 27];
    let (mut n, mut shared) = (0, 0);
    while shared <= 3 {
        let mut i = 0;
        while i < 27 {
            let step = [i / 9 - 1, i / 3 % 3 - 1, i % 3 - 1];
            if step[0] * step[0] + step[1] * step[1] + step[2] * step[2] == shared {
                out[n] = step;
                n += 1;
            }
            i += 1;
        }
        shared += 1;
    }
    out
};

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn map(voxel_size_m: f64, max_points_per_voxel: usize) -> VoxelHashMap {
        VoxelHashMap::new(VoxelMapParams { voxel_size_m, max_points_per_voxel }).unwrap()
    }

    proptest! {
        #[test]
        fn nearest_equals_brute_force_over_the_kept_points(
            points in prop::collection::vec(prop::array::uniform3(-3.0..3.0f64), 1..300),
            q in prop::array::uniform3(-3.5..3.5f64),
            far in prop_oneof![Just(0.0), Just(12_345.0)],
        ) {
            let shift = Vector3::new(far, -far, 0.0);
            let mut map = map(0.8, 10);
            map.insert(points.iter().map(|&p| Point3::from(p) + shift));
            let q = Point3::from(q) + shift;
            let brute = map.points().map(|p| (p - q).norm()).fold(f64::INFINITY, f64::min);
            match map.nearest(&q, 0.8) {
                Some(found) => prop_assert!((found.distance2.sqrt() - brute).abs() < 1e-5),
                None => prop_assert!(brute > 0.8 - 1e-5),
            }
        }

        #[test]
        fn kept_points_of_a_voxel_stay_apart_and_few(
            points in prop::collection::vec(prop::array::uniform3(0.0..0.999f64), 1..300),
        ) {
            let mut map = map(1.0, 5);
            map.insert(points.iter().map(|&p| Point3::from(p)));
            let kept: Vec<_> = map.points().collect();
            prop_assert!(kept.len() <= 5 && !kept.is_empty());
            for (i, a) in kept.iter().enumerate() {
                for b in &kept[..i] {
                    prop_assert!((a - b).norm() >= map.params().min_spacing_m() - 1e-6);
                }
            }
            let stats = map.stats(Voxel::new(0, 0, 0)).unwrap();
            prop_assert_eq!(stats.num_points, points.len());
            let mean = points.iter().map(|&p| Vector3::from(p)).sum::<Vector3<f64>>() / points.len() as f64;
            prop_assert!((stats.mean.coords - mean).norm() < 1e-9);
        }
    }

    #[test]
    fn what_is_far_is_forgotten_and_the_rest_still_found() {
        let mut map = map(1.0, 20);
        map.insert((0..100).map(|i| Point3::new(f64::from(i) + 0.5, 0.5, 0.5)));
        map.remove_far_from(&Point3::new(50.0, 0.0, 0.0), 10.0);
        assert_eq!(map.num_voxels(), 20);
        for i in 0..100 {
            let p = Point3::new(f64::from(i) + 0.5, 0.5, 0.5);
            assert_eq!(map.nearest(&p, 0.1).is_some(), (40..60).contains(&i), "{i}");
        }
    }

    #[test]
    fn a_flat_voxel_knows_its_normal_and_a_filled_one_has_none() {
        let mut map = map(1.0, 20);
        let grid = |i: i32, n: i32| f64::from(i % n) / f64::from(n);
        map.insert((0..100).map(|i| Point3::new(grid(i, 10), grid(i / 10, 10), 0.25)));
        map.insert((0..1000).map(|i| Point3::new(5.0 + grid(i, 10), grid(i / 10, 10), grid(i / 100, 10))));
        let normal = map.normal(Voxel::new(0, 0, 0)).unwrap();
        assert!((normal.z.abs() - 1.0).abs() < 1e-6);
        assert_eq!(map.normal(Voxel::new(5, 0, 0)), None);
    }

    #[test]
    fn points_that_are_not_finite_or_out_of_range_are_passed_over() {
        let mut map = map(1.0, 20);
        map.insert([Point3::new(f64::NAN, 0.0, 0.0), Point3::new(1e300, 0.0, 0.0)]);
        assert!(map.is_empty());
        assert_eq!(map.nearest(&Point3::new(f64::NAN, 0.0, 0.0), 1.0), None);
        map.insert([Point3::new(-2147483647.5, 0.0, 0.0)]);
        assert!(map.nearest(&Point3::new(-2147483647.5, 0.0, 0.0), 1.0).is_some());
    }

    #[test]
    fn parameters_out_of_bounds_are_named() {
        for (voxel_size_m, max_points_per_voxel, name) in
            [(0.0, 20, "voxel_size_m"), (f64::NAN, 20, "voxel_size_m"), (1.0, 0, "max_points_per_voxel")]
        {
            let error = VoxelHashMap::new(VoxelMapParams { voxel_size_m, max_points_per_voxel }).unwrap_err();
            assert!(error.to_string().starts_with(name), "{error}");
        }
    }
}
