//! Parameters and answer of global registration.

use super::super::RegistrationError;
use percept_geometry::{Covariance6, Pose};
use serde::{Deserialize, Serialize};

/// How sets of right pairs are found among wrong ones.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum GlobalMethod {
    /// By the graph of pairs whose distances agree, ranked by how many pairs two of them both agree with.
    #[default]
    Consistency,
    /// By random samples of four pairs.
    Ransac,
}

/// Parameters of global registration.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GlobalParams {
    /// Edge of the voxels to which the clouds are thinned, metres, above 0. Everything else scales with it: 0.5 for
    /// outdoor lidars, 0.05 for rooms.
    pub voxel_size_m: f64,
    /// How right pairs are told from wrong ones.
    pub method: GlobalMethod,
    /// Whether the best candidates are refined by GICP before they are judged, and the answer on voxels half as large
    /// in the end.
    pub refine: bool,
    /// RANSAC only: samples at most, 1 to 10000000.
    pub max_iterations: usize,
    /// Same seed, same answer.
    pub seed: u64,
}

impl Default for GlobalParams {
    fn default() -> Self {
        Self { voxel_size_m: 0.05, method: GlobalMethod::default(), refine: true, max_iterations: 100_000, seed: 0 }
    }
}

impl GlobalParams {
    /// Checks every field.
    ///
    /// # Errors
    /// `BadParam` with field, value and remedy.
    pub fn validate(&self) -> Result<(), RegistrationError> {
        if !(self.voxel_size_m.is_finite() && self.voxel_size_m > 0.0) {
            return Err(RegistrationError::BadParam {
                field: "voxel_size_m",
                value: self.voxel_size_m,
                requirement: "positive and finite",
                remedy: "use 0.5 outdoors, 0.05 in rooms",
            });
        }
        if !(1..=10_000_000).contains(&self.max_iterations) {
            return Err(RegistrationError::BadParam {
                field: "max_iterations",
                value: self.max_iterations as f64,
                requirement: "within 1 to 10000000",
                remedy: "use 100000",
            });
        }
        Ok(())
    }
}

/// Whether the answer is to be believed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum GlobalOutcome {
    /// What both clouds saw coincides where chance would not have it so, and no other way to lay them over each other,
    /// nor sliding this one along, does nearly as well.
    Found,
    /// The best found, but what coincides would do so by chance, or too much contradicts it.
    Doubtful,
    /// Two different ways fit nearly as well: the place repeats itself.
    Ambiguous,
    /// Nothing was found: too few pairs agree.
    NotFound,
}

/// Where a cloud belongs.
#[derive(Debug, Clone, PartialEq)]
pub struct GlobalResult {
    /// Whether to believe it. Use the transform only if `Found`.
    pub outcome: GlobalOutcome,
    /// Source to target; identity if nothing was found.
    pub t_target_source: Pose,
    /// 6x6, right perturbation in the source; surfaces within some 16 voxels are taken to err together. Zero without
    /// refinement.
    pub covariance: Covariance6,
    /// Axes of the source frame, about the source's centroid (x, y, z, rotation x, y, z), that the clouds leave open, as
    /// the refinement sees it; none without one.
    pub degenerate_axes: [bool; 6],
    /// Share of the smaller cloud that coincides with the other within a voxel, 0 to 1.
    pub overlap: f64,
    /// The same of the way that differs from the answer and for which most speaks.
    pub rival_overlap: f64,
    /// Natural logarithm of how much likelier what the clouds show is if the answer is right than if it is chance;
    /// found from 25. What lies within 16 voxels may be one thing that comes again elsewhere, and says 8 at most. Negative
    /// infinity if nothing was found.
    pub evidence: f64,
    /// The same of the best way that differs from the answer, the answer slid along among them.
    pub rival_evidence: f64,
    /// Root mean square distance of the points that coincide, metres.
    pub inlier_rmse_m: f64,
    /// Pairs of points with like features.
    pub num_pairs: usize,
    /// Of these, the pairs that the answer puts within one and a half voxels.
    pub num_agreeing: usize,
}

impl GlobalResult {
    pub(super) fn nothing(num_pairs: usize) -> Self {
        Self {
            outcome: GlobalOutcome::NotFound,
            t_target_source: Pose::identity(),
            covariance: Covariance6::zeros(),
            degenerate_axes: [false; 6],
            overlap: 0.0,
            rival_overlap: 0.0,
            evidence: f64::NEG_INFINITY,
            rival_evidence: 0.0,
            inlier_rmse_m: 0.0,
            num_pairs,
            num_agreeing: 0,
        }
    }
}
