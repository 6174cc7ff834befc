//! Motions by random samples of pairs.

use super::consistency::{AGREE, distinct};
use super::matching::Pair;
use super::rigid::{fit, settle};
use super::{Candidate, FEWEST_PAIRS, GlobalParams};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Pairs of a sample.
const SAMPLE: usize = 4;
/// Edges between the points of a sample may differ by this ratio between the clouds.
const EDGE_RATIO: f64 = 0.9;
/// Sampling ends when a better motion is missed with at most 1 minus this.
const CONFIDENCE: f64 = 0.999;

/// Samples of four pairs whose edges are about as long in both clouds; of these the motions most pairs agree with.
///
/// Source: Rusu, Blodow and Beetz 2009, sample consensus initial alignment; edge lengths as in Buch et al. 2013.
pub(super) fn candidates(pairs: &[Pair], params: &GlobalParams) -> Vec<Candidate> {
    if pairs.len() < SAMPLE {
        return vec![];
    }
    let distance_m = AGREE * params.voxel_size_m;
    let mut rng = ChaCha8Rng::seed_from_u64(params.seed);
    let mut found: Vec<Candidate> = Vec::new();
    let (mut best, mut needed, mut done) = (FEWEST_PAIRS - 1, params.max_iterations, 0);
    while done < needed {
        done += 1;
        let sample: [Pair; SAMPLE] = std::array::from_fn(|_| pairs[rng.random_range(0..pairs.len())]);
        if !edges_agree(&sample) {
            continue;
        }
        let Some(start) = fit(sample.iter()) else { continue };
        let agrees = |p: &&Pair| (start * p.source - p.target).norm_squared() < distance_m * distance_m;
        if pairs.iter().filter(agrees).count() < best.min(FEWEST_PAIRS) {
            continue;
        }
        let Some((t_target_source, num_pairs)) = settle(start, pairs, distance_m) else { continue };
        if num_pairs < FEWEST_PAIRS {
            continue;
        }
        found.push(Candidate { t_target_source, num_pairs });
        if num_pairs > best {
            best = num_pairs;
            let good = (best as f64 / pairs.len() as f64).powi(SAMPLE as i32);
            let enough = (1.0 - CONFIDENCE).ln() / (1.0 - good).ln();
            needed = if enough.is_finite() { (enough.ceil() as usize).min(params.max_iterations) } else { needed };
        }
    }
    distinct(found, params.voxel_size_m, pairs)
}

fn edges_agree(sample: &[Pair; SAMPLE]) -> bool {
    (0..SAMPLE).all(|i| {
        (0..i).all(|j| {
            let (a, b) = ((sample[i].source - sample[j].source).norm(), (sample[i].target - sample[j].target).norm());
            a > 0.0 && b > 0.0 && a.min(b) >= EDGE_RATIO * a.max(b)
        })
    })
}
