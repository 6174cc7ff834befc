//! Which candidate lays two clouds over each other, and whether to believe it.
//!
//! That much coincides is no reason to: two walls do wherever one slides along them. What counts is in [`super::evidence`].

use super::super::{IcpMethod, IcpParams, PreparedCloud, RegistrationError, align};
use super::evidence::{Compared, Evidence};
use super::keypoints::Described;
use super::patches::{COINCIDE, PARALLEL};
use super::{Candidate, GlobalOutcome, GlobalParams, GlobalResult};
use crate::search::KdTree;
use nalgebra::{Point3, Vector3};
use percept_geometry::{Covariance6, Pose};
use rayon::prelude::*;
use std::collections::VecDeque;
use std::ops::ControlFlow;

/// Points that are looked up for an overlap, about.
const SAMPLE: usize = 1500;
/// Flat places fit everywhere: a point counts by how far its surroundings are from flat, plus this.
const FLAT_WEIGHT: f32 = 0.02;
/// Evidence from which an answer is believed, nats. Of 1e4 motions that are tried or compared, one that is chance reaches
/// `ln(1e4) = 9`, and a thousandth of a false alarm a search is 16; patches that touch are not quite independent.
/// Of 1,000 `cuts` and 500 `streets` of `registration_quality` a wrong answer reaches 24.6 with a rival of less than half; of
/// 500 `cuts` 10 of 218 right ones have 25 to 30.
const BELIEVED: f64 = 25.0;
/// A different way that has this share of the answer's evidence makes it ambiguous.
const RIVAL: f64 = 0.5;
/// An answer may be moved along to where more speaks for it so often.
const MOVES: usize = 2;
/// Below so much overlap, the close alignment is made from poses turned by so many radians as well.
const LITTLE_OVERLAP: f64 = 0.3;
const TURN: f64 = 0.026;
/// Candidates that are refined.
const REFINED: usize = 3;

/// Whether to believe an answer, by what speaks for it and for its rival, nats.
fn outcome(evidence: f64, of_rival: f64) -> GlobalOutcome {
    if evidence < BELIEVED {
        GlobalOutcome::Doubtful
    } else if of_rival > RIVAL * evidence {
        GlobalOutcome::Ambiguous
    } else {
        GlobalOutcome::Found
    }
}

/// A candidate after its refinement.
#[derive(Clone)]
pub(super) struct Refined {
    t_target_source: Pose,
    covariance: Covariance6,
    /// About what speaks for it, nats.
    support: f64,
    num_pairs: usize,
}

impl Refined {
    /// Whether two put the cloud in about the same place.
    fn is_like(&self, other: &Self, size: f64) -> bool {
        let d = self.t_target_source.inverse() * other.t_target_source;
        // The centres of rotation differ from the origin: compare generously.
        d.rotation.angle() < 0.15 && d.translation.vector.norm() < 20.0 * size
    }
}

/// An answer, and what speaks for it, things that say much included, nats.
#[derive(Clone)]
pub(super) struct Judged {
    pub(super) answer: GlobalResult,
    pub(super) log_ratio: f64,
}

impl Judged {
    pub(super) fn nothing(num_pairs: usize) -> Self {
        Self { answer: GlobalResult::nothing(num_pairs), log_ratio: f64::NEG_INFINITY }
    }
}

/// What was found being aligned closely.
pub(super) struct Confirming {
    compared: Compared,
    fine: GlobalResult,
    /// Where to align it from besides.
    rest: VecDeque<Pose>,
}

/// Both clouds, ready to be laid over each other.
pub(super) struct Judge {
    pub(super) source: Described,
    pub(super) target: Described,
    tree: KdTree,
    pub(super) evidence: Evidence,
    icp: IcpParams,
    prepared: Option<(PreparedCloud, PreparedCloud)>,
    size: f64,
}

impl Judge {
    pub(super) fn new(source: Described, target: Described, params: &GlobalParams) -> Result<Self, RegistrationError> {
        let size = params.voxel_size_m;
        let icp = IcpParams {
            max_distance_m: 2.0 * size,
            max_iterations: 30,
            translation_tolerance_m: 1e-3 * size,
            rotation_tolerance_rad: 1e-4,
            ..IcpParams::lidar(IcpMethod::Gicp)
        };
        let prepared = match params.refine {
            true => Some((PreparedCloud::source(&source.cloud, &icp)?, PreparedCloud::target(&target.cloud, &icp)?)),
            false => None,
        };
        let evidence = Evidence::new(&source, &target, size);
        Ok(Self { tree: KdTree::build(&target.cloud.positions), evidence, source, target, icp, prepared, size })
    }

    /// The likeliest few candidates refined, which costs most; those that most speaks for first.
    pub(super) fn refine(&self, candidates: &[Candidate]) -> Vec<Refined> {
        let mut ranked: Vec<(f64, &Candidate)> =
            candidates.iter().map(|c| (self.evidence.roughly(&c.t_target_source), c)).collect();
        ranked.sort_by(|a, b| b.0.total_cmp(&a.0));
        let mut refined: Vec<Refined> = ranked.iter().take(REFINED).map(|(_, c)| self.refined(c)).collect();
        // Stable: of equals, the earlier candidate stays first.
        refined.sort_by(|a, b| b.support.total_cmp(&a.support));
        refined
    }

    /// The refined candidate that most speaks for, and whether to believe it.
    pub(super) fn judged(&self, refined: &[Refined], num_pairs: usize) -> Judged {
        let Some(first) = refined.first() else { return Judged::nothing(num_pairs) };
        let (best, compared) = self.settled(first.clone());
        let other = refined.iter().find(|r| !r.is_like(&best, self.size));
        Judged { answer: self.result(&best, &compared, other, num_pairs), log_ratio: compared.of.log_ratio }
    }

    /// A candidate moved along while more speaks for that, with what speaks for it and for its like.
    fn settled(&self, mut best: Refined) -> (Refined, Compared) {
        let mut compared = self.evidence.compare(&best.t_target_source);
        for _ in 0..MOVES {
            let Some((_, t_target_source)) = compared.rival.filter(|r| r.0.log_ratio > compared.of.log_ratio) else {
                break;
            };
            let moved = self.refined(&Candidate { t_target_source, num_pairs: best.num_pairs });
            let of_moved = self.evidence.compare(&moved.t_target_source);
            if of_moved.of.log_ratio <= compared.of.log_ratio {
                break;
            }
            (best, compared) = (moved, of_moved);
        }
        (best, compared)
    }

    /// What was found, aligned closely. Little overlap may coincide nearly as well a degree or two off: from there is to be tried,
    /// too.
    pub(super) fn confirming(
        &self,
        Judged { answer: found, .. }: &Judged,
        finish: impl Fn(GlobalResult) -> GlobalResult,
    ) -> Confirming {
        let fine = finish(found.clone());
        let compared = self.evidence.compare(&fine.t_target_source);
        let is_little = found.overlap < LITTLE_OVERLAP;
        let turned = is_little.then(|| self.evidence.turned(&found.t_target_source, TURN));
        Confirming { compared, fine, rest: turned.into_iter().flatten().collect() }
    }

    /// What was found, once it is aligned closely, if nothing is left to be tried: where the truth is, more speaks for that than
    /// before, and what speaks for a slide along walls goes with the last voxel.
    pub(super) fn confirm(
        &self,
        Judged { answer: found, log_ratio }: &Judged,
        mut c: Confirming,
        finish: impl Fn(GlobalResult) -> GlobalResult,
    ) -> ControlFlow<GlobalResult, Confirming> {
        if let Some(t_target_source) = c.rest.pop_front() {
            let fine = finish(GlobalResult { t_target_source, ..found.clone() });
            let compared = self.evidence.compare(&fine.t_target_source);
            if compared.of.log_ratio > c.compared.of.log_ratio {
                (c.compared, c.fine) = (compared, fine);
            }
            return ControlFlow::Continue(c);
        }
        let Confirming { compared, fine, .. } = c;
        if compared.of.log_ratio < *log_ratio && !self.is_near(&found.t_target_source, &fine.t_target_source) {
            return ControlFlow::Break(found.clone());
        }
        let slid = compared.rival.map_or(0.0, |r| r.0.evidence).max(found.rival_evidence);
        let outcome = outcome(compared.of.evidence, slid);
        ControlFlow::Break(GlobalResult { outcome, evidence: compared.of.evidence, rival_evidence: slid, ..fine })
    }

    /// Whether a refinement stayed where it was, within a voxel at the source's middle.
    fn is_near(&self, before: &Pose, after: &Pose) -> bool {
        let positions = &self.source.cloud.positions;
        let sum: Vector3<f64> = positions.iter().map(|p| p.coords.cast::<f64>()).sum();
        let center = Point3::from(sum / positions.len().max(1) as f64);
        (before * center - after * center).norm() < self.size
    }

    /// The candidate refined, if that was asked for.
    fn refined(&self, candidate: &Candidate) -> Refined {
        let (mut t_target_source, mut covariance) = (candidate.t_target_source, Covariance6::zeros());
        if let Some((source, target)) = &self.prepared
            && let Ok(result) = align(source, target, &t_target_source, &self.icp)
        {
            (t_target_source, covariance) = (result.t_target_source, result.covariance);
        }
        let support = self.evidence.roughly(&t_target_source);
        Refined { t_target_source, covariance, support, num_pairs: candidate.num_pairs }
    }

    /// Share of the source that coincides with the target, weighted by curvature, and how far apart it is there (m).
    fn overlap(&self, t_target_source: &Pose) -> (f64, f64) {
        let cloud = &self.source.cloud;
        let (Some(normals), Some(target_normals)) = (&cloud.normals, &self.target.cloud.normals) else {
            return (0.0, 0.0);
        };
        let step = cloud.len().div_ceil(SAMPLE).max(1);
        let reach = COINCIDE * self.size as f32;
        let sums: Vec<[f64; 4]> = (0..cloud.len())
            .into_par_iter()
            .step_by(step)
            .with_min_len(64)
            .map(|i| {
                let weight = f64::from(self.source.curvature[i] + FLAT_WEIGHT);
                let p: Point3<f32> = (t_target_source * cloud.positions[i].cast::<f64>()).cast();
                let Some(near) = self.tree.nearest_within(&p, reach) else { return [weight, 0.0, 0.0, 0.0] };
                let n: Vector3<f32> = (t_target_source.rotation * normals[i].cast::<f64>()).cast();
                if n.dot(&target_normals[near.index]).abs() < PARALLEL {
                    return [weight, 0.0, 0.0, 0.0];
                }
                [weight, weight, f64::from(near.distance2), 1.0]
            })
            .collect();
        let [all, fits, squares, count] = sums.iter().fold([0.0; 4], |s, v| std::array::from_fn(|k| s[k] + v[k]));
        (fits / all.max(1e-12), (squares / count.max(1.0)).sqrt())
    }

    fn result(&self, best: &Refined, compared: &Compared, other: Option<&Refined>, num_pairs: usize) -> GlobalResult {
        let other = other.map(|r| (r.support, r.t_target_source));
        let slid = compared.rival.map(|(support, t)| (support.evidence, t));
        let rival = other.into_iter().chain(slid).max_by(|a, b| a.0.total_cmp(&b.0));
        let outcome = outcome(compared.of.evidence, rival.map_or(0.0, |r| r.0));
        let (overlap, inlier_rmse_m) = self.overlap(&best.t_target_source);
        GlobalResult {
            outcome,
            t_target_source: best.t_target_source,
            covariance: best.covariance,
            degenerate_axes: [false; 6],
            overlap,
            rival_overlap: rival.map_or(0.0, |(_, t)| self.overlap(&t).0),
            evidence: compared.of.evidence,
            rival_evidence: rival.map_or(0.0, |r| r.0),
            inlier_rmse_m,
            num_pairs,
            num_agreeing: best.num_pairs,
        }
    }
}
