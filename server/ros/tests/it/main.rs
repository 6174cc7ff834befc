//! Messages against another implementation's bytes; names, keys and conversions against their definitions.

// Helpers of tests may fail as tests do.
#![allow(clippy::unwrap_used, clippy::panic)]

mod clouds;
mod golden;
mod hashes;
mod images;
mod malformed;
mod motion;
mod names;
mod ros2dds;
mod zenoh_keys;
