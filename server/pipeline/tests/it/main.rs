//! One robot's pipeline on simulated drives, whose truth is exact.

// Helpers of tests may fail like tests.
#![allow(clippy::unwrap_used)]

mod along;
mod beside;
mod camera;
mod correction;
mod drive;
mod extrinsics;
mod given;
mod imu;
mod live;
mod memory;
mod plan;
mod refusal;
mod restore;
mod second;
mod second_look;
mod sparse;
mod told;
mod twins;
mod unanchored;
