//! Trains the outdoor detector's model: `objects train PATH [--frames A..B]` writes it into the detector's sources.
//!
//! What it learns from: in each frame the labelled things, and things put into the scan (`inserted.rs`) so that classes
//! that the recording lacks are known, too. A candidate that has most of a thing's points and few others is of its
//! class; one that has none of it, or a small part, or much beside it, is `Unknown`; it counts less where the labels
//! would not have told if it were a thing. What is in between is left out. Boosted trees are fitted, and a temperature
//! is chosen on frames that the fit did not see.

use crate::Failure;
use crate::inserted::{Ground, insert, shape};
use crate::truth::{Frame, class_of};
use percept_geometry::{ObjectClass, OrientedBox3};
use percept_perception::detection::outdoor::{
    CLASSES, DEPTH, NUM_TRAITS, OutdoorDetector, OutdoorModel, OutdoorParams, Traits, Tree, probabilities,
};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use std::borrow::Cow;
use std::fmt::Write as _;

/// Things put into a scan, and how often a scan is taken with others.
const THINGS: usize = 14;
const ROUNDS: u64 = 8;
/// A labelled thing is the real one: it counts like so many that were put in.
const LABELLED_WEIGHT: f64 = 2.0;
/// What stands where nothing is labelled is hardly ever a thing, and counts that much less for its being none.
const UNLABELLED_WEIGHT: f64 = 0.25;
/// Trucks, buses and motorcycles are rarer than cars, people and cyclists.
const RARE_WEIGHT: f64 = 0.5;
/// Where the model is kept.
const OUT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../perception/src/detection/outdoor/trained.rs");

/// Traits, class, and how much it counts.
type Sample = (Traits, usize, f64);

/// Trains on frames and writes the model.
pub(crate) fn train(frames: &[Frame]) -> Result<(), Failure> {
    let samples: Vec<Vec<Sample>> = frames.par_iter().map(samples_of).collect::<Result<_, _>>()?;
    for (i, class) in CLASSES.iter().enumerate() {
        println!("  {}: {} samples", class.name(), samples.iter().flatten().filter(|s| s.1 == i).count());
    }
    // Two thirds for the fit, the last third for the temperature.
    let (first, last) = samples.split_at(2 * samples.len() / 3);
    let held_out: Vec<&Sample> = last.iter().flatten().collect();
    let mut model = fit(&first.iter().flatten().copied().collect::<Vec<_>>());
    let mut best = (f64::INFINITY, 1.0);
    for step in 0..30 {
        model.temperature = 0.6 + 0.1 * f64::from(step);
        let loss = loss(&model, &held_out);
        if loss < best.0 {
            best = (loss, model.temperature);
        }
    }
    model.temperature = best.1;
    let named = |s: &&Sample| {
        let p = model.posterior(&s.0);
        (0..p.len()).max_by(|&a, &b| p[a].total_cmp(&p[b])) == Some(s.1)
    };
    for (i, class) in CLASSES.iter().enumerate() {
        let of_class: Vec<&&Sample> = held_out.iter().filter(|s| s.1 == i).collect();
        let right = of_class.iter().filter(|s| named(s)).count();
        println!("  held out {}: {right} of {} right", class.name(), of_class.len());
    }
    println!("  temperature {:.1}, loss on held-out frames {:.3}", best.1, best.0);
    let mut model = fit(&samples.into_iter().flatten().collect::<Vec<_>>());
    model.temperature = best.1;
    std::fs::write(OUT, source(&model))?;
    Ok(())
}

fn loss(model: &OutdoorModel, samples: &[&Sample]) -> f64 {
    let total: f64 = samples.iter().map(|s| s.2).sum();
    samples.iter().map(|s| -s.2 * model.posterior(&s.0)[s.1].max(1e-9).ln()).sum::<f64>() / total
}

/// The candidates of a frame as recorded, and with things put in.
fn samples_of(frame: &Frame) -> Result<Vec<Sample>, Failure> {
    let empty = OutdoorModel { trees: Cow::Borrowed(&[]), temperature: 1.0 };
    let detector = OutdoorDetector::with_model(OutdoorParams::default(), empty)?;
    let ground = Ground::of(&frame.scan).ok_or("no ground")?;
    let labelled: Vec<(Option<ObjectClass>, OrientedBox3)> =
        frame.objects.iter().map(|o| (class_of(&o.name), o.bbox)).collect();
    let mut out = Vec::new();
    for round in 0..ROUNDS {
        let mut rng = ChaCha8Rng::seed_from_u64(1000 * frame.number as u64 + round);
        let mut scan = frame.scan.clone();
        let mut things = labelled.clone();
        for i in 0..THINGS {
            let class = CLASSES[1 + i % (CLASSES.len() - 1)];
            let others: Vec<OrientedBox3> = things.iter().map(|t| t.1).collect();
            let shape = shape(class, &mut rng);
            if let Some(bbox) = insert(&mut scan, &ground, &shape, &others, &mut rng) {
                things.push((Some(shape.class), bbox));
            }
        }
        let counts: Vec<f64> =
            things.iter().map(|t| scan.positions.iter().filter(|p| stands_in(&t.1, p)).count() as f64).collect();
        for candidate in detector.candidates(&scan)? {
            let center = candidate.points.iter().fold(nalgebra::Vector3::zeros(), |s, p| s + p.coords.cast::<f64>())
                / candidate.points.len() as f64;
            let shares = things.iter().zip(&counts).enumerate().map(|(t, (thing, of))| {
                let shared = candidate.points.iter().filter(|p| stands_in(&thing.1, p)).count() as f64;
                (t, shared / candidate.points.len() as f64, shared / of.max(1.0))
            });
            let most = shares.max_by(|a, b| (a.1 * a.2).total_cmp(&(b.1 * b.2)));
            let (class, is_real) = match most {
                Some((t, pure, whole)) if pure > 0.0 => {
                    let class = things[t].0.and_then(|c| CLASSES.iter().position(|k| *k == c));
                    let is_real = t < labelled.len();
                    match class {
                        Some(class) if pure >= 0.92 && whole >= 0.75 => (class, is_real),
                        _ if pure >= 0.5 && whole >= 0.4 => continue,
                        _ => (0, is_real),
                    }
                }
                _ => (0, true),
            };
            // The recorded things are the same in each round.
            if is_real && class != 0 && round > 0 {
                continue;
            }
            if class == 0 && round > 0 && is_real {
                continue;
            }
            let is_guess = class == 0 && is_real && frame.is_unlabelled(&center.into());
            let weight = if is_guess {
                UNLABELLED_WEIGHT
            } else if is_real && class != 0 {
                LABELLED_WEIGHT
            } else if matches!(CLASSES[class], ObjectClass::Truck | ObjectClass::Bus | ObjectClass::Motorcycle) {
                RARE_WEIGHT
            } else {
                1.0
            };
            out.push((candidate.traits, class, weight));
        }
    }
    Ok(out)
}

/// Whether a point is in a thing's box or a little beside, and above its foot.
fn stands_in(bbox: &OrientedBox3, p: &nalgebra::Point3<f32>) -> bool {
    let mut grown = *bbox;
    grown.size += nalgebra::Vector3::new(0.2, 0.2, 0.2);
    let p = p.cast();
    grown.contains(&p) && p.z > bbox.center().z - 0.5 * bbox.size.z + 0.2
}

/// Rounds of boosting, and the part of each step that is made.
const BOOSTING: usize = 60;
const SHRINKAGE: f64 = 0.15;
/// Values of a trait that are asked for.
const NUM_BINS: usize = 32;
/// Leaves are drawn to 0 by so much, and have at least so much to learn from.
const RIDGE: f64 = 3.0;
const LEAST_HESSIAN: f64 = 1.0;

/// Samples with their traits as numbers of bins.
struct Binned<'a> {
    samples: &'a [Sample],
    bins: Vec<[u8; NUM_TRAITS]>,
    edges: Vec<Vec<f32>>,
}

impl<'a> Binned<'a> {
    fn new(samples: &'a [Sample]) -> Self {
        let edges: Vec<Vec<f32>> = (0..NUM_TRAITS)
            .map(|t| {
                let mut values: Vec<f32> = samples.iter().map(|s| s.0[t] as f32).collect();
                values.sort_unstable_by(f32::total_cmp);
                let mut edges: Vec<f32> = (1..NUM_BINS)
                    .map(|i| values[i * (values.len() - 1) / NUM_BINS])
                    .map(|v| (v * 1e3).round() / 1e3)
                    .collect();
                edges.dedup();
                edges
            })
            .collect();
        let bin = |s: &Sample| std::array::from_fn(|t| edges[t].partition_point(|e| f64::from(*e) < s.0[t]) as u8);
        let bins = samples.iter().map(bin).collect();
        Self { samples, bins, edges }
    }

    /// The tree that lowers the loss most, by gradients and hessians of the samples.
    fn tree(&self, slopes: &[(f64, f64)]) -> Tree {
        let mut tree = Tree { splits: [(0, f32::MAX); (1 << DEPTH) - 1], leaves: [0.0; 1 << DEPTH] };
        let mut parts: Vec<Vec<u32>> = vec![(0..self.samples.len() as u32).collect()];
        for level in 0..DEPTH {
            let mut next = Vec::new();
            for (i, part) in parts.iter().enumerate() {
                let (no, yes) = match self.split(part, slopes) {
                    Some((t, edge)) => {
                        tree.splits[(1 << level) - 1 + i] = (t as u8, self.edges[t][edge]);
                        part.iter().partition(|&&s| usize::from(self.bins[s as usize][t]) <= edge)
                    }
                    None => (part.clone(), vec![]),
                };
                next.extend([no, yes]);
            }
            parts = next;
        }
        for (leaf, part) in tree.leaves.iter_mut().zip(&parts) {
            let (g, h) = sums(part, slopes);
            *leaf = ((SHRINKAGE * g / (h + RIDGE)) as f32 * 1e3).round() / 1e3;
        }
        tree
    }

    fn split(&self, part: &[u32], slopes: &[(f64, f64)]) -> Option<(usize, usize)> {
        let (all_g, all_h) = sums(part, slopes);
        let worth = |g: f64, h: f64| g * g / (h + RIDGE);
        let mut best: (f64, Option<(usize, usize)>) = (worth(all_g, all_h) + 1e-6, None);
        for t in 0..NUM_TRAITS {
            let mut bins = [(0.0, 0.0); NUM_BINS];
            for &s in part {
                let bin = &mut bins[usize::from(self.bins[s as usize][t])];
                (bin.0, bin.1) = (bin.0 + slopes[s as usize].0, bin.1 + slopes[s as usize].1);
            }
            let (mut g, mut h) = (0.0, 0.0);
            for (edge, bin) in bins.iter().enumerate().take(self.edges[t].len()) {
                (g, h) = (g + bin.0, h + bin.1);
                let (rest_g, rest_h) = (all_g - g, all_h - h);
                let gain = worth(g, h) + worth(rest_g, rest_h);
                if h >= LEAST_HESSIAN && rest_h >= LEAST_HESSIAN && gain > best.0 {
                    best = (gain, Some((t, edge)));
                }
            }
        }
        best.1
    }
}

fn sums(part: &[u32], slopes: &[(f64, f64)]) -> (f64, f64) {
    part.iter().map(|&s| slopes[s as usize]).fold((0.0, 0.0), |sum, s| (sum.0 + s.0, sum.1 + s.1))
}

/// Boosted trees (see `OutdoorModel`), each leaf a step of Newton's as in Chen and Guestrin, "XGBoost", 2016, eq. 5.
fn fit(samples: &[Sample]) -> OutdoorModel {
    let binned = Binned::new(samples);
    let mut scores = vec![[0.0; CLASSES.len()]; samples.len()];
    let mut trees = Vec::new();
    for _ in 0..BOOSTING {
        let now: Vec<[f64; CLASSES.len()]> = scores.iter().map(probabilities).collect();
        for class in 0..CLASSES.len() {
            let slope = |(s, p): (&Sample, &[f64; CLASSES.len()])| {
                let p = p[class];
                (s.2 * (f64::from(u8::from(s.1 == class)) - p), s.2 * p * (1.0 - p))
            };
            let slopes: Vec<(f64, f64)> = samples.iter().zip(&now).map(slope).collect();
            let tree = binned.tree(&slopes);
            scores.iter_mut().zip(samples).for_each(|(score, s)| score[class] += tree.score(&s.0));
            trees.push(tree);
        }
    }
    OutdoorModel { trees: Cow::Owned(trees), temperature: 1.0 }
}

/// The model as source text.
fn source(model: &OutdoorModel) -> String {
    let mut out = String::from(
        "//! The model's numbers, written by `cargo run --release -p percept-bench --example objects -- train PATH`.\n\n\
         use super::model::{OutdoorModel, Tree};\nuse std::borrow::Cow;\n\n\
         /// The built-in model.\npub(super) fn model() -> OutdoorModel {\n",
    );
    let _ = writeln!(
        out,
        "    OutdoorModel {{ trees: Cow::Borrowed(&TREES), temperature: {:?} }}\n}}\n",
        model.temperature
    );
    let _ = writeln!(
        out,
        "#[rustfmt::skip]\n#[allow(clippy::approx_constant, reason = \"trained\")]\nstatic TREES: [Tree; {}] = [",
        model.trees.len()
    );
    for tree in model.trees.iter() {
        let splits: Vec<String> = tree.splits.iter().map(|(t, v)| format!("({t}, {})", literal(*v))).collect();
        let leaves: Vec<String> = tree.leaves.iter().map(|v| literal(*v)).collect();
        let _ = writeln!(out, "    Tree {{\n        splits: [{}],", splits.join(", "));
        let _ = writeln!(out, "        leaves: [{}],\n    }},", leaves.join(", "));
    }
    out + "];\n"
}

fn literal(v: f32) -> String {
    if v == f32::MAX { "f32::MAX".into() } else { format!("{v:?}") }
}
