//! A surface or cloud against the true one, by distances.

use crate::{ErrorStatistics, EvaluationError, positive};
use serde::Serialize;

/// How well a cloud lies on the true surface and covers it.
///
/// Source: Knapitsch, Park, Zhou, Koltun, "Tanks and temples", 2017, section 4 (precision, recall, F-score).
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct CloudScore {
    /// Distances of the estimated points from the truth, metres; `None` if there is no point.
    pub accuracy_m: Option<ErrorStatistics>,
    /// Distances of the true points from the estimate, metres; `None` if there is no point.
    pub completeness_m: Option<ErrorStatistics>,
    /// Share of the estimated points within the threshold.
    pub precision: Option<f64>,
    /// Share of the true points within the threshold.
    pub recall: Option<f64>,
    /// Harmonic mean of the two; `None` if one is missing or both are 0.
    pub f_score: Option<f64>,
}

/// Figures from the distances (m, not negative) of each estimated point from the true surface, and of each sample
/// of the true surface from the nearest estimated point. An infinite distance (nothing near) counts for the
/// shares and is left out of the statistics.
///
/// # Errors
/// `InvalidParam` if the threshold (m) is not positive, or a distance is negative or NaN.
pub fn score_cloud(
    estimate_to_truth_m: &[f64],
    truth_to_estimate_m: &[f64],
    threshold_m: f64,
) -> Result<CloudScore, EvaluationError> {
    positive("threshold_m", threshold_m)?;
    let all = estimate_to_truth_m.iter().chain(truth_to_estimate_m);
    if let Some(&value) = all.into_iter().find(|d| d.is_nan() || **d < 0.0) {
        return Err(EvaluationError::InvalidParam { field: "distance_m", value, requirement: "not negative" });
    }
    let within = |distances: &[f64]| {
        let near = distances.iter().filter(|&&d| d <= threshold_m).count();
        crate::detection::share(near, distances.len())
    };
    let statistics = |distances: &[f64]| {
        ErrorStatistics::of(&distances.iter().copied().filter(|d| d.is_finite()).collect::<Vec<f64>>())
    };
    let (precision, recall) = (within(estimate_to_truth_m), within(truth_to_estimate_m));
    let f_score = match (precision, recall) {
        (Some(p), Some(r)) if p + r > 0.0 => Some(2.0 * p * r / (p + r)),
        _ => None,
    };
    Ok(CloudScore {
        accuracy_m: statistics(estimate_to_truth_m),
        completeness_m: statistics(truth_to_estimate_m),
        precision,
        recall,
        f_score,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_and_distances_by_hand() {
        let score = score_cloud(&[0.01, 0.03, 0.2, 0.04], &[0.02, f64::INFINITY], 0.05).unwrap();
        assert_eq!((score.precision, score.recall), (Some(0.75), Some(0.5)));
        assert!((score.f_score.unwrap() - 0.6).abs() < 1e-12);
        assert!((score.accuracy_m.unwrap().mean - 0.07).abs() < 1e-12);
        assert_eq!(score.completeness_m.unwrap().count, 1);
        assert_eq!(score_cloud(&[], &[], 0.05).unwrap().f_score, None);
        assert!(score_cloud(&[-1.0], &[], 0.05).is_err());
        assert!(score_cloud(&[], &[], 0.0).is_err());
    }
}
