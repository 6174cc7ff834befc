//! Whether two clouds lie well over each other.

use super::super::{IcpMethod, IcpParams, PreparedCloud, RegistrationError, align};
use super::keypoints::Described;
use super::{Candidate, GlobalOutcome, GlobalParams, GlobalResult};
use crate::search::KdTree;
use nalgebra::{Point3, Vector3};
use percept_geometry::{Covariance6, Pose};
use rayon::prelude::*;

/// Points that are looked up for an overlap, about.
const SAMPLE: usize = 1500;
/// Points coincide within so many voxels, if their normals are within 45 degrees of each other.
const COINCIDE: f32 = 1.0;
const PARALLEL: f32 = 0.7;
/// Flat places fit everywhere: a point counts by how far its surroundings are from flat, plus this.
const FLAT_WEIGHT: f32 = 0.02;
/// Overlap from which an answer may be believed, and the least number of agreeing pairs.
const BELIEVED_OVERLAP: f64 = 0.35;
const BELIEVED_PAIRS: usize = 10;
/// Less overlap will do where so many pairs agree as never do by chance, and nothing else comes near.
const CERTAIN_OVERLAP: f64 = 0.25;
const CERTAIN_PAIRS: usize = 40;
const CERTAIN_RIVAL: f64 = 0.6;
/// A different way that reaches this share of the overlap makes the answer ambiguous.
const RIVAL: f64 = 0.9;
/// Candidates that are refined.
const REFINED: usize = 3;

/// A candidate after its refinement.
struct Verdict {
    t_target_source: Pose,
    covariance: Covariance6,
    overlap: f64,
    rmse_m: f64,
    num_pairs: usize,
}

impl Verdict {
    /// Whether two put the cloud in about the same place.
    fn is_like(&self, other: &Self, size: f64) -> bool {
        let d = self.t_target_source.inverse() * other.t_target_source;
        // The centres of rotation differ from the origin: compare generously.
        d.rotation.angle() < 0.15 && d.translation.vector.norm() < 20.0 * size
    }
}

/// Both clouds, ready to be laid over each other.
pub(super) struct Judge {
    pub(super) source: Described,
    pub(super) target: Described,
    tree: KdTree,
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
        Ok(Self { tree: KdTree::build(&target.cloud.positions), source, target, icp, prepared, size })
    }

    /// The candidate that lays most of the clouds over each other, and whether to believe it.
    pub(super) fn best(&self, candidates: &[Candidate], num_pairs: usize) -> GlobalResult {
        // Refinement costs most: the likeliest few.
        let rough = |c: &Candidate| self.overlap(&c.t_target_source).0;
        let mut ranked: Vec<(f64, &Candidate)> = candidates.iter().map(|c| (rough(c), c)).collect();
        ranked.sort_by(|a, b| b.0.total_cmp(&a.0));
        let mut verdicts: Vec<Verdict> = ranked.iter().take(REFINED).map(|(_, c)| self.refined(c)).collect();
        // Stable: of equals, the earlier candidate stays first.
        verdicts.sort_by(|a, b| b.overlap.total_cmp(&a.overlap));
        let Some(best) = verdicts.first() else { return GlobalResult::nothing(num_pairs) };
        let rival = verdicts[1..].iter().filter(|v| !v.is_like(best, self.size)).map(|v| v.overlap).fold(0.0, f64::max);
        self.result(best, rival, num_pairs)
    }

    /// The candidate refined, if that was asked for, and judged.
    fn refined(&self, candidate: &Candidate) -> Verdict {
        let (mut t_target_source, mut covariance) = (candidate.t_target_source, Covariance6::zeros());
        if let Some((source, target)) = &self.prepared
            && let Ok(result) = align(source, target, &t_target_source, &self.icp)
        {
            (t_target_source, covariance) = (result.t_target_source, result.covariance);
        }
        let (overlap, rmse_m) = self.overlap(&t_target_source);
        Verdict { t_target_source, covariance, overlap, rmse_m, num_pairs: candidate.num_pairs }
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

    fn result(&self, best: &Verdict, rival_overlap: f64, num_pairs: usize) -> GlobalResult {
        let believed = best.overlap >= BELIEVED_OVERLAP && best.num_pairs >= BELIEVED_PAIRS;
        let certain = best.overlap >= CERTAIN_OVERLAP
            && best.num_pairs >= CERTAIN_PAIRS
            && rival_overlap < CERTAIN_RIVAL * best.overlap;
        let outcome = if !(believed || certain) {
            GlobalOutcome::Doubtful
        } else if rival_overlap > RIVAL * best.overlap {
            GlobalOutcome::Ambiguous
        } else {
            GlobalOutcome::Found
        };
        GlobalResult {
            outcome,
            t_target_source: best.t_target_source,
            covariance: best.covariance,
            degenerate_axes: [false; 6],
            overlap: best.overlap,
            rival_overlap,
            inlier_rmse_m: best.rmse_m,
            num_pairs,
            num_agreeing: best.num_pairs,
        }
    }
}
