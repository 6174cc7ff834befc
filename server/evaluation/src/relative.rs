//! Relative error: how wrong the estimated motion is over a fixed stretch (RPE).

use crate::{ErrorStatistics, EvaluationError, PosePair, positive};
use serde::{Deserialize, Serialize};

/// How long a stretch is.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Delta {
    /// In poses.
    Frames(usize),
    /// In metres travelled by the estimate.
    Metres(f64),
}

/// Relative pose error.
#[derive(Debug, Clone, PartialEq)]
pub struct RelativeError {
    /// Length of the translation by which the motions differ, metres.
    pub translation_m: ErrorStatistics,
    /// Angle by which they differ, degrees.
    pub rotation_deg: ErrorStatistics,
}

/// Relative error over consecutive stretches: each starts where the one before ended (evo without `--all_pairs`).
///
/// `scale` is applied to the estimate first: 1, or what a similarity alignment found; a rigid alignment changes
/// nothing. Source: Sturm et al. 2012, eq. 1.
///
/// # Errors
/// `InvalidParam` for a delta that is not positive, `NoPairs` if the trajectory is shorter than two stretch ends.
pub fn relative_error(pairs: &[PosePair], delta: Delta, scale: f64) -> Result<RelativeError, EvaluationError> {
    positive("scale", scale)?;
    let ends = stretch_ends(pairs, delta, scale)?;
    let mut translations = Vec::new();
    let mut rotations = Vec::new();
    for stretch in ends.windows(2) {
        let (a, b) = (&pairs[stretch[0]], &pairs[stretch[1]]);
        let reference = a.reference.inverse() * b.reference;
        let mut estimate = a.estimate.inverse() * b.estimate;
        estimate.translation.vector *= scale;
        translations.push((estimate.translation.vector - reference.translation.vector).norm());
        rotations.push(estimate.rotation.angle_to(&reference.rotation).to_degrees());
    }
    let none = || {
        let (delta, unit) = match delta {
            Delta::Frames(n) => (n as f64, "frames"),
            Delta::Metres(m) => (m, "m"),
        };
        EvaluationError::NoPairs { delta, unit, num_poses: pairs.len() }
    };
    Ok(RelativeError {
        translation_m: ErrorStatistics::of(&translations).ok_or_else(none)?,
        rotation_deg: ErrorStatistics::of(&rotations).ok_or_else(none)?,
    })
}

/// Indices where stretches end and begin. By metres the first end is, as in evo, one stretch after the start.
fn stretch_ends(pairs: &[PosePair], delta: Delta, scale: f64) -> Result<Vec<usize>, EvaluationError> {
    match delta {
        Delta::Frames(step) => {
            positive("delta_frames", step as f64)?;
            Ok((0..pairs.len()).step_by(step).collect())
        }
        Delta::Metres(length) => {
            positive("delta_m", length)?;
            let mut ends = Vec::new();
            let mut travelled = 0.0;
            for i in 1..pairs.len() {
                let step = pairs[i].estimate.translation.vector - pairs[i - 1].estimate.translation.vector;
                travelled += scale * step.norm();
                if travelled >= length {
                    ends.push(i);
                    travelled = 0.0;
                }
            }
            Ok(ends)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use percept_geometry::{Pose, Timestamp, se3};

    /// Truth goes 1 m a frame straight on; the estimate goes 1 % further and turns by half a degree a frame.
    fn drifting(frames: usize) -> Vec<PosePair> {
        let step = se3::from_xy_yaw(1.01, 0.0, 0.5f64.to_radians());
        let mut estimate = se3::from_xy_yaw(5.0, -3.0, 2.0);
        (0..frames)
            .map(|i| {
                let pair =
                    PosePair { stamp: Timestamp(i as i64), reference: Pose::translation(i as f64, 0.0, 0.0), estimate };
                estimate *= step;
                pair
            })
            .collect()
    }

    #[test]
    fn constant_drift_is_the_same_in_every_frame_wherever_the_estimate_starts() {
        let error = relative_error(&drifting(11), Delta::Frames(1), 1.0).unwrap();
        assert_eq!(error.translation_m.count, 10);
        assert!((error.translation_m.min - 0.01).abs() < 1e-9 && (error.translation_m.max - 0.01).abs() < 1e-9);
        assert!((error.rotation_deg.mean - 0.5).abs() < 1e-9);
        let scaled = relative_error(&drifting(11), Delta::Frames(1), 1.0 / 1.01).unwrap();
        assert!(scaled.translation_m.max < 1e-9);
    }

    #[test]
    fn stretches_follow_one_another() {
        let error = relative_error(&drifting(11), Delta::Frames(4), 1.0).unwrap();
        assert_eq!(error.rotation_deg.count, 2);
        assert!((error.rotation_deg.mean - 2.0).abs() < 1e-9);
        // 2 m are reached after 2 steps: ends at 2, 4, 6, 8, 10.
        assert_eq!(relative_error(&drifting(11), Delta::Metres(2.0), 1.0).unwrap().translation_m.count, 4);
    }

    #[test]
    fn what_cannot_be_measured_is_said() {
        assert!(matches!(
            relative_error(&drifting(5), Delta::Frames(5), 1.0),
            Err(EvaluationError::NoPairs { unit: "frames", num_poses: 5, .. })
        ));
        assert!(matches!(relative_error(&[], Delta::Metres(1.0), 1.0), Err(EvaluationError::NoPairs { .. })));
        assert!(matches!(
            relative_error(&drifting(5), Delta::Frames(0), 1.0),
            Err(EvaluationError::InvalidParam { field: "delta_frames", .. })
        ));
        assert!(relative_error(&drifting(5), Delta::Metres(f64::NAN), 1.0).is_err());
    }
}
