//! What confidences are worth: do the sure ones come first, and are they right as often as they say.

/// Something that was found: its confidence, 0 to 1, and whether it is right.
pub type Judged = (f64, bool);

/// Area under the curve of precision over recall, of what was found among `num_true` things; 0 to 1. `None` if there is
/// nothing to find.
///
/// Precision at a recall is the best at that recall or a higher one, and all steps of the curve count. Those of the
/// same confidence come in together.
///
/// Source: Everingham et al., "The PASCAL visual object classes challenge", 2010, with all points as from VOC 2010 on.
pub fn average_precision(found: &[Judged], num_true: usize) -> Option<f64> {
    let mut found = found.to_vec();
    found.sort_by(|a, b| b.0.total_cmp(&a.0));
    let (mut curve, mut right) = (Vec::new(), 0usize);
    for (i, f) in found.iter().enumerate() {
        right += usize::from(f.1);
        if found.get(i + 1).is_none_or(|next| next.0.total_cmp(&f.0).is_ne()) {
            curve.push((right, right as f64 / (i + 1) as f64));
        }
    }
    let mut best = 0.0f64;
    for point in curve.iter_mut().rev() {
        best = best.max(point.1);
        point.1 = best;
    }
    let (mut area, mut before) = (0.0, 0);
    for (right, precision) in curve {
        area += (right - before) as f64 * precision;
        before = right;
    }
    (num_true > 0).then(|| area / num_true as f64)
}

/// How far confidence is from the share that is right, on average over what was found, in `num_bins` equal bins of
/// confidence (at least 1); 0 to 1. `None` if nothing was found.
///
/// Source: Naeini, Cooper and Hauskrecht, "Obtaining well calibrated probabilities using Bayesian binning", 2015.
pub fn calibration_error(found: &[Judged], num_bins: usize) -> Option<f64> {
    let num_bins = num_bins.max(1);
    let mut bins = vec![(0.0, 0.0); num_bins];
    for &(confidence, right) in found {
        let bin = ((confidence * num_bins as f64) as usize).min(num_bins - 1);
        bins[bin].0 += confidence;
        bins[bin].1 += f64::from(u8::from(right));
    }
    (!found.is_empty()).then(|| bins.iter().map(|(said, is)| (said - is).abs()).sum::<f64>() / found.len() as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_area_under_a_curve_made_by_hand() {
        // Precision 1, 1/2, 2/3 at recall 1/3, 1/3, 2/3; the envelope is 1 and 2/3; one of three is never found.
        let found = [(0.9, true), (0.8, false), (0.7, true)];
        assert!((average_precision(&found, 3).unwrap() - (1.0 + 2.0 / 3.0) / 3.0).abs() < 1e-12);
        assert_eq!(average_precision(&[(0.1, true), (0.9, true)], 2), Some(1.0));
        // Order among equals does not count.
        assert_eq!(average_precision(&[(0.5, true), (0.5, false)], 1), Some(0.5));
        assert_eq!(average_precision(&[(0.5, false), (0.5, true)], 1), Some(0.5));
        assert_eq!(average_precision(&[], 2), Some(0.0));
        assert_eq!(average_precision(&[(0.5, false)], 0), None);
    }

    #[test]
    fn who_says_nine_tenths_and_is_right_half_of_the_time_is_off_by_four_tenths() {
        assert!((calibration_error(&[(0.9, true), (0.9, false)], 10).unwrap() - 0.4).abs() < 1e-12);
        assert_eq!(calibration_error(&[(0.5, true), (0.5, false)], 10), Some(0.0));
        assert_eq!(calibration_error(&[(1.0, true), (0.0, false)], 10), Some(0.0));
        assert_eq!(calibration_error(&[], 10), None);
    }
}
