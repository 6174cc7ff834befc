//! Which pixels ORB compares: 256 pairs, turned by 30 angles.
//!
//! **Source:** Calonder et al., "BRIEF", ECCV 2010 (pairs from an isotropic Gaussian) and Rublee et al., "ORB", ICCV
//! 2011 (greedy choice of pairs of large variance and little correlation). Where Rublee learns the variance and the
//! correlation of tests from photographs, both come here from a model of a patch: grey values correlate by
//! `1 / (1 + d / 8 px)` with distance d, and rise along the main direction, which the patch has been turned to.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::sync::OnceLock;

/// Pairs.
pub(super) const PAIRS: usize = 256;
/// Angles.
pub(super) const ANGLES: usize = 30;
/// No compared pixel is farther from the centre in x or y.
pub(super) const REACH: usize = 15;
/// Radius of the disc that unturned pairs come from, pixels.
const RADIUS: i32 = 15;
/// Correlation length of grey values, pixels, and slope along the main direction, standard deviations a pixel.
const CORRELATION_PX: f64 = 8.0;
const SLOPE: f64 = 0.06;

/// (dx, dy) of the first and second pixel of each pair, for each angle.
pub(super) type Pattern = Vec<[[(i8, i8); 2]; PAIRS]>;

/// The pattern turned by multiples of 12 degrees, made once.
pub(super) fn pattern() -> &'static Pattern {
    static PATTERN: OnceLock<Pattern> = OnceLock::new();
    PATTERN.get_or_init(|| {
        let pairs = choose();
        (0..ANGLES)
            .map(|k| {
                let (s, c) = (std::f64::consts::TAU * k as f64 / ANGLES as f64).sin_cos();
                let turn = |(x, y): (i32, i32)| {
                    let (x, y) = (f64::from(x), f64::from(y));
                    ((c * x - s * y).round() as i8, (s * x + c * y).round() as i8)
                };
                std::array::from_fn(|i| pairs[i].map(turn))
            })
            .collect()
    })
}

type Pair = [(i32, i32); 2];

/// A point of the disc, Gaussian with sigma 31 / 5 as BRIEF's; a sum of uniform numbers, exact on every machine.
fn draw(rng: &mut ChaCha8Rng) -> (i32, i32) {
    loop {
        let mut one = || {
            let sum: i32 = (0..12).map(|_| rng.random_range(0..1000)).sum();
            ((f64::from(sum) / 1000.0 - 6.0) * 31.0 / 5.0).round() as i32
        };
        let (x, y) = (one(), one());
        if x * x + y * y <= RADIUS * RADIUS {
            return (x, y);
        }
    }
}

fn correlation(a: (i32, i32), b: (i32, i32)) -> f64 {
    let d = f64::from((a.0 - b.0).pow(2) + (a.1 - b.1).pow(2)).sqrt();
    1.0 / (1.0 + d / CORRELATION_PX)
}

fn covariance([a, b]: Pair, [c, d]: Pair) -> f64 {
    correlation(a, c) - correlation(a, d) - correlation(b, c) + correlation(b, d)
}

/// Pairs whose outcome is open and that tell different things.
fn choose() -> Vec<Pair> {
    let mut rng = ChaCha8Rng::seed_from_u64(2011);
    let mut candidates: Vec<(f64, f64, Pair)> = (0..6000)
        .filter_map(|_| {
            let pair = [draw(&mut rng), draw(&mut rng)];
            let sigma = covariance(pair, pair).sqrt();
            // How far the expected outcome is from even, in standard deviations.
            let bias = SLOPE * f64::from((pair[0].0 - pair[1].0).abs()) / sigma;
            let far = (pair[0].0 - pair[1].0).pow(2) + (pair[0].1 - pair[1].1).pow(2) >= 16;
            far.then_some((bias, sigma, pair))
        })
        .collect();
    candidates.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut limit = 0.2;
    loop {
        let mut chosen: Vec<(f64, Pair)> = Vec::with_capacity(PAIRS);
        for &(_, sigma, pair) in &candidates {
            let alike = |&(s, other): &(f64, Pair)| covariance(pair, other).abs() > limit * sigma * s;
            if !chosen.iter().any(alike) {
                chosen.push((sigma, pair));
            }
            if chosen.len() == PAIRS {
                return chosen.into_iter().map(|(_, pair)| pair).collect();
            }
        }
        limit += 0.05;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pairs_stay_in_reach_and_differ() {
        let pattern = pattern();
        assert_eq!(pattern.len(), ANGLES);
        for pairs in pattern {
            for [a, b] in pairs {
                assert_ne!(a, b);
                for c in [a.0, a.1, b.0, b.1] {
                    assert!(usize::from(c.unsigned_abs()) <= REACH);
                }
            }
        }
        let mut first = pattern[0].to_vec();
        first.sort_unstable();
        first.dedup();
        assert_eq!(first.len(), PAIRS);
    }
}
