//! Simulated streets between parallel walls, and what a lidar sees along two stretches of one.
//!
//! Their own ray caster: where the simulator's worlds are rooms, these are boxes, posts and crowns on a plane. Frame: x along
//! the street, z up, metres. The truth is the generator's.

use super::{Failure, Pair, overlap_of_smaller};
use nalgebra::{Point3, Translation3, UnitQuaternion, Vector3};
use percept_geometry::{PointCloud, Pose};
use percept_perception::cloud::voxel_downsample;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};
use rayon::prelude::*;
use std::f64::consts::{PI, TAU};
use std::ops::Range;

const LENGTH_M: f64 = 200.0;
const RINGS: usize = 32;
const COLUMNS: usize = 300;
const ELEVATION: (f64, f64) = (-0.45, 0.3);
const HEIGHT_M: f64 = 1.7;
const NOISE_M: f64 = 0.02;
/// A stretch, and the way between two of its scans.
const STRETCH_M: f64 = 12.0;
const STEP_M: f64 = 1.5;
/// What the clouds are thinned to, as maps are.
const VOXEL_M: f64 = 0.2;
const OVERLAP: Range<f64> = 0.1..0.5;
const TRIES: usize = 100;

/// What stands in a street.
#[derive(Debug, Clone, Copy)]
enum Kind {
    /// Two walls: nothing tells where along them.
    Bare,
    /// A few things, far apart.
    Sparse,
    /// Recesses and posts at equal distances, as terraced houses have them.
    Periodic,
    /// Fronts at different depths and heights.
    Fronts,
    /// All of it, with gaps, cars and trees.
    Dense,
}

const KINDS: [Kind; 5] = [Kind::Bare, Kind::Sparse, Kind::Periodic, Kind::Fronts, Kind::Dense];

#[derive(Debug, Clone, Copy)]
struct Block {
    min: Vector3<f64>,
    max: Vector3<f64>,
}

#[derive(Debug, Clone, Copy)]
struct Post {
    x: f64,
    y: f64,
    radius: f64,
    top: f64,
}

/// A ball of leaves: half of the rays go through.
#[derive(Debug, Clone, Copy)]
struct Crown {
    center: Vector3<f64>,
    radius: f64,
}

#[derive(Debug, Default, Clone)]
struct Street {
    blocks: Vec<Block>,
    posts: Vec<Post>,
    crowns: Vec<Crown>,
}

impl Street {
    fn random(kind: Kind, rng: &mut ChaCha8Rng) -> Self {
        let mut out = Self::default();
        let half = rng.random_range(5.0..11.0);
        for side in [-1.0, 1.0] {
            out.fronts(kind, side, half, rng);
            out.things(kind, side, half, rng);
        }
        out
    }

    /// The row of houses on one side.
    fn fronts(&mut self, kind: Kind, side: f64, half: f64, rng: &mut ChaCha8Rng) {
        let period = rng.random_range(5.0..12.0);
        let level = rng.random_range(5.0..12.0);
        let mut x = -rng.random_range(0.0..period);
        while x < LENGTH_M {
            let (width, depth, height) = match kind {
                Kind::Bare | Kind::Sparse => (LENGTH_M, 0.0, level),
                Kind::Periodic => (period, 0.0, level),
                Kind::Fronts | Kind::Dense => {
                    (rng.random_range(4.0..14.0), rng.random_range(0.0..1.5), level + rng.random_range(-2.0..3.0))
                }
            };
            let gap = matches!(kind, Kind::Dense) && rng.random_range(0.0..1.0) < 0.15;
            if !gap {
                self.wall(x, x + width, side, half + depth, height);
            }
            if matches!(kind, Kind::Periodic) {
                // A porch a house, at the same place of each.
                self.wall(x + 0.2 * period, x + 0.2 * period + 1.2, side, half - 0.5, 2.6);
            }
            x += width;
        }
    }

    fn wall(&mut self, from: f64, to: f64, side: f64, at: f64, height: f64) {
        let (near, far) = (side * at, side * (at + 6.0));
        self.blocks
            .push(Block { min: Vector3::new(from, near.min(far), 0.0), max: Vector3::new(to, near.max(far), height) });
    }

    /// Posts, parked cars and trees on one side.
    fn things(&mut self, kind: Kind, side: f64, half: f64, rng: &mut ChaCha8Rng) {
        let (posts, cars, trees) = match kind {
            Kind::Bare => (0, 0, 0),
            Kind::Sparse => (rng.random_range(2..8), rng.random_range(0..6), 0),
            Kind::Periodic | Kind::Fronts => (0, rng.random_range(0..8), 0),
            Kind::Dense => (rng.random_range(4..10), rng.random_range(5..20), rng.random_range(0..15)),
        };
        for _ in 0..posts {
            let (x, radius, top) = (rng.random_range(0.0..LENGTH_M), rng.random_range(0.06..0.15), 6.0);
            self.posts.push(Post { x, y: side * (half - 1.0), radius, top });
        }
        if matches!(kind, Kind::Periodic) {
            let (apart, from) = (rng.random_range(10.0..25.0), rng.random_range(0.0..10.0));
            (0..20).for_each(|k| {
                self.posts.push(Post { x: from + apart * f64::from(k), y: side * (half - 1.0), radius: 0.1, top: 6.0 });
            });
        }
        for _ in 0..cars {
            self.blocks.extend(car(rng.random_range(0.0..LENGTH_M), side * (half - 2.6), rng));
        }
        for _ in 0..trees {
            let (x, y) = (rng.random_range(0.0..LENGTH_M), side * (half - 1.0));
            self.posts.push(Post { x, y, radius: rng.random_range(0.1..0.3), top: 4.0 });
            let center = Vector3::new(x, y, rng.random_range(4.0..6.0));
            self.crowns.push(Crown { center, radius: rng.random_range(1.2..2.5) });
        }
    }

    /// Distance of what a ray of unit direction meets first; `through` says whether it passes leaves.
    fn cast(&self, o: &Vector3<f64>, d: &Vector3<f64>, through: bool, limit: f64) -> Option<f64> {
        let mut best = limit;
        if d.z < 0.0 {
            best = best.min(-o.z / d.z);
        }
        self.blocks.iter().filter_map(|b| b.cast(o, d)).for_each(|t| best = best.min(t));
        self.posts.iter().filter_map(|p| p.cast(o, d)).for_each(|t| best = best.min(t));
        if !through {
            self.crowns.iter().filter_map(|c| c.cast(o, d)).for_each(|t| best = best.min(t));
        }
        (best < limit).then_some(best)
    }

    /// What is within reach of a place.
    fn around(&self, x: f64, reach: f64) -> Self {
        let near = |from: f64, to: f64| from < x + reach && to > x - reach;
        Self {
            blocks: self.blocks.iter().copied().filter(|b| near(b.min.x, b.max.x)).collect(),
            posts: self.posts.iter().copied().filter(|p| near(p.x, p.x)).collect(),
            crowns: self.crowns.iter().copied().filter(|c| near(c.center.x, c.center.x)).collect(),
        }
    }
}

/// A body and a cabin.
fn car(x: f64, y: f64, rng: &mut ChaCha8Rng) -> [Block; 2] {
    let (length, width, height) = (rng.random_range(3.6..5.2), rng.random_range(1.6..2.0), rng.random_range(1.35..2.1));
    let block = |from: f64, to: f64, low: f64, high: f64| Block {
        min: Vector3::new(x + from, y - 0.5 * width, low),
        max: Vector3::new(x + to, y + 0.5 * width, high),
    };
    [block(0.0, length, 0.2, 0.6 * height), block(0.2 * length, 0.75 * length, 0.6 * height, height)]
}

impl Block {
    fn cast(&self, o: &Vector3<f64>, d: &Vector3<f64>) -> Option<f64> {
        let (mut enter, mut leave) = (0.0f64, f64::INFINITY);
        for k in 0..3 {
            let (a, b) = ((self.min[k] - o[k]) / d[k], (self.max[k] - o[k]) / d[k]);
            (enter, leave) = (enter.max(a.min(b)), leave.min(a.max(b)));
        }
        (enter < leave && enter > 0.0).then_some(enter)
    }
}

impl Post {
    fn cast(&self, o: &Vector3<f64>, d: &Vector3<f64>) -> Option<f64> {
        let (x, y) = (o.x - self.x, o.y - self.y);
        let (a, b, c) = (d.x * d.x + d.y * d.y, x * d.x + y * d.y, x * x + y * y - self.radius * self.radius);
        let root = b * b - a * c;
        let t = (-b - root.max(0.0).sqrt()) / a.max(1e-12);
        (root > 0.0 && t > 0.0 && (0.0..self.top).contains(&(o.z + t * d.z))).then_some(t)
    }
}

impl Crown {
    fn cast(&self, o: &Vector3<f64>, d: &Vector3<f64>) -> Option<f64> {
        let from = o - self.center;
        let b = from.dot(d);
        let root = b * b - from.norm_squared() + self.radius * self.radius;
        let t = -b - root.max(0.0).sqrt();
        (root > 0.0 && t > 0.0).then_some(t)
    }
}

/// What is seen along a stretch that begins at `start`, in the frame of its first scan, thinned.
fn drive(street: &Street, start: &Pose, range: f64, seed: u64) -> Result<PointCloud, Failure> {
    let scans = (STRETCH_M / STEP_M) as usize + 1;
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    // Traffic: what drives is somewhere else in every scan.
    let traffic: Vec<(f64, f64, u64)> = (0..rng.random_range(0..3))
        .map(|_| (rng.random_range(-30.0..30.0), rng.random_range(-3.0..3.0), rng.random_range(0..1000)))
        .collect();
    let mut points = Vec::new();
    for k in 0..scans {
        let o = (start * Point3::new(STEP_M * k as f64, 0.0, HEIGHT_M)).coords;
        let mut near = street.around(o.x, range);
        for &(from, speed, shape) in &traffic {
            let (x, lane) = (start.translation.x + from + 1.5 * speed * k as f64, if speed > 0.0 { -2.5 } else { 1.0 });
            near.blocks.extend(car(x, lane, &mut ChaCha8Rng::seed_from_u64(shape)));
        }
        let column = |c: usize| -> Vec<Point3<f32>> {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            rng.set_stream((1 + k * COLUMNS + c) as u64);
            let noise = Normal::new(0.0, NOISE_M).ok();
            let azimuth = TAU * (c as f64 + rng.random_range(0.0..1.0)) / COLUMNS as f64;
            let ray = |r: usize| {
                let elevation = ELEVATION.0 + (ELEVATION.1 - ELEVATION.0) * r as f64 / (RINGS - 1) as f64;
                let flat = elevation.cos();
                let d = Vector3::new(flat * azimuth.cos(), flat * azimuth.sin(), elevation.sin());
                let through = rng.random_range(0.0..1.0) < 0.5;
                let t = near.cast(&o, &d, through, range)? + noise.map_or(0.0, |n| n.sample(&mut rng));
                Some((start.inverse() * Point3::from(o + d * t)).cast())
            };
            (0..RINGS).filter_map(ray).collect()
        };
        points.extend((0..COLUMNS).into_par_iter().map(column).collect::<Vec<_>>().into_iter().flatten());
    }
    Ok(voxel_downsample(&PointCloud::from_positions(points), VOXEL_M)?)
}

/// Pair number `index` of a seed: two stretches of one street, 0.1 to 0.5 of the smaller cloud in common.
///
/// # Errors
/// If no two stretches have that.
pub(super) fn pair(seed: u64, index: usize) -> Result<Pair, Failure> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(index as u64);
    let kind = KINDS[index % KINDS.len()];
    let mut street = Street::random(kind, &mut rng);
    let range = rng.random_range(18.0..35.0);
    for _ in 0..TRIES {
        let there = rng.random_range(45.0..90.0);
        let back = rng.random_range(0..2) == 0;
        let apart = rng.random_range(5.0..STRETCH_M + 2.0 * range);
        let start = |x: f64, turned: bool, y: f64| {
            let heading = if turned { PI } else { 0.0 };
            let at = Translation3::new(if turned { x + STRETCH_M } else { x }, y, 0.0);
            Pose::from_parts(at, UnitQuaternion::from_axis_angle(&Vector3::z_axis(), heading))
        };
        let (first, second) = (start(there, false, -1.5), start(there + apart, back, if back { 1.5 } else { -1.5 }));
        let target = drive(&street, &first, range, rng.random_range(0..u64::MAX))?;
        // Between the visits some cars have gone and others come.
        let changes = rng.random_range(0.0..0.4);
        let mut later = street.clone();
        later.blocks.retain(|b| b.max.z > 2.2 || b.max.x - b.min.x > 6.0 || rng.random_range(0.0..1.0) > changes);
        let source = drive(&later, &second, range, rng.random_range(0..u64::MAX))?;
        let t_target_source = first.inverse() * second;
        let share = overlap_of_smaller(&target.positions, &source.transformed(&t_target_source).positions);
        if OVERLAP.contains(&share) {
            let name = format!("street {index}: {kind:?}");
            return Ok(Pair { name, source, target, t_target_source, overlap: share });
        }
        street = Street::random(kind, &mut rng);
    }
    Err(format!("no stretches of a street with an overlap of {OVERLAP:?}").into())
}
