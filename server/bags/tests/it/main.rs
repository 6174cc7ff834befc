//! Recordings made here, whole, cut and damaged.

// Helpers of tests may fail as tests do.
#![allow(clippy::unwrap_used, clippy::panic)]

mod damage;
mod golden;
mod order;
