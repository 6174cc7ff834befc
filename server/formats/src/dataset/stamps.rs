//! Stamps as a replay needs them: strictly increasing in the order of the rows.

use percept_geometry::Timestamp;

/// Seconds between rows whose stamps say nothing.
const STEP_NS: i64 = 1_000_000_000;

/// Strictly increasing stamps close to those of rows that were logged in order, but stamped with jitter.
///
/// Logs exist (Intel Research Lab) in which rows follow one another as the robot moved, while stamps jump back
/// by up to a second. Rows are therefore not sorted. Stamps that rise are kept to the nanosecond; where they
/// fall, the rows concerned are pooled to the least-squares non-decreasing sequence (pool adjacent violators,
/// Ayer et al. 1955), and rows of a pool are spread evenly about its mean. If less than half of the stamps
/// differ, they are useless, and rows are a second apart from the first stamp on.
pub(super) fn strictly_increasing(raw: &[Timestamp]) -> Vec<Timestamp> {
    let mut distinct: Vec<i64> = raw.iter().map(|t| t.0).collect();
    distinct.sort_unstable();
    distinct.dedup();
    let Some(first) = raw.first() else {
        return vec![];
    };
    let offsets = raw.iter().map(|t| i128::from(t.0) - i128::from(first.0));
    let knots: Vec<(i128, i128)> = pools(offsets).into_iter().map(|p| p.knot()).collect();
    if distinct.len() * 2 <= raw.len() || knots.len() < 2 {
        return (0..raw.len()).map(|i| Timestamp(first.0.saturating_add(i as i64 * STEP_NS))).collect();
    }
    let mut out: Vec<Timestamp> = Vec::with_capacity(raw.len());
    let mut segment = 0;
    for row in 0..raw.len() {
        // Knots lie at twice the middle index of their pool, so that they stay integers.
        let at = 2 * row as i128;
        while segment + 2 < knots.len() && knots[segment + 1].0 <= at {
            segment += 1;
        }
        let offset = match knots.get(segment..segment + 2) {
            Some(&[(x0, t0), (x1, t1)]) => t0 + (at - x0) * (t1 - t0) / (x1 - x0),
            _ => knots[0].1,
        };
        let stamp = i64::try_from(i128::from(first.0) + offset).unwrap_or(i64::MAX);
        let least = out.last().map_or(i64::MIN, |t| t.0.saturating_add(1));
        out.push(Timestamp(stamp.max(least)));
    }
    out
}

/// Rows `start..end` whose stamps add up to `sum`.
struct Pool {
    start: usize,
    end: usize,
    sum: i128,
}

impl Pool {
    fn mean(&self) -> i128 {
        self.sum / (self.end - self.start) as i128
    }

    /// Twice the middle index, and the mean.
    fn knot(&self) -> (i128, i128) {
        ((self.start + self.end - 1) as i128, self.mean())
    }
}

fn pools(offsets: impl Iterator<Item = i128>) -> Vec<Pool> {
    let mut out: Vec<Pool> = vec![];
    for (i, offset) in offsets.enumerate() {
        let mut pool = Pool { start: i, end: i + 1, sum: offset };
        while let Some(before) = out.pop_if(|before| before.mean() >= pool.mean()) {
            pool = Pool { start: before.start, end: pool.end, sum: before.sum + pool.sum };
        }
        out.push(pool);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn repaired(raw: &[i64]) -> Vec<i64> {
        strictly_increasing(&raw.iter().map(|&t| Timestamp(t)).collect::<Vec<_>>()).iter().map(|t| t.0).collect()
    }

    #[test]
    fn good_stamps_are_kept_and_jitter_is_smoothed() {
        assert_eq!(repaired(&[]), [] as [i64; 0]);
        assert_eq!(repaired(&[7]), [7]);
        assert_eq!(repaired(&[10, 20, 35, 36]), [10, 20, 35, 36]);
        assert_eq!(repaired(&[0, 100, 60, 200, 300]), [0, 53, 120, 200, 300]);
        assert_eq!(repaired(&[5, 5, 5]), [5, 5 + STEP_NS, 5 + 2 * STEP_NS]);
    }

    proptest! {
        #[test]
        fn the_result_always_rises(raw in prop::collection::vec(-1_000_000..1_000_000i64, 0..100)) {
            let out = repaired(&raw);
            prop_assert_eq!(out.len(), raw.len());
            prop_assert!(out.windows(2).all(|w| w[0] < w[1]));
        }

        #[test]
        fn jitter_moves_no_stamp_by_more_than_itself(jitter in prop::collection::vec(-400..400i64, 20..100)) {
            let raw: Vec<i64> = jitter.iter().enumerate().map(|(i, j)| i as i64 * 200 + j).collect();
            for (i, t) in repaired(&raw).into_iter().enumerate() {
                prop_assert!((t - i as i64 * 200).abs() <= 1200, "{i} {t}");
            }
        }
    }
}
