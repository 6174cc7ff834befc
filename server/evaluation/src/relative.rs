//! Relative error: how wrong the estimated motion is over a fixed stretch (RPE).

use crate::{ErrorStatistics, EvaluationError, PosePair, positive};
use percept_geometry::Pose;
use serde::{Deserialize, Serialize};

/// By how much a length, time or angle may miss the stretch where all pairs are taken: evo's default.
const ALL_PAIRS_TOLERANCE: f64 = 0.1;
/// Poses up to which all pairs by angle are looked for, which takes the square of their number.
const MAX_POSES_BY_ANGLE: usize = 20_000;

/// How long a stretch is. Lengths and angles are those of the estimate, as evo has it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Delta {
    /// In poses.
    Frames(usize),
    /// In metres travelled.
    Metres(f64),
    /// In seconds of the pairs' stamps; evo does not have it.
    Seconds(f64),
    /// In degrees turned, at most 180.
    Degrees(f64),
}

impl Delta {
    /// The number, and the name of its unit.
    pub fn parts(&self) -> (f64, &'static str) {
        match *self {
            Self::Frames(n) => (n as f64, "frames"),
            Self::Metres(m) => (m, "m"),
            Self::Seconds(s) => (s, "s"),
            Self::Degrees(d) => (d, "deg"),
        }
    }

    /// Checks the bounds.
    ///
    /// # Errors
    /// `InvalidParam` naming the field.
    pub fn validate(&self) -> Result<(), EvaluationError> {
        match *self {
            Self::Frames(n) => positive("delta_frames", n as f64).map(drop),
            Self::Metres(m) => positive("delta_m", m).map(drop),
            Self::Seconds(s) => positive("delta_s", s).map(drop),
            Self::Degrees(d) if d > 0.0 && d <= 180.0 => Ok(()),
            Self::Degrees(value) => {
                let requirement = "above 0 and at most 180";
                Err(EvaluationError::InvalidParam { field: "delta_deg", value, requirement })
            }
        }
    }
}

/// Relative pose error.
#[derive(Debug, Clone, PartialEq)]
pub struct RelativeError {
    /// Length of the translation by which the motions differ, metres.
    pub translation_m: ErrorStatistics,
    /// Angle by which they differ, degrees.
    pub rotation_deg: ErrorStatistics,
}

/// Relative error over stretches of `delta`: each starts where the one before ended, or, with `all_pairs`, one
/// starts at every pose and its end may miss the stretch by a tenth.
///
/// `scale` is applied to the estimate first: 1, or what a similarity alignment found; a rigid alignment changes
/// nothing. Source: Sturm et al. 2012, eq. 1; which poses make a stretch is as in evo 1.38.
///
/// # Errors
/// `InvalidParam` for a delta out of its bounds, `TooManyPoses` for all pairs by angle of a long trajectory,
/// `NoPairs` if the trajectory is shorter than a stretch.
pub fn relative_error(
    pairs: &[PosePair],
    delta: Delta,
    all_pairs: bool,
    scale: f64,
) -> Result<RelativeError, EvaluationError> {
    positive("scale", scale)?;
    delta.validate()?;
    let stretches = if all_pairs { all_stretches(pairs, delta, scale)? } else { stretches(pairs, delta, scale) };
    let mut translations = Vec::with_capacity(stretches.len());
    let mut rotations = Vec::with_capacity(stretches.len());
    for (first, last) in stretches {
        let (a, b) = (&pairs[first], &pairs[last]);
        let reference = a.reference.inverse() * b.reference;
        let mut estimate = a.estimate.inverse() * b.estimate;
        estimate.translation.vector *= scale;
        translations.push((estimate.translation.vector - reference.translation.vector).norm());
        rotations.push(estimate.rotation.angle_to(&reference.rotation).to_degrees());
    }
    let none = || {
        let (delta, unit) = delta.parts();
        EvaluationError::NoPairs { delta, unit, num_poses: pairs.len() }
    };
    Ok(RelativeError {
        translation_m: ErrorStatistics::of(&translations).ok_or_else(none)?,
        rotation_deg: ErrorStatistics::of(&rotations).ok_or_else(none)?,
    })
}

/// What the estimate went from one pose to the next, in the unit of the stretch.
fn step(a: &PosePair, b: &PosePair, delta: Delta, scale: f64) -> f64 {
    let between = |a: &Pose, b: &Pose| (b.translation.vector - a.translation.vector).norm();
    match delta {
        Delta::Frames(_) => 1.0,
        Delta::Metres(_) => scale * between(&a.estimate, &b.estimate),
        Delta::Seconds(_) => b.stamp.seconds_since(a.stamp),
        Delta::Degrees(_) => a.estimate.rotation.angle_to(&b.estimate.rotation).to_degrees(),
    }
}

/// Indices where stretches begin and end, one after the other.
fn stretches(pairs: &[PosePair], delta: Delta, scale: f64) -> Vec<(usize, usize)> {
    let (length, _) = delta.parts();
    // Stamps are sums of steps of other people's clocks: a nanosecond short of a stretch is a stretch.
    let enough = if matches!(delta, Delta::Seconds(_)) { length - 1e-9 } else { length };
    let (mut out, mut first, mut travelled) = (Vec::new(), 0, 0.0);
    for i in 1..pairs.len() {
        travelled += step(&pairs[i - 1], &pairs[i], delta, scale);
        if travelled >= enough {
            out.push((first, i));
            (first, travelled) = (i, 0.0);
        }
    }
    out
}

/// Every stretch there is: from each pose to the one nearest to its end; by angle to all that are near it.
fn all_stretches(pairs: &[PosePair], delta: Delta, scale: f64) -> Result<Vec<(usize, usize)>, EvaluationError> {
    let (length, _) = delta.parts();
    let tolerance = ALL_PAIRS_TOLERANCE * length;
    if let Delta::Frames(n) = delta {
        return Ok((n..pairs.len()).map(|i| (i - n, i)).collect());
    }
    if matches!(delta, Delta::Degrees(_)) {
        return stretches_by_angle(pairs, length, tolerance);
    }
    let mut travelled = vec![0.0; pairs.len()];
    for i in 1..pairs.len() {
        travelled[i] = travelled[i - 1] + step(&pairs[i - 1], &pairs[i], delta, scale);
    }
    let mut out = Vec::new();
    for first in 0..pairs.len().saturating_sub(1) {
        let away = |i: usize| (travelled[i] - travelled[first] - length).abs();
        let after = travelled.partition_point(|&t| t < travelled[first] + length).max(first + 1);
        // The nearer neighbour, and of equally far ones the first.
        let mut last = if after == pairs.len() || (after > first + 1 && away(after - 1) <= away(after)) {
            after - 1
        } else {
            after
        };
        last = travelled.partition_point(|&t| t < travelled[last]).max(first + 1).min(last);
        if last > first && away(last) <= tolerance {
            out.push((first, last));
        }
    }
    Ok(out)
}

/// All pairs whose rotations differ by `degrees`, straight from one to the other.
fn stretches_by_angle(
    pairs: &[PosePair],
    degrees: f64,
    tolerance: f64,
) -> Result<Vec<(usize, usize)>, EvaluationError> {
    if pairs.len() > MAX_POSES_BY_ANGLE {
        return Err(EvaluationError::TooManyPoses { num_poses: pairs.len(), limit: MAX_POSES_BY_ANGLE });
    }
    let mut out = Vec::new();
    for (i, a) in pairs.iter().enumerate() {
        let turned = |b: &PosePair| a.estimate.rotation.angle_to(&b.estimate.rotation).to_degrees();
        let later = pairs.iter().enumerate().skip(i + 1);
        out.extend(later.filter(|(_, b)| (turned(b) - degrees).abs() <= tolerance).map(|(j, _)| (i, j)));
    }
    Ok(out)
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
        let error = relative_error(&drifting(11), Delta::Frames(1), false, 1.0).unwrap();
        assert_eq!(error.translation_m.count, 10);
        assert!((error.translation_m.min - 0.01).abs() < 1e-9 && (error.translation_m.max - 0.01).abs() < 1e-9);
        assert!((error.rotation_deg.mean - 0.5).abs() < 1e-9);
        let scaled = relative_error(&drifting(11), Delta::Frames(1), false, 1.0 / 1.01).unwrap();
        assert!(scaled.translation_m.max < 1e-9);
    }

    #[test]
    fn stretches_follow_one_another() {
        let error = relative_error(&drifting(11), Delta::Frames(4), false, 1.0).unwrap();
        assert_eq!(error.rotation_deg.count, 2);
        assert!((error.rotation_deg.mean - 2.0).abs() < 1e-9);
        // 2 m are reached after 2 steps: ends at 2, 4, 6, 8, 10, the first begins at the start.
        assert_eq!(relative_error(&drifting(11), Delta::Metres(2.0), false, 1.0).unwrap().translation_m.count, 5);
    }

    #[test]
    fn what_cannot_be_measured_is_said() {
        assert!(matches!(
            relative_error(&drifting(5), Delta::Frames(5), false, 1.0),
            Err(EvaluationError::NoPairs { unit: "frames", num_poses: 5, .. })
        ));
        assert!(matches!(relative_error(&[], Delta::Metres(1.0), false, 1.0), Err(EvaluationError::NoPairs { .. })));
        assert!(matches!(
            relative_error(&drifting(5), Delta::Frames(0), false, 1.0),
            Err(EvaluationError::InvalidParam { field: "delta_frames", .. })
        ));
        assert!(relative_error(&drifting(5), Delta::Metres(f64::NAN), false, 1.0).is_err());
    }
}
