//! All figures of a trajectory at once, as `replay` and `eval` print them.

use crate::{
    AbsoluteError, Alignment, Delta, EvaluationError, PosePair, RelativeError, SegmentDrift, SegmentParams, Similarity,
    Trajectory, absolute_error, align, associate, drift, relative_error, trajectory::path_length,
};
use serde::{Deserialize, Serialize};

/// How a trajectory is judged.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrajectoryParams {
    /// Largest difference between the stamps of a pair of poses, seconds. evo's default.
    pub max_difference_s: f64,
    /// Added to the estimate's stamps before they are compared, seconds.
    pub estimate_offset_s: f64,
    /// How the estimate is laid onto the reference.
    pub alignment: Alignment,
    /// Stretch of the relative error.
    pub delta: Delta,
    /// Whether a stretch begins at every pose (evo's `--all_pairs`) instead of where the one before ended.
    pub all_pairs: bool,
    /// Segments of KITTI's drift.
    pub segments: SegmentParams,
}

impl Default for TrajectoryParams {
    fn default() -> Self {
        Self {
            max_difference_s: 0.01,
            estimate_offset_s: 0.0,
            alignment: Alignment::Se3,
            delta: Delta::Frames(1),
            all_pairs: false,
            segments: SegmentParams::default(),
        }
    }
}

/// The figures of a trajectory.
#[derive(Debug, Clone, PartialEq)]
pub struct TrajectoryScore {
    /// Poses compared.
    pub num_pairs: usize,
    /// Length of the reference's path over the compared poses, metres.
    pub reference_length_m: f64,
    /// Length of the estimate's path over the compared poses, metres, before any scale.
    pub estimate_length_m: f64,
    /// Absolute error after alignment.
    pub absolute: AbsoluteError,
    /// Relative error; `None` if the trajectory is shorter than the stretch.
    pub relative: Option<RelativeError>,
    /// See [`drift::end_drift_percent`]; computed on the estimate at the alignment's scale.
    pub end_drift_percent: Option<f64>,
    /// See [`drift::segment_drift`]; `None` for paths shorter than the shortest segment.
    pub segment_drift: Option<SegmentDrift>,
}

/// Associates, aligns and measures.
///
/// # Errors
/// Those of [`aligned_pairs`], [`absolute_error`] and the parameters.
pub fn score_trajectory(
    reference: &Trajectory,
    estimate: &Trajectory,
    params: &TrajectoryParams,
) -> Result<TrajectoryScore, EvaluationError> {
    let (pairs, similarity) = aligned_pairs(reference, estimate, params)?;
    let mut absolute = absolute_error(&pairs, Alignment::None)?;
    absolute.similarity = similarity;
    let relative = match relative_error(&pairs, params.delta, params.all_pairs, 1.0) {
        Err(EvaluationError::NoPairs { .. }) => None,
        other => Some(other?),
    };
    Ok(TrajectoryScore {
        num_pairs: pairs.len(),
        reference_length_m: path_length(pairs.iter().map(|p| &p.reference)),
        estimate_length_m: path_length(pairs.iter().map(|p| &p.estimate)) / similarity.scale,
        absolute,
        relative,
        end_drift_percent: drift::end_drift_percent(&pairs),
        segment_drift: drift::segment_drift(&pairs, &params.segments)?,
    })
}

/// The poses that belong together, the estimates laid onto the reference, and by what transform.
///
/// # Errors
/// Those of [`associate`] and [`align`], and `InvalidParam` for an offset that is not finite.
pub fn aligned_pairs(
    reference: &Trajectory,
    estimate: &Trajectory,
    params: &TrajectoryParams,
) -> Result<(Vec<PosePair>, Similarity), EvaluationError> {
    let shifted = estimate.shifted(params.estimate_offset_s)?;
    let mut pairs = associate(reference, shifted.as_ref(), params.max_difference_s)?;
    let similarity = align(&pairs, params.alignment)?;
    for pair in &mut pairs {
        pair.estimate = similarity.apply(&pair.estimate);
    }
    Ok((pairs, similarity))
}
