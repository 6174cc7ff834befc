//! What the stamps of a robot's messages tell of its clock.

use percept_service::{Error, reason};
use std::time::{Duration, Instant};

/// So long stamps of 0 may be those of a simulation whose clock has not begun; of one that sends no others the time of sending
/// is taken.
const NO_CLOCK: Duration = Duration::from_secs(10);
/// Stamps within this of when their messages were sent are of the same clock, nanoseconds.
const OF_SENDING_NS: u64 = 60_000_000_000;

/// What is known of a robot's clock.
#[derive(Debug, Clone, Copy)]
pub(super) enum Clock {
    /// No sensor's message had a stamp; the first of those came then.
    Unset(Option<Instant>),
    /// Messages have stamps: of about when they were sent, or of another time, as a simulation's are.
    Set { is_of_sending: bool },
}

impl Clock {
    /// Takes a message's stamp, and when it was sent (0: not told): whether it can be told when the message was made.
    pub(super) fn note(&mut self, stamp_ns: i64, sent_ns: i64) -> Result<(), Error> {
        if stamp_ns != 0 {
            *self = Self::Set { is_of_sending: stamp_ns.abs_diff(sent_ns) < OF_SENDING_NS };
            return Ok(());
        }
        let words = match self {
            Self::Set { is_of_sending: true } => return Ok(()),
            Self::Set { is_of_sending: false } => {
                "the stamp is 0, and the robot's others are not; stamp each message with the robot's clock".to_owned()
            }
            Self::Unset(since) => {
                if since.get_or_insert_with(Instant::now).elapsed() >= NO_CLOCK {
                    return Ok(());
                }
                format!(
                    "the stamp is 0, as before a simulation's clock has begun; after {} s of such alone the time of sending is \
                     taken",
                    NO_CLOCK.as_secs()
                )
            }
        };
        Err(Error::invalid(reason::STAMP_ZERO, "header.stamp", words))
    }
}
