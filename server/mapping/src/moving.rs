//! Which points of a frame belong to what moves: frames of the last seconds saw through where they are.
//!
//! After Pomerleau et al., "Long-term 3D map maintenance in dynamic environments", ICRA 2014, who compare a scan with the map
//! along its beams. Ours compares it with the frames just before, whose poses drift by nothing, and asks the neighbours of each point:
//! a beam that passes by a chair's leg says little.

use crate::cloud::range_image::Ranges;
use percept_geometry::{KeyframeScan, Pose, Voxel};
use rustc_hash::{FxHashMap, FxHashSet};

/// Points within a cube of this edge move together, metres: a third of a person's height, less than from a person to the wall.
const TOGETHER_M: f64 = 0.3;
/// How far a surface must lie behind a point for that to be seen through, metres and a share of the range: as what the cloud is carved by
/// (`CloudParams::carve_margin_m`, two voxels, `carve_margin_ratio`).
const BEHIND: (f64, f64) = (0.25, 0.05);
/// What moves has so many points, in cubes beside each other: fewer are what a pose or a beam's width makes of edges.
const LEAST_POINTS: u32 = 12;
/// More of a frame than this does not move: its pose is wrong, or all that it sees is one thing.
const MOST: f64 = 0.5;

/// What a frame saw, for those that follow.
#[derive(Debug, Clone)]
pub struct Sight(Ranges);

impl Sight {
    /// Of a scan taken at `t_odom_base`.
    pub fn new(t_odom_base: &Pose, scan: &KeyframeScan) -> Self {
        let sensor = (t_odom_base * scan.t_base_sensor).translation.vector.into();
        let ends = scan.hits.positions.iter().chain(&scan.misses).map(|p| t_odom_base * p.cast::<f64>());
        Self(Ranges::new(sensor, ends))
    }
}

/// Which returns of a scan taken at `t_odom_base` belong to what moves, as `earlier` frames have it: a flag each. None of a planar scan,
/// whose beams pass under tables and over feet.
pub fn moving(earlier: &[&Sight], t_odom_base: &Pose, scan: &KeyframeScan) -> Vec<bool> {
    let hits = &scan.hits.positions;
    let mut out = vec![false; hits.len()];
    if scan.planar || earlier.is_empty() {
        return out;
    }
    // By cube: points that were seen through, and points that were there.
    let mut cubes: FxHashMap<Voxel, (u32, u32)> = FxHashMap::default();
    let cube = |i: usize| Voxel::containing(&(t_odom_base * hits[i].cast::<f64>()), TOGETHER_M);
    for (i, p) in hits.iter().enumerate() {
        let p = t_odom_base * p.cast::<f64>();
        let (mut through, mut there) = (0u32, 0u32);
        for sight in earlier {
            match sight.0.looks_at(&p, BEHIND) {
                Some(true) => through += 1,
                Some(false) => there += 1,
                None => {}
            }
        }
        if let Some(voxel) = cube(i).filter(|_| through + there > 0) {
            let counts = cubes.entry(voxel).or_default();
            if through > 2 * there { counts.0 += 1 } else { counts.1 += 1 }
        }
    }
    cubes.retain(|_, counts| counts.0 >= 2 && counts.0 > 2 * counts.1);
    let things = things(&cubes);
    for (i, moves) in out.iter_mut().enumerate() {
        *moves = cube(i).is_some_and(|voxel| things.contains(&voxel));
    }
    if out.iter().filter(|m| **m).count() as f64 > MOST * hits.len() as f64 {
        out.fill(false);
    }
    out
}

/// The cubes of those that have points enough together with the cubes beside them.
fn things(cubes: &FxHashMap<Voxel, (u32, u32)>) -> FxHashSet<Voxel> {
    let (mut taken, mut out) = (FxHashSet::default(), FxHashSet::default());
    for first in cubes.keys() {
        if !taken.insert(*first) {
            continue;
        }
        let (mut thing, mut next, mut points) = (vec![*first], 0, 0);
        while let Some(at) = thing.get(next).copied() {
            next += 1;
            points += cubes[&at].0;
            for k in 0..27 {
                let beside = Voxel::new(at.x + k % 3 - 1, at.y + k / 3 % 3 - 1, at.z + k / 9 - 1);
                if cubes.contains_key(&beside) && taken.insert(beside) {
                    thing.push(beside);
                }
            }
        }
        if points >= LEAST_POINTS {
            out.extend(thing);
        }
    }
    out
}
