//! The service over a real store, without doors.

// Helpers of tests may fail like tests.
#![allow(clippy::unwrap_used)]

mod correction;
