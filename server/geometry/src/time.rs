//! Stamps: integers of nanoseconds, never floats of seconds.

use serde::{Deserialize, Serialize};

/// Nanoseconds since the Unix epoch of the sensor's clock.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Timestamp(pub i64);

impl Timestamp {
    /// From nanoseconds.
    pub const fn from_nanos(nanos: i64) -> Self {
        Self(nanos)
    }

    /// From seconds, rounded to the nearest nanosecond; saturates at the ends of `i64`.
    pub fn from_secs_f64(seconds: f64) -> Self {
        // Split so that stamps of today keep more than the 200 ns that an f64 of seconds resolves.
        let whole = seconds.floor();
        let fraction = ((seconds - whole) * 1e9).round();
        Self((whole as i64).saturating_mul(1_000_000_000).saturating_add(fraction as i64))
    }

    /// Nanoseconds.
    pub const fn nanos(self) -> i64 {
        self.0
    }

    /// Seconds, rounded to what an f64 can hold (about 200 ns for stamps of today).
    pub fn as_secs_f64(self) -> f64 {
        (self.0.div_euclid(1_000_000_000)) as f64 + (self.0.rem_euclid(1_000_000_000)) as f64 * 1e-9
    }

    /// Seconds from `earlier` to `self`; negative if `self` is the earlier one.
    pub fn seconds_since(self, earlier: Timestamp) -> f64 {
        (self.0 as i128 - earlier.0 as i128) as f64 * 1e-9
    }

    /// This stamp moved by `seconds` (may be negative); saturates.
    pub fn plus_seconds(self, seconds: f64) -> Self {
        Self(self.0.saturating_add((seconds * 1e9).round() as i64))
    }
}

impl std::fmt::Display for Timestamp {
    /// Seconds with nine decimals, exact.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let sign = if self.0 < 0 { "-" } else { "" };
        let n = self.0.unsigned_abs();
        write!(f, "{sign}{}.{:09}", n / 1_000_000_000, n % 1_000_000_000)
    }
}

/// A value and when it was true.
#[derive(Debug, Clone, PartialEq)]
pub struct Stamped<T> {
    /// When.
    pub stamp: Timestamp,
    /// What.
    pub value: T,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seconds_round_trip_to_the_microsecond_for_stamps_of_today() {
        let stamp = Timestamp(1_763_692_800_123_456_789);
        assert!((Timestamp::from_secs_f64(stamp.as_secs_f64()).0 - stamp.0).abs() < 1000);
        assert_eq!(stamp.to_string(), "1763692800.123456789");
        assert_eq!(Timestamp(-1).to_string(), "-0.000000001");
    }

    #[test]
    fn differences_do_not_overflow_at_the_ends_of_time() {
        assert!(Timestamp(i64::MAX).seconds_since(Timestamp(i64::MIN)) > 1e10);
    }
}
