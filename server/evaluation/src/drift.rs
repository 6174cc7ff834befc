//! Drift: error in proportion to the way travelled, as KITTI counts it and at the end of the path.

use crate::{EvaluationError, PosePair, positive, trajectory::path_length};
use serde::{Deserialize, Serialize};

/// Lengths that segments may have, each of which takes a pass over the poses.
const MOST_LENGTHS: usize = 64;

/// Which segments the KITTI figure is averaged over.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SegmentParams {
    /// Lengths of the segments along the reference, metres; each positive.
    pub lengths_m: Vec<f64>,
    /// A segment starts at every so many poses; at least 1. KITTI: 10.
    pub start_step_frames: usize,
}

impl Default for SegmentParams {
    fn default() -> Self {
        Self { lengths_m: (1..=8).map(|i| 100.0 * f64::from(i)).collect(), start_step_frames: 10 }
    }
}

impl SegmentParams {
    /// Checks the bounds.
    ///
    /// # Errors
    /// `InvalidParam` naming the field.
    pub fn validate(&self) -> Result<(), EvaluationError> {
        if self.lengths_m.len() > MOST_LENGTHS {
            let value = self.lengths_m.len() as f64;
            return Err(EvaluationError::InvalidParam {
                field: "number of lengths_m",
                value,
                requirement: "at most 64",
            });
        }
        for &length in &self.lengths_m {
            positive("lengths_m", length)?;
        }
        positive("start_step_frames", self.start_step_frames as f64).map(drop)
    }
}

/// KITTI's drift, averaged over all segments.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct SegmentDrift {
    /// Translation error at the end of a segment over its length, percent.
    pub translation_percent: f64,
    /// Rotation error at the end of a segment over its length, degrees a metre.
    pub rotation_deg_per_m: f64,
    /// Segments averaged.
    pub num_segments: usize,
}

/// Mean drift over segments of fixed lengths; `None` if the reference is shorter than the shortest.
///
/// Source: Geiger, Lenz, Urtasun, "Are we ready for autonomous driving? The KITTI vision benchmark suite", 2012,
/// and its development kit: a segment ends at the first pose beyond its length, and its nominal length divides.
///
/// # Errors
/// `InvalidParam` from the parameters.
pub fn segment_drift(pairs: &[PosePair], params: &SegmentParams) -> Result<Option<SegmentDrift>, EvaluationError> {
    params.validate()?;
    let mut travelled = Vec::with_capacity(pairs.len());
    let mut length = 0.0;
    for (i, pair) in pairs.iter().enumerate() {
        if i > 0 {
            length += (pair.reference.translation.vector - pairs[i - 1].reference.translation.vector).norm();
        }
        travelled.push(length);
    }
    let (mut translation, mut rotation, mut count) = (0.0, 0.0, 0usize);
    for first in (0..pairs.len()).step_by(params.start_step_frames) {
        for &length in &params.lengths_m {
            let last = travelled.partition_point(|&d| d <= travelled[first] + length);
            if last == pairs.len() {
                continue;
            }
            let (a, b) = (&pairs[first], &pairs[last]);
            let error = (a.estimate.inverse() * b.estimate).inverse() * (a.reference.inverse() * b.reference);
            translation += error.translation.vector.norm() / length;
            rotation += error.rotation.angle().to_degrees() / length;
            count += 1;
        }
    }
    Ok((count > 0).then(|| SegmentDrift {
        translation_percent: 100.0 * translation / count as f64,
        rotation_deg_per_m: rotation / count as f64,
        num_segments: count,
    }))
}

/// Distance between the last true and the last estimated position when the **first** poses are laid onto each
/// other, over the length of the reference's path, percent; `None` if the reference did not move.
///
/// The figure for paths too short for [`segment_drift`]. It counts the error of the first rotation in full.
pub fn end_drift_percent(pairs: &[PosePair]) -> Option<f64> {
    let (first, last) = (pairs.first()?, pairs.last()?);
    let length = path_length(pairs.iter().map(|p| &p.reference));
    let error = (first.estimate.inverse() * last.estimate).translation.vector
        - (first.reference.inverse() * last.reference).translation.vector;
    (length > 0.0).then(|| 100.0 * error.norm() / length)
}

#[cfg(test)]
mod tests {
    use super::*;
    use percept_geometry::{Pose, Timestamp, se3};

    fn straight(metres: usize, scale: f64, yaw: f64) -> Vec<PosePair> {
        let t_estimate_reference = se3::from_xy_yaw(7.0, 8.0, yaw);
        (0..=metres)
            .map(|i| PosePair {
                stamp: Timestamp(i as i64),
                reference: Pose::translation(i as f64, 0.0, 0.0),
                estimate: t_estimate_reference * Pose::translation(scale * i as f64, 0.0, 0.0),
            })
            .collect()
    }

    #[test]
    fn two_percent_too_long_is_two_percent_drift() {
        let pairs = straight(250, 1.02, 0.4);
        assert!((end_drift_percent(&pairs).unwrap() - 2.0).abs() < 1e-9);
        let params = SegmentParams::default();
        let drift = segment_drift(&pairs, &params).unwrap().unwrap();
        // A segment ends one pose beyond its length: 2.02 m over 100 m, 4.02 m over 200 m.
        assert!(drift.translation_percent > 2.0 && drift.translation_percent < 2.03);
        assert!(drift.rotation_deg_per_m < 1e-9);
        // Starts 0, 10, ..., 140 reach 101 m further, starts 0 ... 40 reach 201 m.
        assert_eq!(drift.num_segments, 15 + 5);
    }

    #[test]
    fn short_and_still_paths_have_no_such_figure() {
        assert_eq!(segment_drift(&straight(100, 1.0, 0.0), &SegmentParams::default()), Ok(None));
        assert!(end_drift_percent(&straight(0, 1.0, 0.0)).is_none());
        assert!(end_drift_percent(&[]).is_none());
        let bad = SegmentParams { start_step_frames: 0, ..SegmentParams::default() };
        assert!(segment_drift(&[], &bad).is_err());
    }
}
