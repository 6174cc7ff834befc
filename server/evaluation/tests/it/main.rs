//! Figures of trajectories and maps against what they have to be.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

mod properties;
