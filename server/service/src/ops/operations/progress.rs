//! How far a piece of work is, and whether it is still wanted: told by the work, asked for from outside.

use crate::{Error, ErrorCode, Result, reason};
use std::io::{self, Write};
use std::sync::{Arc, Mutex, PoisonError};
use tokio::sync::watch;

/// Bytes written between two looks at whether they are still wanted.
const BYTES_A_LOOK: usize = 256 << 10;

/// How far it is.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct HowFar {
    /// Share that is done, 0 to 1; none where nothing can be counted.
    pub fraction: Option<f64>,
    /// What is being done, for people; empty before it has begun.
    pub stage: String,
}

impl HowFar {
    fn done(&mut self, part: usize, all: usize) {
        let share = part as f64 / all.max(1) as f64;
        self.fraction = Some(self.fraction.unwrap_or(0.0).max(share.min(1.0)));
    }
}

/// Shared by a piece of work and who asks about it. That of a plain call is heard by nobody.
#[derive(Debug, Clone)]
pub struct Progress(Arc<Told>);

#[derive(Debug)]
struct Told {
    how_far: Mutex<HowFar>,
    cancelled: watch::Sender<bool>,
}

impl Default for Progress {
    fn default() -> Self {
        Self(Arc::new(Told { how_far: Mutex::default(), cancelled: watch::Sender::new(false) }))
    }
}

impl Progress {
    /// Says what is being done now.
    pub fn stage(&self, stage: impl Into<String>) {
        self.0.how_far.lock().unwrap_or_else(PoisonError::into_inner).stage = stage.into();
    }

    /// Says that so much of all is done; less than was said before changes nothing.
    pub fn done(&self, part: usize, all: usize) {
        self.0.how_far.lock().unwrap_or_else(PoisonError::into_inner).done(part, all);
    }

    /// Says that a step of several begins, and those before it are done.
    pub(crate) fn step(&self, step: usize, steps: usize, name: &str) {
        let mut how_far = self.0.how_far.lock().unwrap_or_else(PoisonError::into_inner);
        how_far.done(step, steps);
        how_far.stage = format!("step {} of {steps}: {name}", step + 1);
    }

    /// What was said last.
    pub(super) fn how_far(&self) -> HowFar {
        self.0.how_far.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Whether the work has said anything, and so has begun.
    fn has_begun(&self) -> bool {
        !self.how_far().stage.is_empty()
    }

    /// Asks the work to end.
    pub(super) fn cancel(&self) {
        self.0.cancelled.send_replace(true);
    }

    /// Whether the work was asked to end.
    pub(super) fn is_cancelled(&self) -> bool {
        *self.0.cancelled.borrow()
    }

    /// Comes if the work is asked to end before it has begun.
    pub(super) async fn cancelled_unbegun(&self) {
        let mut cancelled = self.0.cancelled.subscribe();
        // The sender is ours, so that an end without a cancellation cannot come.
        let asked = cancelled.wait_for(|cancelled| *cancelled).await.is_ok();
        if !asked || self.has_begun() {
            std::future::pending::<()>().await;
        }
    }

    /// For work to ask between its steps.
    ///
    /// # Errors
    /// `OPERATION_CANCELLED`.
    pub fn check(&self) -> Result<()> {
        if self.is_cancelled() { Err(cancelled()) } else { Ok(()) }
    }

    /// What `write` writes, some `expected_bytes`, counted; none if that is not known beforehand.
    ///
    /// # Errors
    /// `OPERATION_CANCELLED`; `INTERNAL` if the writer fails, since memory does not.
    pub(crate) fn written<E: std::fmt::Display>(
        &self,
        expected_bytes: Option<usize>,
        write: impl FnOnce(&mut Counted<'_>) -> std::result::Result<(), E>,
    ) -> Result<Vec<u8>> {
        let out = Vec::with_capacity(expected_bytes.unwrap_or_default());
        let mut counted = Counted { out, expected_bytes, next_look: BYTES_A_LOOK, progress: self };
        let written = write(&mut counted);
        let out = counted.out;
        self.check()?;
        written.map(|()| out).map_err(Error::internal)
    }
}

/// The error of what was cancelled.
pub(super) fn cancelled() -> Error {
    let words = "the operation was cancelled before it was done; start it again";
    Error::new(ErrorCode::FailedPrecondition, reason::OPERATION_CANCELLED, words)
}

/// Takes bytes for as long as they are wanted.
pub(crate) struct Counted<'a> {
    out: Vec<u8>,
    expected_bytes: Option<usize>,
    next_look: usize,
    progress: &'a Progress,
}

impl Write for Counted<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.out.extend_from_slice(bytes);
        if self.out.len() >= self.next_look {
            self.next_look = self.out.len() + BYTES_A_LOOK;
            if let Some(expected) = self.expected_bytes {
                self.progress.done(self.out.len(), expected);
            }
            if self.progress.is_cancelled() {
                return Err(io::Error::other("cancelled"));
            }
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn progress_never_falls_and_ends_at_one() {
        let progress = Progress::default();
        assert_eq!(progress.how_far(), HowFar::default());
        for (part, all, share) in [(1, 4, 0.25), (0, 4, 0.25), (3, 4, 0.75), (9, 4, 1.0)] {
            progress.done(part, all);
            assert_eq!(progress.how_far().fraction, Some(share));
        }
    }

    #[test]
    fn writing_is_counted_and_stops_once_it_is_cancelled() {
        let progress = Progress::default();
        let mut seen = vec![];
        let written = progress.written(Some(8 * BYTES_A_LOOK), |out| {
            for _ in 0..8 {
                out.write_all(&vec![7; BYTES_A_LOOK])?;
                seen.push(progress.how_far().fraction);
            }
            io::Result::Ok(())
        });
        assert_eq!(written.unwrap(), vec![7; 8 * BYTES_A_LOOK]);
        assert_eq!(seen, (1..=8).map(|i| Some(f64::from(i) / 8.0)).collect::<Vec<_>>());

        let mut rounds = 0;
        let refused = progress.written(None, |out| -> io::Result<()> {
            loop {
                out.write_all(&[7; 1000])?;
                rounds += 1;
                if rounds == 1000 {
                    progress.cancel();
                }
            }
        });
        assert_eq!(refused.unwrap_err().reason, "OPERATION_CANCELLED");
        assert!(rounds < 1000 + BYTES_A_LOOK / 1000 + 1, "{rounds}");
    }

    #[tokio::test]
    async fn only_work_that_has_not_begun_is_left_when_it_is_cancelled() {
        let (unbegun, begun) = (Progress::default(), Progress::default());
        begun.stage("step 1 of 2");
        let (mut left, mut kept) = (Box::pin(unbegun.cancelled_unbegun()), Box::pin(begun.cancelled_unbegun()));
        assert!(futures::poll!(&mut left).is_pending());
        unbegun.cancel();
        begun.cancel();
        left.await;
        assert!(futures::poll!(&mut kept).is_pending());
        assert!(begun.check().is_err());
    }
}
