//! Given space as a lidar in space sees it.

use super::space::{Beam, Bits, GivenSpace, Ground, Open};
use super::{GIVEN_SENSOR, GivenOptions, GivenView, GivenViews, rest, view};
use crate::MappingError;
use crate::blocks::{BlockKey, locate};
use nalgebra::{Point3, Vector3};
use percept_geometry::{Cell, PointCloud, Voxel};
use rayon::prelude::*;
use rustc_hash::{FxHashMap, FxHashSet};
use std::f64::consts::TAU;

/// Beams of a view: rings between these elevations, and azimuths. As a lidar of 64 rings that looks all around.
const RINGS: usize = 64;
const ELEVATION_RAD: (f64, f64) = (-0.8, 0.8);
const AZIMUTHS: usize = 720;
/// Beside a voxel's centre, in voxels, so that no beam runs along an edge.
const ASIDE: Vector3<f64> = Vector3::new(0.13, 0.07, 0.03);

/// What is nearer than this is not looked at, metres: layers leave it out (`range_min_m`).
const NEAREST_M: f64 = 0.1;
/// From a voxel's centre to where it is met on a side, in voxels: a little inside.
const SIDE: f64 = 0.45;

/// Voxels that are looked at one by one in a pass, at most: they take some 40 bytes each meanwhile.
const MOST_REST: usize = 2_000_000;

/// What is seen from a place.
#[derive(Debug, Default)]
pub(super) struct Look {
    /// Where from, metres in the given map.
    pub(super) eye: Point3<f64>,
    /// Of the ground below, metres.
    ground_z: f64,
    /// Occupied voxels that are seen, each with where it was met if that is not its centre.
    pub(super) hits: FxHashMap<Voxel, Option<Point3<f64>>>,
    /// Ends of beams that meet nothing.
    misses: Vec<Point3<f64>>,
    /// Voxels known to be free that its beams pass.
    pub(super) passed: FxHashMap<BlockKey, Bits>,
    /// What is said by whom: see [`GIVEN_SENSOR`].
    sensor: &'static str,
}

impl Look {
    /// From a voxel over the ground; none where there is no ground below it.
    pub(super) fn from(space: &GivenSpace, ground: &Ground, at: Voxel, sensor: &'static str) -> Option<Self> {
        let eye = at.center(space.voxel_m) + ASIDE * space.voxel_m;
        let ground_z = f64::from(ground.get(&Cell::new(at.x, at.y)).filter(|z| **z < at.z)? + 1) * space.voxel_m;
        Some(Self { eye, ground_z, sensor, ..Self::default() })
    }

    /// As a lidar looks all around.
    fn around(mut self, space: &GivenSpace, range_max_m: f64) -> Self {
        let is_known = matches!(space.open, Open::Only(_));
        for ring in 0..RINGS {
            let share = (ring as f64 + 0.5) / RINGS as f64;
            let elevation = ELEVATION_RAD.0 + (ELEVATION_RAD.1 - ELEVATION_RAD.0) * share;
            for k in 0..AZIMUTHS {
                let azimuth = (k as f64 + 0.5) / AZIMUTHS as f64 * TAU;
                let (level, rise) = (elevation.cos(), elevation.sin());
                let direction = Vector3::new(azimuth.cos() * level, azimuth.sin() * level, rise);
                match space.walk(&self.eye, &direction, range_max_m, |_, _| {}) {
                    Beam::Ends(voxel) if is_known => _ = self.hits.contains_key(&voxel) || self.look_at(space, voxel),
                    Beam::Ends(voxel) => _ = self.hits.insert(voxel, None),
                    Beam::Open if is_known => {
                        let passed = &mut self.passed;
                        space.walk(&self.eye, &direction, range_max_m, |block, slot| note(passed, block, slot));
                        self.misses.push(self.eye + direction * range_max_m);
                    }
                    _ => {}
                }
            }
        }
        self
    }

    /// Along one beam to a voxel's centre, or to a side that faces the eye: whether it is seen. A floor's centres are seen from right above
    /// alone.
    pub(super) fn look_at(&mut self, space: &GivenSpace, voxel: Voxel) -> bool {
        let center = voxel.center(space.voxel_m);
        let is_open = space.is_open(voxel);
        if (center - self.eye).norm() <= NEAREST_M + space.voxel_m && !is_open {
            return false;
        }
        let side = |axis: usize| {
            let mut out = center;
            out[axis] += SIDE * space.voxel_m * (self.eye[axis] - center[axis]).signum();
            out
        };
        let aims = [center, side(2), side(0), side(1)];
        let mut along = vec![];
        for (k, aim) in aims.iter().enumerate().take(if is_open { 1 } else { aims.len() }) {
            let (way, distance) = (aim - self.eye, (aim - self.eye).norm());
            along.clear();
            let beam = space.walk(&self.eye, &(way / distance), distance, |block, slot| along.push((block, slot)));
            match beam {
                Beam::Ends(met) if met == voxel => _ = self.hits.insert(voxel, (k > 0).then_some(*aim)),
                Beam::Open if is_open => self.misses.push(center),
                _ => continue,
            }
            if matches!(space.open, Open::Only(_)) {
                along.into_iter().for_each(|(block, slot)| note(&mut self.passed, block, slot));
            }
            return true;
        }
        false
    }

    pub(super) fn has_passed(&self, voxel: Voxel) -> bool {
        is_noted(&self.passed, voxel)
    }

    fn into_view(self, space: &GivenSpace, options: &GivenOptions) -> GivenView {
        let mut hits: Vec<(Voxel, Option<Point3<f64>>)> = self.hits.into_iter().collect();
        hits.sort_unstable_by_key(|hit| hit.0);
        let base = Point3::new(self.eye.x, self.eye.y, self.ground_z);
        let in_base = |p: &Point3<f64>| Point3::from(p - base).cast::<f32>();
        let hits = match space.open {
            Open::Only(_) => {
                let met = hits.iter().map(|(voxel, at)| at.unwrap_or_else(|| voxel.center(space.voxel_m)));
                PointCloud::from_positions(met.map(|p| in_base(&p)).collect())
            }
            Open::AllBut(_) => {
                let points = hits.iter().filter_map(|(voxel, _)| space.occupied.get(voxel)).flatten();
                let mut seen: Vec<usize> = points.map(|k| *k as usize).collect();
                seen.sort_unstable();
                let mut hits = space.points.select(&seen);
                hits.positions.iter_mut().for_each(|p| *p = in_base(&p.cast()));
                hits
            }
        };
        let options = GivenOptions { sensor_height_m: self.eye.z - self.ground_z, ..*options };
        view(base, &options, self.sensor, false, (hits, self.misses))
    }
}

/// Whether a voxel is among those.
fn is_noted(passed: &FxHashMap<BlockKey, Bits>, voxel: Voxel) -> bool {
    let (block, slot) = locate(voxel);
    passed.get(&block).is_some_and(|bits| bits[usize::from(slot / 64)] >> (slot % 64) & 1 == 1)
}

fn note(passed: &mut FxHashMap<BlockKey, Bits>, block: BlockKey, slot: u16) {
    passed.entry(block).or_default()[usize::from(slot / 64)] |= 1 << (slot % 64);
}

/// What is known of a space, and what of that views show.
#[derive(Debug)]
pub(super) struct Shown<'a> {
    space: &'a GivenSpace,
    hits: FxHashSet<Voxel>,
    passed: FxHashMap<BlockKey, Bits>,
}

impl<'a> Shown<'a> {
    pub(super) fn by(space: &'a GivenSpace, looks: &[Look]) -> Self {
        let mut out = Self { space, hits: FxHashSet::default(), passed: FxHashMap::default() };
        looks.iter().for_each(|look| out.add(look));
        out
    }

    pub(super) fn add(&mut self, look: &Look) {
        self.hits.extend(look.hits.keys());
        for (block, bits) in &look.passed {
            let all = self.passed.entry(*block).or_default();
            all.iter_mut().zip(bits).for_each(|(a, b)| *a |= b);
        }
    }

    pub(super) fn is_passed(&self, voxel: Voxel) -> bool {
        is_noted(&self.passed, voxel)
    }

    /// Voxels that are not shown, in order, so many at most; those that are known to be free among them.
    pub(super) fn rest(&self) -> Vec<Voxel> {
        let hidden = self.space.occupied.keys().copied().filter(|v| !self.hits.contains(v));
        let mut rest: Vec<Voxel> =
            self.space.free().filter(|v| !self.is_passed(*v)).chain(hidden).take(MOST_REST).collect();
        rest.sort_unstable();
        rest
    }

    /// Shares of what is occupied, point by point, and of what is free.
    fn shares(&self) -> (f64, f64) {
        let points = |v: &Voxel| self.space.occupied.get(v).map_or(0, Vec::len);
        let seen: usize = self.hits.iter().map(points).sum();
        let of = |seen: usize, all: usize| if all == 0 { 1.0 } else { seen as f64 / all as f64 };
        let (num_free, num_passed) =
            self.space.free().fold((0, 0), |(all, seen), v| (all + 1, seen + usize::from(self.is_passed(v))));
        (of(seen, self.space.points.len()), of(num_passed, num_free))
    }
}

/// Views of occupied space by a lidar in space, level, over the ground, and then of what its pattern leaves out, voxel by voxel: what of
/// it is seen from there, point by point. Where voxels are known to be free, beams go through these alone: what the views show is
/// what was given.
///
/// # Errors
/// `NothingFree` if there is no room over any ground: there is no place to look from.
pub fn views_of_space(space: &GivenSpace, options: &GivenOptions) -> Result<GivenViews, MappingError> {
    let ground = space.ground(options);
    let places = space.places(&ground, options);
    let mut looks: Vec<Look> = (places.par_iter())
        .filter_map(|at| Look::from(space, &ground, *at, GIVEN_SENSOR))
        .map(|look| look.around(space, options.range_max_m))
        .collect();
    if looks.is_empty() {
        return Err(MappingError::NothingFree);
    }
    let mut shown = Shown::by(space, &looks);
    rest::look_at_rest(space, &ground, options, &mut looks, &mut shown);
    let (occupied_share, free_share) = shown.shares();
    let views = looks.into_par_iter().map(|look| look.into_view(space, options));
    let views = views.filter(|v| !v.scan.hits.is_empty() || !v.scan.misses.is_empty()).collect();
    Ok(GivenViews { views, occupied_share, free_share })
}
