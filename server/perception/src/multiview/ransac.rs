//! Random sampling with local refinement, shared by all estimators here.

use percept_geometry::GeometryError;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

/// How models are sought among correspondences of which some are wrong.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RansacParams {
    /// Correspondences that are off by more do not belong to the model, pixels; above 0, at most 100.
    pub threshold_px: f64,
    /// Sampling ends when a better model is missed with at most 1 minus this; above 0, below 1.
    pub confidence: f64,
    /// Samples at most; 1 to 1000000.
    pub max_iterations: usize,
    /// Same seed, same answer.
    pub seed: u64,
}

impl Default for RansacParams {
    fn default() -> Self {
        Self { threshold_px: 1.0, confidence: 0.999, max_iterations: 2000, seed: 0 }
    }
}

impl RansacParams {
    /// Checks every field.
    ///
    /// # Errors
    /// `OutOfRange` naming field, value and requirement.
    pub fn validate(&self) -> Result<(), GeometryError> {
        let bad = |field, value, requirement| Err(GeometryError::OutOfRange { field, value, requirement });
        if !(self.threshold_px > 0.0 && self.threshold_px <= 100.0) {
            return bad("threshold_px", self.threshold_px, "above 0 and at most 100");
        }
        if !(self.confidence > 0.0 && self.confidence < 1.0) {
            return bad("confidence", self.confidence, "above 0 and below 1");
        }
        if !(1..=1_000_000).contains(&self.max_iterations) {
            return bad("max_iterations", self.max_iterations as f64, "1 to 1000000");
        }
        Ok(())
    }
}

/// What an estimator brings.
pub(super) trait Problem {
    type Model: Clone;
    /// Correspondences of a minimal sample.
    const SAMPLE: usize;
    /// Number of correspondences.
    fn len(&self) -> usize;
    /// Every model through a minimal sample.
    fn solve(&self, sample: &[usize], out: &mut Vec<Self::Model>);
    /// Squared error of a correspondence in units of the threshold: 1 lies on the border.
    fn error2(&self, model: &Self::Model, i: usize) -> f64;
    /// The model that fits these correspondences best, from a first one.
    fn refine(&self, model: &Self::Model, inliers: &[usize]) -> Option<Self::Model>;
}

/// The best model found, with its inliers ascending.
#[derive(Debug, Clone)]
pub(super) struct Found<M> {
    pub(super) model: M,
    pub(super) inliers: Vec<usize>,
    pub(super) iterations: usize,
}

/// Samples, scores by truncated squares, refines each new best on its inliers (local optimisation).
///
/// Sources: Torr and Zisserman, "MLESAC", 2000 (MSAC's score); Chum, Matas and Kittler, "Locally optimized RANSAC",
/// 2003. A model is given up as soon as it costs more than the best.
pub(super) fn search<P: Problem>(problem: &P, params: &RansacParams) -> Option<Found<P::Model>> {
    let n = problem.len();
    if n < P::SAMPLE {
        return None;
    }
    let mut rng = ChaCha8Rng::seed_from_u64(params.seed);
    let order = shuffled(n, &mut rng);
    let mut best: Option<(P::Model, f64)> = None;
    let (mut sample, mut models) = (Vec::with_capacity(P::SAMPLE), Vec::new());
    let (mut needed, mut done) = (params.max_iterations, 0);
    while done < needed {
        done += 1;
        draw(n, P::SAMPLE, &mut rng, &mut sample);
        models.clear();
        problem.solve(&sample, &mut models);
        for model in &models {
            let limit = best.as_ref().map_or(n as f64, |b| b.1);
            let Some(cost) = cost_below(problem, model, &order, limit) else { continue };
            let better = polish(problem, model.clone(), cost, &order);
            let inliers = inliers_of(problem, &better.0).len();
            needed = iterations(inliers as f64 / n as f64, P::SAMPLE, params);
            best = Some(better);
        }
    }
    let (model, _) = best?;
    let inliers = inliers_of(problem, &model);
    (inliers.len() >= P::SAMPLE).then_some(Found { model, inliers, iterations: done })
}

/// Refits on the inliers as long as that lowers the cost, a few times at most.
fn polish<P: Problem>(problem: &P, mut model: P::Model, mut cost: f64, order: &[usize]) -> (P::Model, f64) {
    for _ in 0..4 {
        let inliers = inliers_of(problem, &model);
        if inliers.len() <= P::SAMPLE {
            break;
        }
        let Some(refined) = problem.refine(&model, &inliers) else { break };
        let Some(less) = cost_below(problem, &refined, order, cost) else { break };
        let small = cost - less < 1e-3 * cost;
        (model, cost) = (refined, less);
        if small {
            break;
        }
    }
    (model, cost)
}

fn inliers_of<P: Problem>(problem: &P, model: &P::Model) -> Vec<usize> {
    (0..problem.len()).filter(|&i| problem.error2(model, i) < 1.0).collect()
}

/// The cost if it is below the limit. Visits in random order, so that bad models show early.
fn cost_below<P: Problem>(problem: &P, model: &P::Model, order: &[usize], limit: f64) -> Option<f64> {
    let mut cost = 0.0;
    for chunk in order.chunks(32) {
        cost += chunk.iter().map(|&i| problem.error2(model, i).min(1.0)).sum::<f64>();
        if cost >= limit {
            return None;
        }
    }
    // NaN compares as not below.
    (cost < limit).then_some(cost)
}

/// Samples after which a better one would have been drawn with the confidence asked for.
fn iterations(inlier_ratio: f64, sample: usize, params: &RansacParams) -> usize {
    let good = inlier_ratio.powi(sample as i32);
    if good >= 1.0 - 1e-12 {
        return 1;
    }
    let needed = (1.0 - params.confidence).ln() / (1.0 - good).ln();
    if needed.is_finite() { (needed.ceil() as usize).min(params.max_iterations) } else { params.max_iterations }
}

fn draw(n: usize, k: usize, rng: &mut ChaCha8Rng, out: &mut Vec<usize>) {
    out.clear();
    while out.len() < k {
        let i = rng.random_range(0..n);
        if !out.contains(&i) {
            out.push(i);
        }
    }
}

fn shuffled(n: usize, rng: &mut ChaCha8Rng) -> Vec<usize> {
    let mut order: Vec<usize> = (0..n).collect();
    for i in (1..n).rev() {
        order.swap(i, rng.random_range(0..=i));
    }
    order
}
