//! The map layers against closed forms and brute force.

// Helpers of tests may fail as tests do.
#![allow(clippy::unwrap_used, clippy::panic)]

mod cloud;
mod distance;
mod driven;
mod ground;
mod height;
mod map;
mod memory;
mod moved;
mod occupancy;
mod scans;
mod surface;
mod voxels;
