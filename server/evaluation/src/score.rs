//! All figures of a trajectory at once, as `replay` and `eval` print them.

use crate::{
    AbsoluteError, Alignment, Delta, EvaluationError, RelativeError, SegmentDrift, SegmentParams, Trajectory,
    absolute_error, associate, drift, relative_error, trajectory::path_length,
};
use serde::{Deserialize, Serialize};

/// How a trajectory is judged.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrajectoryParams {
    /// Largest difference between the stamps of a pair of poses, seconds. evo's default.
    pub max_difference_s: f64,
    /// How the estimate is laid onto the reference.
    pub alignment: Alignment,
    /// Stretch of the relative error.
    pub delta: Delta,
    /// Segments of KITTI's drift.
    pub segments: SegmentParams,
}

impl Default for TrajectoryParams {
    fn default() -> Self {
        Self {
            max_difference_s: 0.01,
            alignment: Alignment::Se3,
            delta: Delta::Frames(1),
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
/// Those of [`associate`], [`absolute_error`] and the parameters.
pub fn score_trajectory(
    reference: &Trajectory,
    estimate: &Trajectory,
    params: &TrajectoryParams,
) -> Result<TrajectoryScore, EvaluationError> {
    let mut pairs = associate(reference, estimate, params.max_difference_s)?;
    let estimate_length_m = path_length(pairs.iter().map(|p| &p.estimate));
    let absolute = absolute_error(&pairs, params.alignment)?;
    for pair in &mut pairs {
        pair.estimate = absolute.similarity.apply(&pair.estimate);
    }
    let relative = match relative_error(&pairs, params.delta, 1.0) {
        Err(EvaluationError::NoPairs { .. }) => None,
        other => Some(other?),
    };
    Ok(TrajectoryScore {
        num_pairs: pairs.len(),
        reference_length_m: path_length(pairs.iter().map(|p| &p.reference)),
        estimate_length_m,
        absolute,
        relative,
        end_drift_percent: drift::end_drift_percent(&pairs),
        segment_drift: drift::segment_drift(&pairs, &params.segments)?,
    })
}
