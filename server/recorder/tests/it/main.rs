//! What is recorded reads back.

// Helpers of tests may fail as tests do.
#![allow(clippy::unwrap_used, clippy::panic)]

mod files;
mod queue;
mod read_back;
mod sensors;
