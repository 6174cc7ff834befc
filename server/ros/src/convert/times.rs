//! When each point of a cloud was taken: vendors differ in name, type, unit and beginning.
//!
//! | field | type | means | of |
//! |---|---|---|---|
//! | `t` | u32 | ns after the stamp | Ouster |
//! | `time` | f32 | s, before or after the stamp | Velodyne |
//! | `offset_time` | u32 | ns after the stamp | Livox |
//! | `timestamp` | f64 | s of the Unix epoch | Hesai, RoboSense |
//! | `timestamp` | f64 | ns of the Unix epoch | Livox (driver 2) |

use percept_geometry::Timestamp;

/// Names of fields that say when a point was taken, the likeliest first.
pub(super) const NAMES: [&str; 8] =
    ["t", "time", "timestamp", "offset_time", "time_stamp", "time_offset", "time_offset_s", "point_time"];

/// Unit of points' times.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum TimeUnit {
    /// s.
    Seconds,
    /// ms.
    Milliseconds,
    /// us.
    Microseconds,
    /// ns.
    Nanoseconds,
}

impl TimeUnit {
    fn seconds(self) -> f64 {
        match self {
            Self::Seconds => 1.0,
            Self::Milliseconds => 1e-3,
            Self::Microseconds => 1e-6,
            Self::Nanoseconds => 1e-9,
        }
    }
}

/// How points' times were read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum PointTimes {
    /// There are none.
    Absent,
    /// They are offsets from the stamp.
    Relative(TimeUnit),
    /// They are of the stamp's clock; the stamp was subtracted.
    Absolute(TimeUnit),
    /// They are of another clock than the stamp (a lidar's since it was switched on): the earliest was subtracted, as if it
    /// had been taken at the stamp.
    OtherClock(TimeUnit),
    /// They cannot be times of one sweep: not finite, or more than 10 s apart. None are given.
    Unusable,
}

/// No sweep takes longer, s; nor does its stamp lie farther from its points.
const SWEEP_S: f64 = 10.0;

/// Offsets from `stamp`, s, of times as they came; the unit is found if it is not given.
pub(super) fn offsets(
    values: &[f64],
    is_integer: bool,
    stamp: Timestamp,
    unit: Option<TimeUnit>,
) -> (PointTimes, Option<Vec<f32>>) {
    let (least, most) = values.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), &v| (a.min(v), b.max(v)));
    if values.is_empty() || values.iter().any(|v| !v.is_finite()) {
        return (PointTimes::Unusable, None);
    }
    let magnitude = least.abs().max(most.abs());
    let unit = unit.unwrap_or_else(|| likely_unit(magnitude, most - least, is_integer));
    let seconds = unit.seconds();
    if (most - least) * seconds > SWEEP_S {
        return (PointTimes::Unusable, None);
    }
    let (times, origin) = if magnitude * seconds <= SWEEP_S {
        (PointTimes::Relative(unit), 0.0)
    } else {
        let stamp = stamp.as_secs_f64() / seconds;
        if (least - stamp).abs() * seconds <= SWEEP_S {
            (PointTimes::Absolute(unit), stamp)
        } else {
            (PointTimes::OtherClock(unit), least)
        }
    };
    (times, Some(values.iter().map(|v| ((v - origin) * seconds) as f32).collect()))
}

/// Integers are nanoseconds, unless they are of the Unix epoch in a coarser unit; floats go by their size if they are of the
/// Unix epoch (1973 at the earliest), else by how far apart they are.
fn likely_unit(magnitude: f64, span: f64, is_integer: bool) -> TimeUnit {
    if magnitude >= 1e17 {
        TimeUnit::Nanoseconds
    } else if magnitude >= 1e14 {
        TimeUnit::Microseconds
    } else if is_integer && magnitude < 1e11 {
        TimeUnit::Nanoseconds
    } else if magnitude >= 1e11 && span <= SWEEP_S * 1e3 {
        TimeUnit::Milliseconds
    } else if span <= SWEEP_S {
        TimeUnit::Seconds
    } else if span <= SWEEP_S * 1e3 {
        TimeUnit::Milliseconds
    } else if span <= SWEEP_S * 1e6 && !is_integer {
        TimeUnit::Microseconds
    } else {
        TimeUnit::Nanoseconds
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STAMP: Timestamp = Timestamp(1_763_692_800_100_000_000);

    fn of(values: &[f64], is_integer: bool) -> (PointTimes, Vec<f32>) {
        let (times, offsets) = offsets(values, is_integer, STAMP, None);
        (times, offsets.unwrap_or_default())
    }

    #[test]
    fn the_times_of_each_vendor_are_offsets_from_the_stamp() {
        use PointTimes::{Absolute, OtherClock, Relative};
        use TimeUnit::{Microseconds, Milliseconds, Nanoseconds, Seconds};
        let cases: [(&str, f64, f64, bool, PointTimes); 9] = [
            ("Ouster", 0.0, 1e9, true, Relative(Nanoseconds)),
            ("Velodyne", 0.0, 1.0, false, Relative(Seconds)),
            ("Hesai", STAMP.as_secs_f64(), 1.0, false, Absolute(Seconds)),
            ("Livox driver 2", STAMP.0 as f64, 1e9, false, Absolute(Nanoseconds)),
            ("us of the epoch, u64", STAMP.0 as f64 / 1e3, 1e6, true, Absolute(Microseconds)),
            ("s since it was switched on", 1234.5, 1.0, false, OtherClock(Seconds)),
            ("ns since it was switched on, u64", 1.2e13, 1e9, true, OtherClock(Nanoseconds)),
            ("ms as a float", 0.0, 1e3, false, Relative(Milliseconds)),
            ("us as a float", 0.0, 1e6, false, Relative(Microseconds)),
        ];
        for (name, first, per_second, is_integer, expected) in cases {
            let (times, offsets) = of(&[first, first + 0.02 * per_second, first + 0.1 * per_second], is_integer);
            assert_eq!(times, expected, "{name}");
            for (offset, expected) in offsets.iter().zip([0.0, 0.02, 0.1]) {
                assert!((offset - expected).abs() < 2e-6, "{name}: {offset}");
            }
        }
        assert_eq!(of(&[-0.1, 0.0], false), (Relative(Seconds), vec![-0.1, 0.0]));
    }

    #[test]
    fn what_can_be_no_times_of_a_sweep_is_none() {
        for values in [&[][..], &[0.0, f64::NAN], &[0.0, f64::INFINITY], &[0.0, 1e12], &[-1e300, 1e300]] {
            assert_eq!(of(values, false), (PointTimes::Unusable, vec![]), "{values:?}");
        }
        let given = offsets(&[0.0, 50.0], false, STAMP, Some(TimeUnit::Seconds));
        assert_eq!(given, (PointTimes::Unusable, None));
    }
}
