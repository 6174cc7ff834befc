//! The ground around a sensor as one scan shows it: uneven, seen in rings, hidden behind what stands on it.
//!
//! From where the robot stands ground is followed outward, patch by patch: what is as high as the ground before it goes on is
//! ground, and how far off it may be grows with the gap to the nearest ground that was seen. So ramps, cambered streets and a
//! floor behind a door are ground; a kerb, a table top and a bonnet are not.
//!
//! Source: followed along rays as in Himmelsbach, von Hundelshausen and Wuensche, "Fast segmentation of 3D point clouds for
//! ground vehicles", 2010; the neighbouring rays speak as well here, and doubt grows with distance.

use crate::angles::atan2;
use nalgebra::{Point3, Vector2, Vector3};
use std::f64::consts::{PI, TAU};

/// Patches around a sensor: so many directions, and rings of so many metres that grow with range from where this share of it is more.
/// A lidar of 64 rings at 1.7 m height meets flat ground every 0.2 m at 7 m, and has 20 points in a patch there.
const SECTORS: usize = 180;
const RING_M: f64 = 0.2;
const RING_SHARE: f64 = 0.03;
/// Sectors to either side whose ground tells how high it is here.
const BESIDE: usize = 3;
/// Points this near to a patch's lowest are its ground, metres: noise of depth cameras and lidars, and a slope of 0.3 over a ring.
const THICK_M: f64 = 0.1;
/// What ground may be off from how the ground before it goes on, metres; and more for each metre between them. Kerbs are higher than
/// the first; streets and ramps for wheelchairs bend by less than the second, which is also what ramps in buildings rise by.
const ROUGH_M: f64 = 0.05;
const BENDS: f64 = 0.1;
/// Where no ground was seen what stands on it is measured from where it ought to be, which is in doubt by this share of that: what is
/// flat and within all of it is ground.
const UNSEEN: f64 = 0.5;
/// No patch is in greater doubt, metres.
const MAX_DOUBT_M: f64 = 1.0;
/// What seen ground is in doubt by for each metre of range: sideways slope within a patch.
const DOUBT_BY_RANGE: f64 = 0.002;
/// Ground rises and falls by no more.
const MAX_SLOPE: f64 = 0.35;
/// A base that leans by less is level.
const LEVEL: f64 = 0.02;
/// A slope is told by ground that is so far apart, metres, or so much of the range.
const SLOPE_OVER: (f64, f64) = (1.0, 0.15);
/// A patch that is so much lower, metres, and all of it, steeper than ground falls, is a drop: stairs, a ditch, a ramp's side.
const LOWER_M: f64 = 0.2;
/// Points that say so at least: single ones are mirrored beams.
const LOWER_POINTS: u32 = 3;

/// Of which returns the ground is made.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct GroundParams {
    /// Returns nearer to the sensor than this, or farther, are none, horizontally, metres.
    pub(crate) range_min_m: f64,
    pub(crate) range_max_m: f64,
    /// What is this far above the lowest around hangs over it, metres.
    pub(crate) clearance_m: f64,
}

/// The ground of a scan, in the map's frame.
pub(crate) struct Ground {
    /// The ring of each tenth of [`RING_M`] of range, and how many there are.
    ring_at: Vec<u16>,
    rings: usize,
    /// Ring by ring.
    patches: Vec<Patch>,
    /// One a point.
    places: Vec<Place>,
}

/// Where a point lies as the sensor sees it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Place {
    /// Radians, from -pi to pi.
    pub(crate) azimuth: f32,
    /// Horizontally, metres; NaN of a point that is not finite.
    pub(crate) range: f32,
    patch: u32,
}

impl Place {
    /// Of a point that is no return.
    pub(crate) fn of(sensor: &Point3<f64>, p: &Point3<f64>) -> Self {
        let d = p - sensor;
        let range = if p.z.is_finite() { d.xy().norm() as f32 } else { f32::NAN };
        Self { azimuth: atan2(d.y as f32, d.x as f32), range, patch: NO_PATCH }
    }
}

/// Of a point that lies in no patch.
const NO_PATCH: u32 = u32::MAX;

/// What is known of the ground in a patch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Patch {
    /// Height, and the range at which it is that, metres; how it goes on outward.
    z: f64,
    range: f64,
    pub(crate) slope: f64,
    /// What it may be off by, metres.
    pub(crate) doubt: f64,
    /// Whether ground was seen there.
    pub(crate) is_seen: bool,
    /// Whether there is none where it ought to be.
    pub(crate) is_drop: bool,
}

impl Patch {
    /// Height of the ground at a range, metres.
    pub(crate) fn z_at(&self, range: f64) -> f64 {
        self.z + self.slope * (range - self.range)
    }
}

/// What was seen in a patch.
#[derive(Clone, Copy)]
struct Seen {
    lowest: f32,
    second: f32,
    highest: f32,
    num: u32,
    /// Sums over the points at its foot.
    foot: u32,
    sum_z: f64,
    sum_range: f64,
}

impl Seen {
    const NOTHING: Self = Self {
        lowest: f32::INFINITY,
        second: f32::INFINITY,
        highest: f32::NEG_INFINITY,
        num: 0,
        foot: 0,
        sum_z: 0.0,
        sum_range: 0.0,
    };

    fn add(&mut self, z: f32) {
        (self.lowest, self.second) = (self.lowest.min(z), self.second.min(z.max(self.lowest)));
        self.num += 1;
    }

    /// The height of its foot: a single point below many others is a mirrored beam.
    fn low(&self) -> f32 {
        if self.num >= 5 { self.second } else { self.lowest }
    }
}

/// Ground along a sector, from the sensor outward: range and height, metres.
#[derive(Clone)]
struct Ray(Vec<(f64, f64)>);

impl Ray {
    fn last(&self) -> (f64, f64) {
        self.0.last().copied().unwrap_or_default()
    }

    /// How it rises outward; none if too little is known.
    fn slope(&self) -> Option<f64> {
        let (range, z) = self.last();
        let over = SLOPE_OVER.0.max(SLOPE_OVER.1 * range);
        let before = self.0.iter().rev().find(|(r, _)| range - r >= over).or(self.0.first());
        before.filter(|(r, _)| range - r > 0.5 * over).map(|(r, then)| (z - then) / (range - r))
    }
}

impl Ground {
    /// Of points in the map's frame, seen from `sensor` by a robot that stands at height `floor_z` (m) below it, its base upright
    /// along `up`. Who stands on a slope leans with it, and who holds a sensor in the hand as he likes: so ground goes on from there
    /// level or as base lies, whichever it is followed farther by.
    pub(crate) fn new(
        params: &GroundParams,
        sensor: &Point3<f64>,
        (floor_z, up): (f64, &Vector3<f64>),
        points: &[Point3<f64>],
    ) -> Self {
        let farthest = points.iter().map(|p| (p - sensor).xy().norm()).filter(|r| r.is_finite()).fold(0.0, f64::max);
        let rings = ring_of(farthest.min(params.range_max_m)) + 1;
        let (places, seen) = look(sensor, rings, params, points);
        let level = follow(&seen, rings, floor_z, &Vector2::zeros());
        let rise = -up.xy() / up.z.max(1e-3);
        let leans = (LEVEL..MAX_SLOPE).contains(&rise.norm()).then(|| follow(&seen, rings, floor_z, &rise));
        let num = |patches: &[Patch]| patches.iter().filter(|p| p.is_seen).count();
        let patches = leans.filter(|p| num(p) > num(&level)).unwrap_or(level);
        let ring_at = (0..).map(|i| ring_of((f64::from(i) + 0.5) * 0.1 * RING_M)).take_while(|ring| *ring < rings);
        Self { ring_at: ring_at.map(|ring| ring as u16).collect(), rings, patches, places }
    }

    /// The ground in a direction (radians, from -pi to pi) at a range, metres; beyond what was seen, as the last of it goes on.
    pub(crate) fn at(&self, azimuth: f64, range: f64) -> &Patch {
        &self.patches[self.ring_at(range) * SECTORS + sector_of(azimuth)]
    }

    /// The patches of a sector, ring by ring.
    pub(crate) fn along(&self, sector: usize) -> impl Iterator<Item = &Patch> {
        self.patches.iter().skip(sector).step_by(SECTORS)
    }

    /// The ring at a range, metres; the last one beyond what was seen.
    #[inline]
    pub(crate) fn ring_at(&self, range: f64) -> usize {
        self.ring_at.get((range * (10.0 / RING_M)) as usize).map_or(self.rings - 1, |ring| usize::from(*ring))
    }
}

impl Ground {
    /// Where each point lies.
    pub(crate) fn places(&self) -> &[Place] {
        &self.places
    }

    /// The ground where a point lies; none of one out of range.
    pub(crate) fn under(&self, place: &Place) -> Option<&Patch> {
        self.patches.get(place.patch as usize)
    }
}

/// The sector of a direction, radians, from -pi to pi.
pub(crate) fn sector_of(azimuth: f64) -> usize {
    (((azimuth + PI) / TAU * SECTORS as f64) as usize).min(SECTORS - 1)
}

fn ring_of(range: f64) -> usize {
    let even = RING_M / RING_SHARE;
    let rings =
        if range < even { range / RING_M } else { even / RING_M + (range / even).ln() / (1.0 + RING_SHARE).ln() };
    rings.max(0.0) as usize
}

/// The middle of a ring, metres.
fn middle_of(ring: usize) -> f64 {
    let (even, ring) = (RING_M / RING_SHARE, ring as f64 + 0.5);
    let rest = ring - even / RING_M;
    if rest < 0.0 { ring * RING_M } else { even * (1.0 + RING_SHARE).powf(rest) }
}

fn look(sensor: &Point3<f64>, rings: usize, params: &GroundParams, points: &[Point3<f64>]) -> (Vec<Place>, Vec<Seen>) {
    let mut seen = vec![Seen::NOTHING; rings * SECTORS];
    let place = |p: &Point3<f64>| {
        let d = p - sensor;
        let (range, azimuth) = (d.xy().norm(), atan2(d.y as f32, d.x as f32));
        let is_near = range >= params.range_min_m && range <= params.range_max_m && p.z.is_finite();
        let patch = if is_near { ring_of(range) * SECTORS + sector_of(azimuth.into()) } else { seen.len() };
        let patch = if patch < seen.len() { patch as u32 } else { NO_PATCH };
        let range = if p.z.is_finite() { range as f32 } else { f32::NAN };
        Place { azimuth, range, patch }
    };
    let places: Vec<Place> = points.iter().map(place).collect();
    let within = || points.iter().zip(&places).filter(|(_, place)| place.patch != NO_PATCH);
    within().for_each(|(p, place)| seen[place.patch as usize].add(p.z as f32));
    for (p, Place { range, patch, .. }) in within() {
        let seen = &mut seen[*patch as usize];
        let above = p.z as f32 - seen.low();
        if above.abs() <= THICK_M as f32 {
            seen.foot += 1;
            seen.sum_z += p.z;
            seen.sum_range += f64::from(*range);
        }
        if above <= params.clearance_m as f32 {
            seen.highest = seen.highest.max(p.z as f32);
        }
    }
    (places, seen)
}

/// The ground, ring by ring, from a height and how it rises along x and y there.
fn follow(seen: &[Seen], rings: usize, floor_z: f64, rise: &Vector2<f64>) -> Vec<Patch> {
    let mut rays = vec![Ray(vec![(0.0, floor_z)]); SECTORS];
    let towards = |sector: usize| ((sector as f64 + 0.5) * TAU / SECTORS as f64 - PI).sin_cos();
    let mut slopes: Vec<f64> = (0..SECTORS).map(towards).map(|(sin, cos)| rise.x * cos + rise.y * sin).collect();
    let mut patches = Vec::with_capacity(rings * SECTORS);
    for ring in 0..rings {
        let found: Vec<Patch> =
            (0..SECTORS).map(|sector| patch(&rays, &slopes, ring, sector, &seen[ring * SECTORS + sector])).collect();
        for (sector, patch) in found.iter().enumerate().filter(|(_, p)| p.is_seen) {
            rays[sector].0.push((patch.range, patch.z));
            slopes[sector] = rays[sector].slope().unwrap_or(slopes[sector]).clamp(-MAX_SLOPE, MAX_SLOPE);
        }
        patches.extend(found);
    }
    patches
}

/// What a patch is, by what was seen in it and by the ground before it.
fn patch(rays: &[Ray], slopes: &[f64], ring: usize, sector: usize, seen: &Seen) -> Patch {
    let (mut range, mut z) = (middle_of(ring), f64::NAN);
    if seen.foot > 0 {
        let num = f64::from(seen.foot);
        (range, z) = (seen.sum_range / num, seen.sum_z / num);
    }
    // The nearest ground that was seen before.
    let beside = |i: usize| {
        let other = (sector + SECTORS + i - BESIDE) % SECTORS;
        let (along, across) = (range - rays[other].last().0, (i as f64 - BESIDE as f64) * TAU / SECTORS as f64 * range);
        (along * along + across * across, other)
    };
    let nearest = (0..=2 * BESIDE).map(beside).min_by(|a, b| a.0.total_cmp(&b.0));
    let (gap, before) = nearest.map_or((range, sector), |(square, other)| (square.sqrt(), other));
    let ((last, height), slope) = (rays[before].last(), slopes[before]);
    let expected = height + slope * (range - last);
    let doubt = (BENDS * gap).min(MAX_DOUBT_M);
    let above = z - expected;
    // What is off by much has to be flat.
    let is_flat = f64::from(seen.highest - seen.low()) <= 2.0 * THICK_M;
    let is_ground = above.abs() <= ROUGH_M + doubt && (above.abs() <= 2.0 * ROUGH_M || is_flat);
    if is_ground {
        return Patch { z, range, slope, doubt: DOUBT_BY_RANGE * range, is_seen: true, is_drop: false };
    }
    let is_below = f64::from(seen.highest) < expected - LOWER_M - doubt && seen.num >= LOWER_POINTS;
    let is_drop = is_below && before == sector && -above > MAX_SLOPE * (range - last);
    Patch { z: expected, range, slope, doubt: UNSEEN * doubt, is_seen: false, is_drop }
}
