//! Absolute error: how far the aligned estimate is from the truth, pose by pose (ATE, evo's APE).

use crate::{Alignment, ErrorStatistics, EvaluationError, PosePair, Similarity, align};

/// Absolute trajectory error.
#[derive(Debug, Clone, PartialEq)]
pub struct AbsoluteError {
    /// Distance between the true and the aligned estimated position, metres.
    pub translation_m: ErrorStatistics,
    /// Angle between the true and the aligned estimated rotation, degrees.
    pub rotation_deg: ErrorStatistics,
    /// The alignment that was applied to the estimate.
    pub similarity: Similarity,
}

/// Absolute error of associated poses after `alignment`.
///
/// Source: Sturm, Engelhard, Endres, Burgard, Cremers, "A benchmark for the evaluation of RGB-D SLAM systems",
/// 2012, section V-B, with the Euclidean norm.
///
/// # Errors
/// Those of [`align`].
pub fn absolute_error(pairs: &[PosePair], alignment: Alignment) -> Result<AbsoluteError, EvaluationError> {
    let similarity = align(pairs, alignment)?;
    let mut translations = Vec::with_capacity(pairs.len());
    let mut rotations = Vec::with_capacity(pairs.len());
    for pair in pairs {
        let estimate = similarity.apply(&pair.estimate);
        translations.push((estimate.translation.vector - pair.reference.translation.vector).norm());
        rotations.push(estimate.rotation.angle_to(&pair.reference.rotation).to_degrees());
    }
    let none = EvaluationError::NoCommonStamps { num_reference: 0, num_estimate: 0, max_difference_s: 0.0 };
    Ok(AbsoluteError {
        translation_m: ErrorStatistics::of(&translations).ok_or(none.clone())?,
        rotation_deg: ErrorStatistics::of(&rotations).ok_or(none)?,
        similarity,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use percept_geometry::{Pose, Timestamp, se3};

    #[test]
    fn a_wheel_of_errors_has_its_radius_and_turn_as_figures() {
        // Estimates off by 0.1 m in directions that cancel, and turned by 5 degrees in turns.
        let pairs: Vec<PosePair> = (0..8)
            .map(|i| {
                let angle = f64::from(i) * std::f64::consts::FRAC_PI_4;
                let reference = Pose::translation(3.0 * angle.cos(), 3.0 * angle.sin(), 0.0);
                let yaw = if i % 2 == 0 { 5f64 } else { -5.0 }.to_radians();
                let estimate = reference * se3::from_xy_yaw(0.1 * angle.cos(), 0.1 * angle.sin(), yaw);
                PosePair { stamp: Timestamp(i64::from(i)), reference, estimate }
            })
            .collect();
        let rigid = absolute_error(&pairs, Alignment::Se3).unwrap();
        assert!((rigid.translation_m.rmse - 0.1).abs() < 1e-12 && rigid.translation_m.std < 1e-9);
        assert!((rigid.rotation_deg.mean - 5.0).abs() < 1e-9);
        let scaled = absolute_error(&pairs, Alignment::Sim3).unwrap();
        assert!(scaled.translation_m.max < 1e-12 && (scaled.similarity.scale - 3.0 / 3.1).abs() < 1e-12);
        assert!(absolute_error(&[], Alignment::None).is_err());
    }
}
