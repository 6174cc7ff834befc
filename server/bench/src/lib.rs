//! Times operations on given files, one operation a process, for comparison with other libraries.
//!
//! Comes in: an operation and its `key=value` arguments. Goes out: JSON lines with milliseconds and the quality of the
//! result. [`worker()`] answers `prep`, `run` and `extra` line by line, so that another program can interleave several
//! such processes; [`run`] does a whole measurement. Each operation is one [`Case`], found in [`cases`].

pub mod args;
pub mod cases;
pub mod g2o;
pub mod worker;

pub use args::Args;
pub use cases::{Case, OPERATIONS, open};
pub use worker::{run, worker};

/// Why a case cannot be opened or run: a sentence.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct BenchError(pub String);

impl BenchError {
    /// From anything that says what is wrong.
    pub fn new(e: impl std::fmt::Display) -> Self {
        Self(e.to_string())
    }
}
