//! The seven figures by which a list of errors is told.

use serde::Serialize;

/// Statistics of a list of non-negative errors, in the unit of the errors (`sse` in its square).
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ErrorStatistics {
    /// Number of errors.
    pub count: usize,
    /// Root of the mean square.
    pub rmse: f64,
    /// Mean.
    pub mean: f64,
    /// Median; the mean of the middle two for an even count.
    pub median: f64,
    /// Standard deviation about the mean, divided by `count` (numpy's and evo's default).
    pub std: f64,
    /// Smallest.
    pub min: f64,
    /// Largest.
    pub max: f64,
    /// Sum of squares.
    pub sse: f64,
}

impl ErrorStatistics {
    /// Statistics of `errors`; `None` if there is none.
    pub fn of(errors: &[f64]) -> Option<Self> {
        if errors.is_empty() {
            return None;
        }
        let count = errors.len() as f64;
        let mean = errors.iter().sum::<f64>() / count;
        let sse = errors.iter().map(|e| e * e).sum::<f64>();
        let variance = errors.iter().map(|e| (e - mean).powi(2)).sum::<f64>() / count;
        let mut sorted = errors.to_vec();
        sorted.sort_by(f64::total_cmp);
        let half = sorted.len() / 2;
        let median = if sorted.len() % 2 == 1 { sorted[half] } else { 0.5 * (sorted[half - 1] + sorted[half]) };
        Some(Self {
            count: errors.len(),
            rmse: (sse / count).sqrt(),
            mean,
            median,
            std: variance.sqrt(),
            min: sorted[0],
            max: sorted[sorted.len() - 1],
            sse,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn four_errors_by_hand() {
        let s = ErrorStatistics::of(&[4.0, 1.0, 3.0, 2.0]).unwrap();
        assert_eq!((s.count, s.mean, s.median, s.min, s.max, s.sse), (4, 2.5, 2.5, 1.0, 4.0, 30.0));
        assert!((s.rmse - 7.5f64.sqrt()).abs() < 1e-15 && (s.std - 1.25f64.sqrt()).abs() < 1e-15);
        assert!(ErrorStatistics::of(&[]).is_none());
    }

    proptest! {
        #[test]
        fn square_of_rmse_is_square_of_mean_plus_variance(errors in prop::collection::vec(0.0..10.0f64, 1..50)) {
            let s = ErrorStatistics::of(&errors).unwrap();
            prop_assert!((s.rmse.powi(2) - s.mean.powi(2) - s.std.powi(2)).abs() < 1e-9);
            prop_assert!(s.min <= s.median && s.median <= s.max && s.mean <= s.rmse + 1e-12);
        }
    }
}
