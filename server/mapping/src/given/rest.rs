//! What a lidar's pattern leaves out of a given space: single voxels between its beams, and corners that it does not see into from
//! where a robot stands.

use super::look::{Look, Shown};
use super::space::{GivenSpace, Ground, MOST_VIEWS, Open};
use super::{GIVEN_REST_SENSOR, GivenOptions};
use nalgebra::Point3;
use percept_geometry::{Cell, Voxel};
use rayon::prelude::*;
use rustc_hash::FxHashMap;
use std::collections::BTreeMap;

/// A voxel is looked at from so many of the nearest places at most.
const NEAREST: usize = 4;
/// Voxels in columns of this edge have the same nearest places, voxels.
const COLUMN: i32 = 8;
/// What is still not seen is looked at from within: from a voxel in each cube of this edge (metres), so often at most. What lies in one
/// cube is seen from one place of it as a rule; corners need a few.
const CUBE_M: f64 = 1.0;
const ROUNDS: usize = 6;
/// Cubes do not grow beyond so many voxels along an edge.
const LARGEST_CUBE: i32 = 1 << 16;

/// Adds to the looks what none of them shows, and looks from further places where voxels are known to be free. Elsewhere nobody knows
/// whether such a place is within what was mapped.
pub(super) fn look_at_rest(
    space: &GivenSpace,
    ground: &Ground,
    options: &GivenOptions,
    looks: &mut Vec<Look>,
    shown: &mut Shown<'_>,
) {
    let range_max_m = options.range_max_m;
    for nth in 0..NEAREST.min(looks.len()) {
        look(space, looks, shown, nth, range_max_m);
    }
    if !matches!(space.open, Open::Only(_)) {
        return;
    }
    let num_before = looks.len();
    for _ in 0..ROUNDS {
        let most = (num_before + MOST_VIEWS).saturating_sub(looks.len());
        let places = places_within(space, ground, &shown.rest(), most);
        let more = places.into_iter().filter_map(|at| Look::from(space, ground, at, GIVEN_REST_SENSOR));
        let mut more: Vec<Look> = more.collect();
        if more.is_empty() {
            return;
        }
        for nth in 0..NEAREST.min(more.len()) {
            look(space, &mut more, shown, nth, range_max_m);
        }
        more.retain(|look| !look.hits.is_empty() || !look.passed.is_empty());
        looks.append(&mut more);
    }
}

/// Each voxel that is not shown is looked at from the n-th nearest place, the farthest first: a beam shows what is on its way, too.
fn look(space: &GivenSpace, looks: &mut [Look], shown: &mut Shown<'_>, nth: usize, range_max_m: f64) {
    let mut nearest: FxHashMap<(i32, i32, i32), Option<usize>> = FxHashMap::default();
    let mut wanted: Vec<Vec<(f64, Voxel)>> = vec![vec![]; looks.len()];
    for voxel in shown.rest() {
        let column = (voxel.x.div_euclid(COLUMN), voxel.y.div_euclid(COLUMN), voxel.z.div_euclid(COLUMN));
        let found = *nearest.entry(column).or_insert_with(|| {
            let middle = |v: i32| (f64::from(v) + 0.5) * f64::from(COLUMN) * space.voxel_m;
            nth_nearest(looks, &Point3::new(middle(column.0), middle(column.1), middle(column.2)), nth)
        });
        let Some(at) = found else { continue };
        let distance = (voxel.center(space.voxel_m) - looks[at].eye).norm();
        if distance <= range_max_m {
            wanted[at].push((distance, voxel));
        }
    }
    let before: &Shown<'_> = shown;
    looks.par_iter_mut().zip(wanted).for_each(|(look, mut voxels)| {
        voxels.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        for (_, voxel) in voxels {
            if !space.is_open(voxel) || !(before.is_passed(voxel) || look.has_passed(voxel)) {
                look.look_at(space, voxel);
            }
        }
    });
    looks.iter().for_each(|look| shown.add(look));
}

fn nth_nearest(looks: &[Look], to: &Point3<f64>, nth: usize) -> Option<usize> {
    let mut best: Vec<(f64, usize)> = Vec::with_capacity(nth + 2);
    for (k, look) in looks.iter().enumerate() {
        let distance = (look.eye - to).norm_squared();
        let at = best.partition_point(|b| b.0 <= distance);
        if at <= nth {
            best.insert(at, (distance, k));
            best.truncate(nth + 1);
        }
    }
    best.get(nth).map(|b| b.1)
}

/// Of the voxels that are not shown, and those beside them, one a cube that is free and over ground: the one nearest to the middle of
/// those in its cube. Larger cubes where there would be more than `most`.
pub(super) fn places_within(space: &GivenSpace, ground: &Ground, rest: &[Voxel], most: usize) -> Vec<Voxel> {
    let beside = [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)];
    let is_place =
        |v: &Voxel| space.is_open(*v) && ground.get(&Cell::new(v.x, v.y)).is_some_and(|ground| *ground < v.z);
    let around = |v: &Voxel| {
        let v = *v;
        let near = beside.into_iter().map(move |(x, y, z)| Voxel::new(v.x + x, v.y + y, v.z + z));
        let is_free = space.is_open(v);
        near.filter(move |_| !is_free).chain(is_free.then_some(v))
    };
    let mut places: Vec<Voxel> = rest.iter().flat_map(around).filter(is_place).collect();
    places.sort_unstable();
    places.dedup();
    let mut edge = (CUBE_M / space.voxel_m).ceil().max(1.0) as i32;
    loop {
        let mut cubes: BTreeMap<(i32, i32, i32), Vec<Voxel>> = BTreeMap::new();
        for v in &places {
            let cube = (v.z.div_euclid(edge), v.y.div_euclid(edge), v.x.div_euclid(edge));
            cubes.entry(cube).or_default().push(*v);
        }
        // However large they are, up to eight meet at the origin.
        if cubes.len() > most && edge < LARGEST_CUBE {
            edge = edge.saturating_mul(5) / 4 + 1;
            continue;
        }
        let middle_one = |of_cube: &Vec<Voxel>| {
            let sum = of_cube
                .iter()
                .fold([0.0; 3], |s, v| [s[0] + f64::from(v.x), s[1] + f64::from(v.y), s[2] + f64::from(v.z)]);
            let n = of_cube.len() as f64;
            let off = |v: &Voxel| {
                (f64::from(v.x) - sum[0] / n).powi(2)
                    + (f64::from(v.y) - sum[1] / n).powi(2)
                    + (f64::from(v.z) - sum[2] / n).powi(2)
            };
            of_cube.iter().copied().min_by(|a, b| off(a).total_cmp(&off(b)))
        };
        return cubes.values().filter_map(middle_one).take(most).collect();
    }
}
