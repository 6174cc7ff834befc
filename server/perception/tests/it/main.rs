//! Perception against the simulator's truth.

#![allow(clippy::unwrap_used, clippy::panic)]

mod detection;
mod lift;
mod outdoor;
