//! How a sensor's stream fares, for an operator: good, or what is wrong and what to do about it.

use super::sensor_book::SensorStatus;
use percept_pipeline::MountOffset;
use std::fmt;

/// A clock off by more than this is worth telling, seconds.
const TELLING_OFFSET_S: f64 = 0.02;

/// How a stream fares; `Display` says it to an operator.
#[derive(Debug, Clone, PartialEq)]
pub enum Verdict {
    /// Nothing came yet.
    NoFrame,
    /// Nothing is wrong.
    Good,
    /// What is wrong; never empty.
    Troubled(Vec<StreamTrouble>),
}

/// Something that is wrong with a stream; `Display` says it to an operator, with a remedy.
#[derive(Debug, Clone, PartialEq)]
pub enum StreamTrouble {
    /// Frames were refused as bad input.
    Rejected {
        /// How many.
        count: u64,
    },
    /// Frames came faster than they are processed.
    Dropped {
        /// How many.
        count: u64,
    },
    /// Numbers are missing in the sender's sequence.
    Gaps {
        /// How many.
        count: u64,
    },
    /// Its stamps are late behind the pose sensor's.
    ClockOffset {
        /// By how much, beyond the declared offset, seconds; negative if they are early.
        offset_s: f64,
        /// The offset that would be right, seconds.
        time_offset_s: f64,
    },
    /// What it sees contradicts the pose sensor's map.
    MountOffset(MountOffset),
}

impl Verdict {
    pub(super) fn of(status: &SensorStatus) -> Self {
        if status.accepted == 0 && status.rejected == 0 {
            return Self::NoFrame;
        }
        let counted = |count: u64, trouble: fn(u64) -> StreamTrouble| (count > 0).then(|| trouble(count));
        let clock = status.clock_offset_s.filter(|offset_s| offset_s.abs() > TELLING_OFFSET_S);
        let clock = clock.map(|offset_s| {
            let time_offset_s = status.declaration.spec.time_offset_s - offset_s;
            StreamTrouble::ClockOffset { offset_s, time_offset_s }
        });
        let troubles: Vec<StreamTrouble> = [
            counted(status.rejected, |count| StreamTrouble::Rejected { count }),
            counted(status.dropped, |count| StreamTrouble::Dropped { count }),
            counted(status.gaps, |count| StreamTrouble::Gaps { count }),
            clock,
            status.mount_offset.map(StreamTrouble::MountOffset),
        ]
        .into_iter()
        .flatten()
        .collect();
        if troubles.is_empty() { Self::Good } else { Self::Troubled(troubles) }
    }

    /// What is wrong; empty if nothing is.
    pub fn troubles(&self) -> &[StreamTrouble] {
        match self {
            Self::NoFrame | Self::Good => &[],
            Self::Troubled(troubles) => troubles,
        }
    }
}

impl fmt::Display for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoFrame => f.write_str("no frame yet"),
            Self::Good => f.write_str("good"),
            Self::Troubled(troubles) => {
                let words: Vec<String> = troubles.iter().map(ToString::to_string).collect();
                f.write_str(&words.join("; "))
            }
        }
    }
}

impl fmt::Display for StreamTrouble {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Rejected { count } => write!(f, "{count} frames refused as bad input"),
            Self::Dropped { count } => {
                write!(f, "{count} frames dropped because they came faster than they are processed")
            }
            Self::Gaps { count } => write!(f, "{count} frames missing in the sender's numbering"),
            Self::ClockOffset { offset_s, time_offset_s } => {
                let (ms, which) = ((offset_s.abs() * 1e3).round(), if *offset_s > 0.0 { "late" } else { "early" });
                write!(
                    f,
                    "its stamps are {ms} ms {which}, compared with the pose sensor's; set its time_offset_s to \
                     {time_offset_s:.3} (UpdateSensor)"
                )
            }
            Self::MountOffset(off) => {
                let (cm, degrees) = ((off.distance_m * 100.0).round(), off.angle_rad.to_degrees().round());
                write!(
                    f,
                    "what it sees contradicts the pose sensor's map as if it were mounted {cm} cm and {degrees} degrees \
                     off; measure both mounts and declare it under a new name with the right t_base_sensor"
                )
            }
        }
    }
}
