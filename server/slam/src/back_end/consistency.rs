//! Which loops are believed: those that the graph explains already, and groups that agree with each other.
//!
//! A loop that moves the map by more than its own error is believed only together with others that say the same.
//! Source: Mangelson et al., "Pairwise consistent measurement set maximization for robust multi-robot map merging", 2018;
//! sets are grown greedily.

use super::chain::Chain;
use crate::loops::LoopClosure;
use nalgebra::Vector6;
use percept_geometry::{Covariance6, Pose, se3};

/// Squared distance, in standard deviations, beyond which two things of six degrees of freedom do not agree: 99.9 %.
pub(super) const AGREE: f64 = 22.5;

/// Closures confirm each other if both their ends are within so many keyframes: farther apart, the drift between them
/// lets too much agree by chance. Halved and doubled as it is ([`crate::loops::planar`]).
pub(super) const NEIGHBOURS: u64 = 20;

/// A closure with the indices of its nodes.
#[derive(Debug, Clone, Copy)]
pub(super) struct Constraint<'a> {
    pub(super) from: u32,
    pub(super) to: u32,
    pub(super) closure: &'a LoopClosure,
}

/// Squared Mahalanobis length of what is left of a closure between two poses.
pub(super) fn chi2(closure: &LoopClosure, t_map_from: &Pose, t_map_to: &Pose) -> f64 {
    mahalanobis(&error(&closure.t_from_to, &t_map_from.inv_mul(t_map_to)), &closure.covariance)
}

fn error(measured: &Pose, found: &Pose) -> Vector6<f64> {
    se3::log(&measured.inv_mul(found))
}

fn mahalanobis(error: &Vector6<f64>, covariance: &Covariance6) -> f64 {
    covariance.cholesky().map_or(f64::INFINITY, |c| error.dot(&c.solve(error)))
}

/// Whether the drift since `from` explains what a closure wants to move, within `sigmas`.
pub(super) fn within_drift(constraint: &Constraint<'_>, chain: &Chain, poses: &[Pose], sigmas: f64) -> bool {
    let found = poses[constraint.from as usize].inv_mul(&poses[constraint.to as usize]);
    let off = error(&constraint.closure.t_from_to, &found);
    // The lever is what the way spans: at most the whole of it.
    let span = (constraint.from..=constraint.to)
        .map(|k| (poses[k as usize].translation.vector - poses[constraint.to as usize].translation.vector).norm());
    let (var_t, var_r) = chain.drift(constraint.from, constraint.to, 0.5 * span.fold(0.0, f64::max));
    let limit = |var: f64, own: f64| sigmas * (var + own).sqrt();
    let own = |k: usize| (k..k + 3).map(|i| constraint.closure.covariance[(i, i)]).fold(0.0, f64::max);
    off.fixed_rows::<3>(0).norm() <= limit(var_t, own(0)) && off.fixed_rows::<3>(3).norm() <= limit(var_r, own(3))
}

/// Whether two closures say the same: around the ring of both and the ways between their ends nothing is left over.
fn agree(a: &Constraint<'_>, b: &Constraint<'_>, chain: &Chain, poses: &[Pose]) -> bool {
    let way = |i: u32, j: u32| poses[i as usize].inv_mul(&poses[j as usize]);
    let (t_b_a, t_a_b) = (way(b.from, a.from), way(a.to, b.to));
    let said_by_a = t_b_a * a.closure.t_from_to * t_a_b;
    let off = error(&b.closure.t_from_to, &said_by_a);
    let arm = t_a_b.translation.vector.norm() + a.closure.t_from_to.translation.vector.norm();
    let (before, after) = (chain.drift(b.from, a.from, arm), chain.drift(a.to, b.to, 0.0));
    let ways = [before.0 + after.0, before.1 + after.1];
    let ways = Vector6::from_fn(|k, _| ways[k / 3]);
    let own = se3::compose_covariance(&a.closure.covariance, &t_a_b, &b.closure.covariance);
    mahalanobis(&off, &(own + Covariance6::from_diagonal(&ways))) < AGREE
}

/// The largest set found in which all agree with each other: places in `constraints`, ascending. Those that end at the same
/// node count once.
pub(super) fn agreeing(constraints: &[Constraint<'_>], chain: &Chain, poses: &[Pose]) -> Vec<usize> {
    let n = constraints.len();
    let mut friends = vec![vec![false; n]; n];
    for i in 0..n {
        for j in 0..i {
            // Two matches of one scan share its mistakes: neither confirms the other.
            let (a, b) = (constraints[i].closure, constraints[j].closure);
            let apart = (a.to.0.abs_diff(b.to.0), a.from.0.abs_diff(b.from.0));
            let near = apart.0 > 0 && apart.0 <= NEIGHBOURS && apart.1 <= NEIGHBOURS;
            let both = near && agree(&constraints[i], &constraints[j], chain, poses);
            (friends[i][j], friends[j][i]) = (both, both);
        }
    }
    let degree = |i: usize| friends[i].iter().filter(|f| **f).count();
    let mut best: Vec<usize> = vec![];
    for seed in 0..n {
        let mut set = vec![seed];
        let mut others: Vec<usize> = (0..n).filter(|&j| friends[seed][j]).collect();
        others.sort_by_key(|&j| (std::cmp::Reverse(degree(j)), j));
        for j in others {
            if set.iter().all(|&k| friends[j][k]) {
                set.push(j);
            }
        }
        if set.len() > best.len() {
            best = set;
        }
    }
    best.sort_unstable();
    best
}
