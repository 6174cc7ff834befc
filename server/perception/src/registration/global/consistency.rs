//! Sets of pairs that one rigid motion allows.

use super::matching::Pair;
use super::rigid::{fit, settle};
use super::{Candidate, FEWEST_PAIRS, GlobalParams};
use rayon::prelude::*;

/// Distances of two pairs may differ by so many voxels.
const TOLERANCE: f64 = 1.0;
/// Pairs nearer to each other than so many voxels say little about a motion.
const APART: f64 = 4.0;
/// Seeds that are tried, and the pairs that each calls up.
const SEEDS: usize = 60;
const MEMBERS: usize = 25;
/// Candidates that are handed on.
const CANDIDATES: usize = 8;
/// Pairs within so many voxels agree with a motion.
pub(super) const AGREE: f64 = 1.5;

/// Motions on which many pairs agree, most agreed first.
///
/// Two pairs are compatible if the distances of their ends are equal. Two pairs that are right have all other right ones
/// in common, while wrong ones share few: the number of common compatible pairs ranks them. Each of the best seeds calls
/// up those that share most with it.
///
/// Source: Chen et al., "SC2-PCR: a second order spatial compatibility for efficient and robust point cloud
/// registration", 2022.
pub(super) fn candidates(pairs: &[Pair], params: &GlobalParams) -> Vec<Candidate> {
    let size = params.voxel_size_m;
    let graph = Graph::new(pairs, size);
    let scores: Vec<u64> = (0..pairs.len()).into_par_iter().with_min_len(16).map(|i| graph.score(i)).collect();
    let mut order: Vec<usize> = (0..pairs.len()).filter(|&i| scores[i] > 0).collect();
    order.sort_by(|&a, &b| scores[b].cmp(&scores[a]).then(a.cmp(&b)));
    // Every other seed by rank, the rest spread, so that one large wrong set does not take all.
    let stride = (order.len() / SEEDS).max(1);
    let mut seeds: Vec<usize> = order.iter().copied().take(SEEDS).collect();
    seeds.extend(order.iter().copied().skip(SEEDS).step_by(stride));
    let found: Vec<Option<Candidate>> = seeds
        .par_iter()
        .map(|&seed| {
            let start = fit(graph.members(seed).iter().map(|&j| &pairs[j]))?;
            let (t_target_source, num_pairs) = settle(start, pairs, AGREE * size)?;
            (num_pairs >= FEWEST_PAIRS).then_some(Candidate { t_target_source, num_pairs })
        })
        .collect();
    distinct(found.into_iter().flatten().collect(), size, pairs)
}

/// The most agreed motions that differ from each other by where they put the pairs.
pub(super) fn distinct(mut found: Vec<Candidate>, size: f64, pairs: &[Pair]) -> Vec<Candidate> {
    found.sort_by_key(|c| std::cmp::Reverse(c.num_pairs));
    let mut out: Vec<Candidate> = Vec::new();
    let sample: Vec<&Pair> = pairs.iter().step_by(pairs.len().div_ceil(20).max(1)).collect();
    for c in found {
        let far = |o: &Candidate| {
            let off = |p: &&Pair| (c.t_target_source * p.source - o.t_target_source * p.source).norm();
            sample.iter().map(off).sum::<f64>() > 4.0 * size * sample.len() as f64
        };
        if out.iter().all(far) {
            out.push(c);
        }
        if out.len() == CANDIDATES {
            break;
        }
    }
    out
}

/// Which pairs are compatible: a bit a pair.
struct Graph {
    words: usize,
    rows: Vec<u64>,
    len: usize,
}

impl Graph {
    fn new(pairs: &[Pair], size: f64) -> Self {
        let words = pairs.len().div_ceil(64).max(1);
        let mut rows = vec![0u64; words * pairs.len()];
        let ends = Ends::of(pairs);
        rows.par_chunks_mut(words).enumerate().for_each(|(i, row)| {
            compatible(i, &ends, (TOLERANCE * size) as f32, (APART * size) as f32, row);
        });
        Self { words, rows, len: pairs.len() }
    }

    fn row(&self, i: usize) -> &[u64] {
        &self.rows[i * self.words..(i + 1) * self.words]
    }

    fn neighbors(&self, i: usize) -> impl Iterator<Item = usize> + '_ {
        self.row(i).iter().enumerate().flat_map(|(w, &word)| {
            std::iter::successors((word != 0).then_some(word), |b| Some(b & (b - 1)).filter(|b| *b != 0))
                .map(move |b| w * 64 + b.trailing_zeros() as usize)
        })
    }

    fn common(&self, i: usize, j: usize) -> u32 {
        common(self.row(i), self.row(j))
    }

    /// Sum of what a pair has in common with each that it is compatible with.
    fn score(&self, i: usize) -> u64 {
        self.neighbors(i).map(|j| u64::from(self.common(i, j))).sum()
    }

    /// A seed and those compatible with it that share most with it.
    fn members(&self, seed: usize) -> Vec<usize> {
        debug_assert!(seed < self.len);
        let mut ranked: Vec<(u32, usize)> = self.neighbors(seed).map(|j| (self.common(seed, j), j)).collect();
        ranked.sort_by(|a, b| b.0.cmp(&a.0).then(a.1.cmp(&b.1)));
        ranked.truncate(MEMBERS);
        std::iter::once(seed).chain(ranked.into_iter().map(|(_, j)| j)).collect()
    }
}

/// Ends of the pairs, coordinate by coordinate, about the first.
struct Ends([Vec<f32>; 6]);

impl Ends {
    fn of(pairs: &[Pair]) -> Self {
        let Some(first) = pairs.first() else { return Self(Default::default()) };
        let axis = |k: usize| pairs.iter().map(|p| (p.source[k] - first.source[k]) as f32).collect();
        let other = |k: usize| pairs.iter().map(|p| (p.target[k] - first.target[k]) as f32).collect();
        Self([axis(0), axis(1), axis(2), other(0), other(1), other(2)])
    }
}

percept_geometry::by_processor! {
    fn compatible(i: usize, ends: &Ends, tolerance: f32, apart: f32, row: &mut [u64]) {
        let [sx, sy, sz, tx, ty, tz] = &ends.0;
        let at = [sx[i], sy[i], sz[i], tx[i], ty[i], tz[i]];
        for (w, word) in row.iter_mut().enumerate() {
            let range = w * 64..((w + 1) * 64).min(sx.len());
            let mut fits = [false; 64];
            let n = range.len();
            let parts = [&sx[range.clone()], &sy[range.clone()], &sz[range.clone()], &tx[range.clone()], &ty[range.clone()], &tz[range]];
            for k in 0..n {
                let d = |c: usize| parts[c][k] - at[c];
                let a = (d(0) * d(0) + d(1) * d(1) + d(2) * d(2)).sqrt();
                let b = (d(3) * d(3) + d(4) * d(4) + d(5) * d(5)).sqrt();
                fits[k] = ((a - b).abs() < tolerance) & (a > apart) & (b > apart);
            }
            *word = fits.iter().enumerate().fold(0, |bits, (k, &f)| bits | (u64::from(f) << k));
        }
    }
}

percept_geometry::by_processor! {
    fn common(a: &[u64], b: &[u64]) -> u32 {
        a.iter().zip(b).map(|(x, y)| (x & y).count_ones()).sum()
    }
}
