//! Time and duration.

use percept_geometry::Timestamp;

message! {
    /// A point in time since the Unix epoch (or the simulation's start).
    #[derive(Copy, Eq)]
    "builtin_interfaces/msg/Time" Time {
        /// Seconds.
        sec: i32,
        /// Nanoseconds after them, below a thousand million.
        nanosec: u32,
    }

    /// A span of time.
    #[derive(Copy, Eq)]
    "builtin_interfaces/msg/Duration" Duration {
        /// Seconds.
        sec: i32,
        /// Nanoseconds after them (of a negative duration, too), below a thousand million.
        nanosec: u32,
    }
}

const NANOS_PER_SEC: i64 = 1_000_000_000;

impl From<Time> for Timestamp {
    fn from(time: Time) -> Self {
        Self(i64::from(time.sec) * NANOS_PER_SEC + i64::from(time.nanosec))
    }
}

impl From<Timestamp> for Time {
    /// Stamps beyond what 32 bits of seconds can say (1901 to 2038) become the nearest that they can.
    fn from(stamp: Timestamp) -> Self {
        let seconds = stamp.0.div_euclid(NANOS_PER_SEC);
        match i32::try_from(seconds) {
            Ok(sec) => Self { sec, nanosec: stamp.0.rem_euclid(NANOS_PER_SEC) as u32 },
            Err(_) if seconds < 0 => Self { sec: i32::MIN, nanosec: 0 },
            Err(_) => Self { sec: i32::MAX, nanosec: 999_999_999 },
        }
    }
}
