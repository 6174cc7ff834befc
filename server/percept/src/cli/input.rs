//! Frames read ahead of their use: decoding and ray casting overlap with the pipeline.

use super::Failure;
use percept_geometry::SensorFrame;
use std::sync::mpsc::{Receiver, sync_channel};

/// Frames decoded ahead.
const AHEAD: usize = 4;

/// Reads `frames` on a thread of its own; the order stays.
pub(crate) fn read_ahead<I, E>(frames: I) -> Receiver<Result<SensorFrame, Failure>>
where
    I: Iterator<Item = Result<SensorFrame, E>> + Send + 'static,
    E: Into<Failure> + 'static,
{
    let (out, read) = sync_channel(AHEAD);
    std::thread::spawn(move || {
        for frame in frames {
            if out.send(frame.map_err(Into::into)).is_err() {
                return;
            }
        }
    });
    read
}

/// The same, for a stream into a server.
pub(crate) fn read_ahead_async<I, E>(frames: I) -> tokio::sync::mpsc::Receiver<SensorFrame>
where
    I: Iterator<Item = Result<SensorFrame, E>> + Send + 'static,
    E: Into<Failure> + 'static,
{
    let (out, read) = tokio::sync::mpsc::channel(AHEAD);
    std::thread::spawn(move || {
        for frame in frames {
            match frame {
                Ok(frame) => {
                    if out.blocking_send(frame).is_err() {
                        return;
                    }
                }
                Err(e) => eprintln!("percept: frame left out: {}", e.into()),
            }
        }
    });
    read
}

/// A part of a recording, `FIRST:LAST`, LAST excluded; either may be left out.
pub(crate) fn parse_range(text: &str) -> Result<std::ops::Range<usize>, String> {
    let bad = || format!("{text:?} is no range; write FIRST:LAST, e.g. 0:100, :100 or 50:");
    let (first, last) = text.split_once(':').ok_or_else(bad)?;
    let number = |s: &str, absent| if s.is_empty() { Ok(absent) } else { s.parse().map_err(|_| bad()) };
    let range = number(first, 0)?..number(last, usize::MAX)?;
    if range.is_empty() { Err(format!("{text:?} is empty; FIRST must be below LAST")) } else { Ok(range) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_are_read_and_nonsense_is_refused() {
        assert_eq!(parse_range("3:10"), Ok(3..10));
        assert_eq!(parse_range(":10"), Ok(0..10));
        assert_eq!(parse_range("3:"), Ok(3..usize::MAX));
        for bad in ["", "3", "a:b", "5:5", "7:3", "-1:3"] {
            assert!(parse_range(bad).is_err(), "{bad}");
        }
    }
}
