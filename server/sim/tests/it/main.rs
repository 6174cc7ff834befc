//! The simulator against closed forms, brute force and its own exact truth.

// Helpers outside of test functions may unwrap as tests do.
#![allow(clippy::unwrap_used, clippy::panic)]

mod disturbances;
mod noise;
mod session;
mod world;

use percept_sim::{SimParams, World, WorldParams};

/// A world of this seed and number of rooms.
pub(crate) fn world(seed: u64, rooms: usize) -> World {
    World::generate(&world_params(seed, rooms)).unwrap()
}

pub(crate) fn world_params(seed: u64, rooms: usize) -> WorldParams {
    WorldParams { seed, rooms, ..WorldParams::default() }
}

/// Parameters of a session in a world of this seed.
pub(crate) fn sim_params(seed: u64) -> SimParams {
    SimParams { world: world_params(seed, 4), seed, ..SimParams::default() }
}
