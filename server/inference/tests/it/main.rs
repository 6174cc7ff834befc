//! Detectors on small models that are made here, and on files that are not what they should be.

#![allow(clippy::unwrap_used, clippy::panic, reason = "all of it is tests")]

mod detection;
mod hostile;
mod models;
