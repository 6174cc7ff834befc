//! Stamps as a replay needs them: strictly increasing in the order of the rows.

use percept_geometry::Timestamp;
use std::collections::BTreeMap;

/// Nanoseconds between rows whose stamps say nothing.
const STEP_NS: i64 = 1_000_000_000;

/// A stamp so far from those of the rows around it is not jitter, nanoseconds: Intel Research Lab's is a second at most.
const JITTER_NS: u64 = 5_000_000_000;
/// Rows on each side that a stamp is compared with.
const AROUND: usize = 3;

/// Whether at most half of the stamps differ.
pub(super) fn are_useless(raw: &[Timestamp]) -> bool {
    let mut sorted = raw.to_vec();
    sorted.sort_unstable();
    raw.len() > 1 && sorted.chunk_by(|a, b| a == b).count() * 2 <= raw.len()
}

/// Strictly increasing stamps for rows that were logged in order, but stamped with jitter.
///
/// Logs exist (Intel Research Lab) in which rows follow one another as the robot moved, while stamps jump back
/// by up to a second. So the rows stay where they are, and the stamps are sorted and dealt out again: stamps
/// that rise are kept, and if every stamp is within J of the truth, so is every one of the result (sorting
/// never enlarges the largest error). Stamps that are none, as zeros among others (Freiburg, building 101), are taken from
/// the row before: sorted, they would shift all others. Equal ones are parted by a nanosecond. If at most half of the stamps
/// differ, they are useless, and rows are a second apart from the first stamp on.
pub(super) fn strictly_increasing(raw: &[Timestamp]) -> Vec<Timestamp> {
    let mut out = without_outliers(raw);
    out.sort_unstable();
    if are_useless(raw) {
        let row = |i| Timestamp(raw[0].0.saturating_add(i as i64 * STEP_NS));
        return (0..raw.len()).map(row).collect();
    }
    for i in 1..out.len() {
        out[i] = out[i].max(Timestamp(out[i - 1].0.saturating_add(1)));
    }
    out
}

/// The stamps, those that are far from the median of the rows around them as that of the row before. The first and the last
/// may be apart from the others, where they are in order: there may have been a pause.
fn without_outliers(raw: &[Timestamp]) -> Vec<Timestamp> {
    let mut out: Vec<Timestamp> = Vec::with_capacity(raw.len());
    for (i, &stamp) in raw.iter().enumerate() {
        let mut around = raw[i.saturating_sub(AROUND)..raw.len().min(i + AROUND + 1)].to_vec();
        around.sort_unstable();
        let median = around[around.len() / 2];
        let is_far = stamp.0.abs_diff(median.0) > JITTER_NS;
        let is_in_order = match (i, raw.len() - 1 - i) {
            (0, _) => stamp <= median,
            (_, 0) => stamp >= median,
            _ => false,
        };
        out.push(if is_far && !is_in_order { out.last().copied().unwrap_or(median) } else { stamp });
    }
    out
}

/// Each delivered stamp with the raw one that it stands for, where they differ; none if the raw ones say nothing.
pub(super) fn restamped(raw: &[Timestamp], delivered: &[Timestamp]) -> BTreeMap<Timestamp, Timestamp> {
    if are_useless(raw) {
        return BTreeMap::new();
    }
    delivered.iter().copied().zip(raw.iter().copied()).filter(|(a, b)| a != b).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn repaired(raw: &[i64]) -> Vec<i64> {
        strictly_increasing(&raw.iter().map(|&t| Timestamp(t)).collect::<Vec<_>>()).iter().map(|t| t.0).collect()
    }

    #[test]
    fn good_stamps_are_kept_and_jitter_is_undone() {
        assert_eq!(repaired(&[]), [] as [i64; 0]);
        assert_eq!(repaired(&[7]), [7]);
        assert_eq!(repaired(&[10, 20, 35, 36]), [10, 20, 35, 36]);
        assert_eq!(repaired(&[0, 100, 60, 200, 200]), [0, 60, 100, 200, 201]);
        assert_eq!(repaired(&[5, 5, 5]), [5, 5 + STEP_NS, 5 + 2 * STEP_NS]);
    }

    #[test]
    fn rows_without_a_stamp_shift_no_others() {
        let s = |rows: &[i64]| rows.iter().map(|t| t * 1_000_000_000).collect::<Vec<i64>>();
        let raw = s(&[150, 151, 152, 0, 153, 154, 0, 0, 155, 900, 901, 902]);
        let found = repaired(&raw);
        for (i, &t) in raw.iter().enumerate().filter(|(_, t)| **t > 0) {
            assert_eq!(found[i], t, "row {i}");
        }
        assert!((152_000_000_000..153_000_000_000).contains(&found[3]));
        // A pause is no outlier, whether before the second row or the last.
        let pauses = s(&[0, 150, 151, 152, 153, 300]);
        assert_eq!(repaired(&pauses), pauses);
    }

    #[test]
    fn what_was_stamped_anew_is_known_by_its_own_stamp() {
        let stamps = |raw: &[i64]| raw.iter().map(|&t| Timestamp(t)).collect::<Vec<_>>();
        let raw = stamps(&[0, 100, 60, 200]);
        let found = restamped(&raw, &strictly_increasing(&raw));
        assert_eq!(found, BTreeMap::from([(Timestamp(60), Timestamp(100)), (Timestamp(100), Timestamp(60))]));
        let useless = stamps(&[5, 5, 5]);
        assert!(restamped(&useless, &strictly_increasing(&useless)).is_empty());
    }

    proptest! {
        #[test]
        fn the_result_always_rises(raw in prop::collection::vec(-1_000_000..1_000_000i64, 0..100)) {
            let out = repaired(&raw);
            prop_assert_eq!(out.len(), raw.len());
            prop_assert!(out.windows(2).all(|w| w[0] < w[1]));
        }

        #[test]
        fn no_error_grows_beyond_the_jitter(jitter in prop::collection::vec(-400_000..400_000i64, 20..100)) {
            let raw: Vec<i64> = jitter.iter().enumerate().map(|(i, j)| i as i64 * 200_000 + j).collect();
            for (i, t) in repaired(&raw).into_iter().enumerate() {
                // A nanosecond more for each of equal stamps.
                prop_assert!((t - i as i64 * 200_000).abs() <= 400_100, "{i} {t}");
            }
        }
    }
}
