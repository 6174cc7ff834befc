//! How high the ground is, what stands on it, and where a robot can drive: an elevation map of several storeys.
//!
//! Comes in: keyframes of sensors that see in space; planar scans say nothing about heights, and their beams are not counted as
//! having passed. A keyframe becomes a [`HeightUpdate`] (ground, what stands on it and hangs over it by cell, and the heights at
//! which beams passed by block of `2 x 2` cells), which is added to the [`HeightGrid`] of its submap. [`HeightMap`] is that of
//! the whole map; it is read as [`DenseHeights`], of which [`Traversability`] is computed. Start with `update.rs`.
//!
//! **Ground** is the mean of what is lowest in a cell, if it is where `ground.rs` follows the ground to, or flat and less than
//! 0.3 m above: kerbs, treads and low platforms are ground that is higher. Keyframes are fused as a Kalman filter of one height does it,
//! each with a variance that grows with range. Two heights that differ by more than noise are never mixed: ground that is
//! found elsewhere takes weight from what was known until it replaces it.
//! **What stands** on it up to the robot's clearance vanishes once beams passed at its height often enough, and counts only when it was seen
//! twice where they had passed before.
//! **Drops** are where the ground that goes on is not there: a beam went under it, and ended deeper. What was seen down there is
//! ground at its own height; what lies hidden behind the edge, up to a metre, is known as a drop and has none.
//! **Storeys**: a submap holds one ground a cell. The map holds up to four, sorted by height, that differ by the robot's clearance
//! at least.
//!
//! Source: Fankhauser, Bloesch, Gehring, Hutter and Siegwart, "Robot-centric elevation mapping with uncertainty estimates", 2014;
//! Fankhauser, Bloesch and Hutter, "Probabilistic terrain mapping for mobile robots with uncertain localization", 2018. Maps of
//! submaps take the place of their growing variance here: a submap moves as a whole.

mod beams;
mod bits;
mod cell;
mod compose;
mod dense;
mod grid;
mod look;
mod params;
mod storeys;
mod tile;
mod traversability;
mod update;

pub use compose::HeightMap;
pub use dense::{DenseHeights, Storey};
pub use grid::HeightGrid;
pub use params::HeightParams;
pub use storeys::{HeightCell, HeightTile};
pub use traversability::Traversability;
pub use update::HeightUpdate;
