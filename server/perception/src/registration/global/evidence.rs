//! How much two clouds say for a motion, and against it.
//!
//! Surface that coincides is no evidence where it would coincide anyway: two walls and a road fit wherever one slides
//! along them. So the motion is compared with itself moved along the direction that the coinciding surface fixes least:
//! how often a patch finds its like there is what chance does for it. A patch that chance would not place and that
//! finds its like speaks for the motion, one that should and does not, where the other cloud has seen the place,
//! against it.
//!
//! Source: violations of free and of occupied space as in Huber and Hebert, "Fully automatic registration of multiple 3D
//! data sets", 2003; chance by displaced models, and a bound on the number of false alarms, as in Moisan and Stival, "A
//! probabilistic criterion to detect rigid point matches between two images and estimate the fundamental matrix", 2004.
//! They test with viewpoints; bare clouds have none, so a place counts as seen if it lies at a surface that goes on to all
//! sides. Where a surface ends, a sensor's range or its field of view may end as well: two clouds laid centre on centre
//! would agree in that, wherever they are from.

use super::keypoints::Described;
use super::patches::{Patches, Sight, cell};
use super::uncertainty;
use crate::cloud::symmetric_eigen3;
use nalgebra::{Matrix3, Point3, Translation3, UnitQuaternion, Vector3};
use percept_geometry::{Covariance6, Pose};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Poses turned by a little: either way about two axes.
pub(super) const TURNS: usize = 4;
/// Share of a true motion's patches that find their like where the place was seen: 0.5 to 0.8 between submaps of
/// KITTI 07, the rest is what moved and what was seen from one side only.
const LIKE: f64 = 0.7;
/// Chance is what displaced motions do, and so many patches of the mean chance.
const PRIOR: f64 = 4.0;
const LEAST_CHANCE: f64 = 0.02;
/// A patch is seen from both clouds: what one of them says again is no news.
const TWICE: f64 = 0.5;
/// What lies within so many voxels may be one thing (a car, the corner of a house), and comes again elsewhere: it says so much at
/// most, nats. Of 500 `cuts` and 500 `streets` three answers were wrong that 25, 32 and 52 nats spoke for, of which one thing
/// said 16 to 28; of right ones it says 3 to 10 as a rule.
const THING: f32 = 16.0;
const MOST_OF_A_THING: f64 = 8.0;
/// Steps of a voxel along the weakest direction that are tried to either side, and those that are too near to differ:
/// a patch is as long.
const STEPS: i32 = 160;
const NEAR: i32 = 4;
/// Voxels between the displaced motions that tell of chance; candidates are ranked by one patch of so many.
const CHANCE_STEP: usize = 4;
/// Voxels between those that are rivals, along the weakest direction and the next.
const RIVAL_STEPS: [usize; 2] = [1, 2];
const ROUGH: usize = 4;

/// Patches of either cloud, by number.
struct Chosen {
    source: Vec<u32>,
    target: Vec<u32>,
}

impl Chosen {
    fn every(stride: usize, num_source: usize, num_target: usize) -> Self {
        let some = |n: usize| (0..n as u32).step_by(stride).collect();
        Self { source: some(num_source), target: some(num_target) }
    }

    /// Those that chance does not place, and the chance of these.
    fn telling(&self, chance: &[f64]) -> (Self, Vec<f64>) {
        let (of_source, of_target) = chance.split_at(self.source.len());
        let some = |patches: &[u32], chance: &[f64]| {
            patches.iter().zip(chance).filter(|(_, c)| **c < LIKE).map(|(p, _)| *p).collect()
        };
        let out = Self { source: some(&self.source, of_source), target: some(&self.target, of_target) };
        (out, chance.iter().copied().filter(|c| *c < LIKE).collect())
    }
}

/// Both clouds, cut into patches.
pub(super) struct Evidence {
    source: Patches,
    target: Patches,
    size: f64,
}

/// What speaks for a motion.
#[derive(Debug, Clone, Copy)]
pub(super) struct Support {
    /// Natural logarithm of how much likelier what is seen is if the motion is right than if it is chance.
    pub(super) log_ratio: f64,
    /// The same where no one thing says more than [`MOST_OF_A_THING`].
    pub(super) evidence: f64,
}

/// What the clouds say of a motion, and of those that slide it along.
#[derive(Debug, Clone, Copy)]
pub(super) struct Compared {
    pub(super) of: Support,
    /// Of the displaced motions, the one that most speaks for, if anything does.
    pub(super) rival: Option<(Support, Pose)>,
}

impl Evidence {
    pub(super) fn new(source: &Described, target: &Described, size: f64) -> Self {
        let (source, target) = rayon::join(|| Patches::new(source, size), || Patches::new(target, size));
        Self { source, target, size }
    }

    /// About how much speaks for a motion, by a part of the patches: to rank candidates by.
    pub(super) fn roughly(&self, t_target_source: &Pose) -> f64 {
        let patches = Chosen::every(ROUGH, self.source.len(), self.target.len());
        let directions = self.directions(t_target_source);
        let chance = self.chance(t_target_source, &directions, &patches);
        ROUGH as f64 * weigh(&chance, &self.sights(t_target_source, &patches))
    }

    /// Compares a motion with those that slide it along.
    pub(super) fn compare(&self, t_target_source: &Pose) -> Compared {
        let all = Chosen::every(1, self.source.len(), self.target.len());
        let directions = self.directions(t_target_source);
        let chance = self.chance(t_target_source, &directions, &all);
        // What fits anywhere says nothing more.
        let (patches, chance) = all.telling(&chance);
        let of = self.support(t_target_source, &patches, &chance);
        let mut rival: Option<(f64, Pose)> = None;
        for (along, stride) in directions.iter().zip(RIVAL_STEPS) {
            for (t, sights) in self.displaced(t_target_source, along, stride, &patches) {
                let other = weigh(&chance, &sights);
                if other > rival.map_or(0.0, |r| r.0) {
                    rival = Some((other, t));
                }
            }
        }
        Compared { of, rival: rival.map(|(_, t)| (self.support(&t, &patches, &chance), t)) }
    }

    /// What some patches say of a motion.
    fn support(&self, t_target_source: &Pose, patches: &Chosen, chance: &[f64]) -> Support {
        let sights = self.sights(t_target_source, patches);
        let first = |patches: &Patches, k: &u32| patches.of(*k as usize).first().map_or_else(Point3::origin, |m| m.0);
        let of_source =
            patches.source.iter().map(|k| (t_target_source * first(&self.source, k).cast::<f64>()).cast::<f32>());
        let places = of_source.chain(patches.target.iter().map(|k| first(&self.target, k)));
        let mut things: BTreeMap<[i32; 3], f64> = BTreeMap::new();
        for ((at, chance), sight) in places.zip(chance).zip(&sights) {
            *things.entry(cell(&at, THING * self.size as f32)).or_default() += says(*chance, *sight);
        }
        let evidence = things.values().map(|says| (TWICE * says).min(MOST_OF_A_THING)).sum();
        Support { log_ratio: weigh(chance, &sights), evidence }
    }

    /// 6x6 of where the source comes to lie, right perturbation in its frame; none where too little coincides.
    pub(super) fn covariance(&self, t_target_source: &Pose) -> Option<Covariance6> {
        uncertainty::covariance(&self.source, &self.target, t_target_source, self.size)
    }

    /// How often chance gives each patch its like: the most along any of the directions.
    fn chance(&self, t_target_source: &Pose, directions: &[Vector3<f64>; 3], patches: &Chosen) -> Vec<f64> {
        let mut out = vec![0.0f64; patches.source.len() + patches.target.len()];
        for along in directions {
            let displaced = self.displaced(t_target_source, along, CHANCE_STEP, patches);
            out.iter_mut().zip(chance(&displaced, patches)).for_each(|(c, f)| *c = c.max(f));
        }
        out
    }

    /// The motion displaced along a direction, every `stride` voxels, with what is seen of the patches then.
    fn displaced(
        &self,
        t_target_source: &Pose,
        along: &Vector3<f64>,
        stride: usize,
        patches: &Chosen,
    ) -> Vec<(Pose, Vec<Sight>)> {
        let reach = self.reach(t_target_source, along);
        let steps = (-STEPS..=STEPS).step_by(stride).filter(|k| k.abs() >= NEAR);
        let steps: Vec<f64> = steps.map(|k| f64::from(k) * self.size).filter(|s| reach.contains(s)).collect();
        let moved = |s: &f64| {
            let t = Translation3::from(along * *s) * t_target_source;
            (t, self.sights(&t, patches))
        };
        steps.par_iter().map(moved).collect()
    }

    fn sights(&self, t_target_source: &Pose, patches: &Chosen) -> Vec<Sight> {
        let mut out = Vec::with_capacity(patches.source.len() + patches.target.len());
        self.source.sights(&self.target, t_target_source, &patches.source, &mut out);
        self.target.sights(&self.source, &t_target_source.inverse(), &patches.target, &mut out);
        out
    }

    /// The motion turned either way about the two directions that most of what coincides faces, at the middle of that.
    pub(super) fn turned(&self, t_target_source: &Pose, radians: f64) -> [Pose; TURNS] {
        let sum = |(sum, num): (Vector3<f64>, f64), p: Vector3<f64>| (sum + p, num + 1.0);
        let coincides = self.coinciding(t_target_source).map(|(at, _)| at.coords.cast::<f64>());
        let (sum, num) = coincides.fold((Vector3::zeros(), 0.0), sum);
        let middle = Translation3::from(sum / f64::max(num, 1.0));
        let about = |axis: &Vector3<f64>, angle: f64| {
            let turn = UnitQuaternion::from_scaled_axis(axis * angle);
            middle * turn * middle.inverse() * t_target_source
        };
        let [_, a, b] = self.directions(t_target_source);
        [about(&a, radians), about(&a, -radians), about(&b, radians), about(&b, -radians)]
    }

    /// Where the source's points come to lie that coincide with the target, and that one's normal there.
    fn coinciding(&self, t_target_source: &Pose) -> impl Iterator<Item = (Point3<f32>, Vector3<f32>)> {
        let all = (0..self.source.len()).flat_map(|patch| self.source.of(patch));
        let t_target_source = *t_target_source;
        all.filter_map(move |(p, n)| {
            let at = (t_target_source * p.cast::<f64>()).cast();
            let faces = (t_target_source.rotation * n.cast::<f64>()).cast();
            Some((at, *self.target.normal(self.target.partner(&at, &faces)?)))
        })
    }

    /// Directions in the target's frame, the one first that least of what coincides faces.
    fn directions(&self, t_target_source: &Pose) -> [Vector3<f64>; 3] {
        let mut facing = Matrix3::zeros();
        for (_, n) in self.coinciding(t_target_source) {
            let n = n.cast::<f64>();
            facing += n * n.transpose();
        }
        symmetric_eigen3(&facing).vectors
    }

    /// How far the source can be moved along a direction before the clouds part, metres.
    fn reach(&self, t_target_source: &Pose, along: &Vector3<f64>) -> std::ops::Range<f64> {
        let ends = |at: &mut dyn Iterator<Item = f64>| {
            at.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)))
        };
        let source =
            ends(&mut self.source.points().iter().map(|p| along.dot(&(t_target_source * p.cast::<f64>()).coords)));
        let target = ends(&mut self.target.points().iter().map(|p| along.dot(&p.coords.cast::<f64>())));
        target.0 - source.1..target.1 - source.0
    }
}

/// How often each patch finds its like by chance.
fn chance(displaced: &[(Pose, Vec<Sight>)], patches: &Chosen) -> Vec<f64> {
    let mut counts = vec![(0.0f64, 0.0f64); patches.source.len() + patches.target.len()];
    for (_, sights) in displaced {
        for (count, sight) in counts.iter_mut().zip(sights) {
            count.0 += f64::from(u8::from(*sight == Sight::Same));
            count.1 += f64::from(u8::from(*sight != Sight::Unseen));
        }
    }
    let (same, seen) = counts.iter().fold((0.0, 0.0), |sum, c| (sum.0 + c.0, sum.1 + c.1));
    // Where nothing can be displaced, nothing is known of chance, and patches say nothing.
    let mean = if seen > 0.0 { same / seen } else { 1.0 };
    counts.iter().map(|(same, seen)| ((same + PRIOR * mean) / (seen + PRIOR)).max(LEAST_CHANCE)).collect()
}

/// What the sights say together, nats.
fn weigh(chance: &[f64], sights: &[Sight]) -> f64 {
    TWICE * chance.iter().zip(sights).map(|(chance, sight)| says(*chance, *sight)).sum::<f64>()
}

/// What one of them says, nats.
fn says(chance: f64, sight: Sight) -> f64 {
    match sight {
        _ if chance >= LIKE => 0.0,
        Sight::Unseen => 0.0,
        Sight::Same => (LIKE / chance).ln(),
        Sight::Other => ((1.0 - LIKE) / (1.0 - chance)).ln(),
    }
}
