//! Metrics against ground truth.

use super::toolbox::{budget, tenant_of};
use crate::reason;
use crate::{Error, Result, Service};
use percept_evaluation::{
    Alignment, Delta, DetectionScore, EvaluationError, FoundObject, PosePair, RelationScore, Trajectory,
    TrajectoryParams, TrajectoryScore, TrueObject, TrueRelation, aligned_pairs, match_detections, score_relations,
    score_trajectory,
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
    /// Added to the estimate's stamps, seconds.
    pub estimate_offset_s: f64,
    /// Stretch of the relative error.
    pub delta: Delta,
    /// Whether a stretch begins at every pose.
    pub all_pairs: bool,
    /// Lengths of the segments of the drift, metres; empty: KITTI's.
    pub segment_lengths_m: Vec<f64>,
    /// Whether the compared poses are wanted.
    pub return_pairs: bool,
}

impl Service {
    /// ATE and RPE as evo computes them, drift as KITTI does; the compared poses if they are wanted.
    ///
    /// # Errors
    /// `EVALUATION_INVALID`: stamps that decrease or do not match, poses that are not finite, parameters out of
    /// bounds.
    pub async fn evaluate_trajectory(
        &self,
        owner: &str,
        comparison: TrajectoryComparison,
    ) -> Result<(TrajectoryScore, Vec<PosePair>)> {
        self.evaluate(owner, move || compare(comparison)).await
    }

    /// A trajectory (ascending stamps) judged by checked motions; poses are interpolated over at most `max_gap_s`
    /// (2 if none).
    ///
    /// # Errors
    /// `EVALUATION_INVALID`: stamps that decrease, a gap that is not positive, no relation that can be judged.
    pub async fn evaluate_relations(
        &self,
        owner: &str,
        trajectory: Vec<Stamped<Pose>>,
        relations: Vec<TrueRelation>,
        max_gap_s: Option<f64>,
    ) -> Result<RelationScore> {
        let work = move || score_relations(&Trajectory::new(trajectory)?, &relations, max_gap_s.unwrap_or(2.0));
        self.evaluate(owner, work).await
    }

    async fn evaluate<T: Send + 'static>(
        &self,
        owner: &str,
        work: impl FnOnce() -> std::result::Result<T, EvaluationError> + Send + 'static,
    ) -> Result<T> {
        let asker = self.compute.admission().asker(tenant_of(owner), owner)?;
        self.compute.request_within(&asker, budget(&self.limits), |_| work()).await?.map_err(|e| evaluation_error(&e))
    }

    /// Precision and recall of boxes; a pair matches at `min_iou` (0.25 if none).
    ///
    /// # Errors
    /// `EVALUATION_INVALID` for a threshold outside (0, 1].
    pub async fn evaluate_detections(
        &self,
        owner: &str,
        truth: Vec<TrueObject>,
        found: Vec<FoundObject>,
        min_iou: Option<f64>,
    ) -> Result<DetectionScore> {
        let work = move || match_detections(&truth, &found, min_iou.unwrap_or(0.25));
        self.evaluate(owner, work).await
    }
}

fn compare(c: TrajectoryComparison) -> std::result::Result<(TrajectoryScore, Vec<PosePair>), EvaluationError> {
    let mut params = TrajectoryParams {
        alignment: c.alignment,
        estimate_offset_s: c.estimate_offset_s,
        delta: c.delta,
        all_pairs: c.all_pairs,
        ..TrajectoryParams::default()
    };
    if let Some(s) = c.max_stamp_difference_s {
        params.max_difference_s = s;
    }
    if !c.segment_lengths_m.is_empty() {
        params.segments.lengths_m = c.segment_lengths_m;
    }
    let (reference, estimate) = (Trajectory::new(c.reference)?, Trajectory::new(c.estimate)?);
    let score = score_trajectory(&reference, &estimate, &params)?;
    let pairs = if c.return_pairs { aligned_pairs(&reference, &estimate, &params)?.0 } else { Vec::new() };
    Ok((score, pairs))
}

fn evaluation_error(e: &EvaluationError) -> Error {
    Error::invalid(reason::EVALUATION_INVALID, "", e.to_string())
}
