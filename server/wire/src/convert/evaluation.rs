//! Trajectories and labelled boxes to judge; metrics back.

use super::{geometry, required, scene};
use crate::v1;
use percept_evaluation::{Alignment, DetectionScore, ErrorStatistics, FoundObject, TrajectoryScore, TrueObject};
use percept_geometry::{Pose, Stamped, Timestamp};
use percept_service::{Result, TrajectoryComparison};

fn poses(field: &'static str, poses: &[v1::StampedPose]) -> Result<Vec<Stamped<Pose>>> {
    let convert = |p: &v1::StampedPose| {
        let value = geometry::pose(field, p.pose.as_ref())?;
        Ok(Stamped { stamp: Timestamp(p.stamp_ns), value })
    };
    poses.iter().map(convert).collect()
}

/// Two trajectories to compare.
///
/// # Errors
/// Poses that are none; an unknown alignment.
pub fn comparison(r: &v1::EvaluateTrajectoryRequest) -> Result<TrajectoryComparison> {
    use v1::TrajectoryAlignment as A;
    let alignment = match A::try_from(r.alignment) {
        Ok(A::Unspecified | A::Se3) => Alignment::Se3,
        Ok(A::Sim3) => Alignment::Sim3,
        Ok(A::None) => Alignment::None,
        Err(_) => return Err(super::unknown_enum("alignment", r.alignment)),
    };
    Ok(TrajectoryComparison {
        reference: poses("reference", &r.reference)?,
        estimate: poses("estimate", &r.estimate)?,
        alignment,
        max_stamp_difference_s: r.max_stamp_difference_s,
    })
}

fn statistics(s: &ErrorStatistics) -> v1::ErrorStatistics {
    v1::ErrorStatistics { rmse: s.rmse, mean: s.mean, median: s.median, std: s.std, min: s.min, max: s.max }
}

/// Metrics as a message.
pub fn score_to(s: &TrajectoryScore) -> v1::TrajectoryMetrics {
    v1::TrajectoryMetrics {
        num_pairs: s.num_pairs as u64,
        ate_m: Some(statistics(&s.absolute.translation_m)),
        rpe_trans_m: s.relative.as_ref().map(|r| statistics(&r.translation_m)),
        rpe_rot_deg: s.relative.as_ref().map(|r| statistics(&r.rotation_deg)),
        path_length_m: s.reference_length_m,
        drift_percent: s.end_drift_percent,
        scale: s.absolute.similarity.scale,
    }
}

/// True and found boxes.
///
/// # Errors
/// Boxes that are none, unknown classes.
pub fn boxes(r: &v1::EvaluateDetectionsRequest) -> Result<(Vec<TrueObject>, Vec<FoundObject>)> {
    let convert = |field: &'static str, b: &v1::LabelledBox| {
        let bbox = geometry::oriented_box(field, &required("box", b.r#box).map_err(|e| e.within(field))?)?;
        Ok((scene::class(b.object_class)?, b.confidence, bbox))
    };
    let truth: Result<Vec<FoundObject>> = r.truth.iter().map(|b| convert("truth", b)).collect();
    let found: Result<Vec<FoundObject>> = r.detections.iter().map(|b| convert("detections", b)).collect();
    Ok((truth?.into_iter().map(|(class, _, bbox)| (class, bbox)).collect(), found?))
}

/// Metrics as a message.
pub fn detection_to(s: &DetectionScore) -> v1::DetectionMetrics {
    v1::DetectionMetrics {
        true_positives: s.true_positives as u32,
        false_positives: s.false_positives as u32,
        false_negatives: s.false_negatives as u32,
        precision: s.precision,
        recall: s.recall,
        mean_iou: s.mean_iou,
        class_accuracy: s.class_correct,
    }
}
