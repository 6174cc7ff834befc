//! Behaviour of the tracker and of the scene graph.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

mod annotation;
mod graph;
mod rooms;
mod temporal;
mod tracking;
