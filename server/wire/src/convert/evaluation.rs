//! Trajectories and labelled boxes to judge; metrics back.

use super::{geometry, required, scene};
use crate::v1;
use percept_evaluation::{
    Alignment, Delta, DetectionScore, ErrorStatistics, FoundObject, PosePair, RelationScore, TrajectoryScore,
    TrueObject, TrueRelation,
};
use percept_geometry::{Pose, Stamped, Timestamp};
use percept_service::reason;
use percept_service::{Error, Result, TrajectoryComparison};

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
        Ok(A::Origin) => Alignment::Origin,
        Ok(A::None) => Alignment::None,
        Err(_) => return Err(super::unknown_enum("alignment", r.alignment)),
    };
    Ok(TrajectoryComparison {
        reference: poses("reference", &r.reference)?,
        estimate: poses("estimate", &r.estimate)?,
        alignment,
        max_stamp_difference_s: r.max_stamp_difference_s,
        estimate_offset_s: r.estimate_offset_s,
        delta: delta(r)?,
        all_pairs: r.all_pairs,
        segment_lengths_m: r.segment_lengths_m.clone(),
        return_pairs: r.return_pairs,
    })
}

fn delta(r: &v1::EvaluateTrajectoryRequest) -> Result<Delta> {
    use v1::DeltaUnit as U;
    let value = r.delta.unwrap_or(1.0);
    match U::try_from(r.delta_unit) {
        Ok(U::Unspecified | U::Frames) if value.fract() == 0.0 && (1.0..=1e9).contains(&value) => {
            Ok(Delta::Frames(value as usize))
        }
        Ok(U::Unspecified | U::Frames) => {
            let message = format!("delta: {value} is not a whole number of frames above 0");
            Err(Error::invalid(reason::EVALUATION_INVALID, "delta", message))
        }
        Ok(U::Metres) => Ok(Delta::Metres(value)),
        Ok(U::Seconds) => Ok(Delta::Seconds(value)),
        Ok(U::Degrees) => Ok(Delta::Degrees(value)),
        Err(_) => Err(super::unknown_enum("delta_unit", r.delta_unit)),
    }
}

/// A trajectory and the relations to judge it by.
///
/// # Errors
/// Poses that are none.
pub fn relations(r: &v1::EvaluateRelationsRequest) -> Result<(Vec<Stamped<Pose>>, Vec<TrueRelation>)> {
    let relation = |r: &v1::TrajectoryRelation| {
        let t_1_2 = geometry::pose("relations", r.t_1_2.as_ref())?;
        Ok(TrueRelation { stamp_1: Timestamp(r.stamp_1_ns), stamp_2: Timestamp(r.stamp_2_ns), t_1_2 })
    };
    let relations: Result<Vec<TrueRelation>> = r.relations.iter().map(relation).collect();
    Ok((poses("trajectory", &r.trajectory)?, relations?))
}

/// Metrics as a message.
pub fn relation_score_to(s: &RelationScore) -> v1::RelationMetrics {
    let loops = s.loops.as_ref();
    v1::RelationMetrics {
        num_relations: s.translation_m.count as u64,
        num_missed: s.num_missed as u64,
        translation_m: Some(statistics(&s.translation_m)),
        rotation_deg: Some(statistics(&s.rotation_deg)),
        num_loops: loops.map_or(0, |l| l.0.count as u64),
        loop_translation_m: loops.map(|l| statistics(&l.0)),
        loop_rotation_deg: loops.map(|l| statistics(&l.1)),
    }
}

/// Compared poses as messages.
pub fn pairs_to(pairs: &[PosePair]) -> Vec<v1::PosePair> {
    let pair = |p: &PosePair| v1::PosePair {
        stamp_ns: p.stamp.nanos(),
        reference: Some(geometry::pose_to(&p.reference)),
        estimate: Some(geometry::pose_to(&p.estimate)),
    };
    pairs.iter().map(pair).collect()
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
        ate_rot_deg: Some(statistics(&s.absolute.rotation_deg)),
        segment_drift: s.segment_drift.map(|d| v1::SegmentDrift {
            translation_percent: d.translation_percent,
            rotation_deg_per_m: d.rotation_deg_per_m,
            num_segments: d.num_segments as u64,
        }),
        t_reference_estimate: Some(geometry::pose_to(&s.absolute.similarity.t_reference_estimate)),
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
