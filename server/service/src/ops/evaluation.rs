//! Metrics against ground truth.

use crate::{Error, Result, Service};
use percept_evaluation::{
    Alignment, DetectionScore, EvaluationError, FoundObject, Trajectory, TrajectoryParams, TrajectoryScore, TrueObject,
    match_detections, score_trajectory,
};
use percept_geometry::{Pose, Stamped};

/// Two trajectories to compare.
#[derive(Debug, Clone)]
pub struct TrajectoryComparison {
    /// Truth, ascending stamps.
    pub reference: Vec<Stamped<Pose>>,
    /// Estimate, ascending stamps.
    pub estimate: Vec<Stamped<Pose>>,
    /// How the estimate is laid over the reference.
    pub alignment: Alignment,
    /// Stamps match within this, seconds; none: 0.01.
    pub max_stamp_difference_s: Option<f64>,
}

impl Service {
    /// ATE and RPE as evo computes them.
    ///
    /// # Errors
    /// `EVALUATION_INVALID`: stamps that decrease or do not match, poses that are not finite.
    pub async fn evaluate_trajectory(&self, comparison: TrajectoryComparison) -> Result<TrajectoryScore> {
        self.compute.request(move || compare(comparison)).await?.map_err(|e| evaluation_error(&e))
    }

    /// Precision and recall of boxes; a pair matches at `min_iou` (0.25 if none).
    ///
    /// # Errors
    /// `EVALUATION_INVALID` for a threshold outside (0, 1].
    pub async fn evaluate_detections(
        &self,
        truth: Vec<TrueObject>,
        found: Vec<FoundObject>,
        min_iou: Option<f64>,
    ) -> Result<DetectionScore> {
        let work = move || match_detections(&truth, &found, min_iou.unwrap_or(0.25));
        self.compute.request(work).await?.map_err(|e| evaluation_error(&e))
    }
}

fn compare(c: TrajectoryComparison) -> std::result::Result<TrajectoryScore, EvaluationError> {
    let mut params = TrajectoryParams { alignment: c.alignment, ..TrajectoryParams::default() };
    if let Some(s) = c.max_stamp_difference_s {
        params.max_difference_s = s;
    }
    score_trajectory(&Trajectory::new(c.reference)?, &Trajectory::new(c.estimate)?, &params)
}

fn evaluation_error(e: &EvaluationError) -> Error {
    Error::invalid("EVALUATION_INVALID", "", e.to_string())
}
