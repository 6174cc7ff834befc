//! Who is near whom: exact neighbours in a fixed cloud, and a local map that grows and forgets.
//!
//! [`KdTree`] is built once from a cloud and answers exactly, ties included. [`VoxelHashMap`] takes points
//! in scan by scan, thins them, forgets what is far, and answers the nearest point around a query.
//! Points with a non-finite coordinate are never returned by either.

mod build;
mod group;
mod kdtree;
mod near;
mod neighbors;
mod voxel_map;

pub(crate) use group::{Group, Wanted, What};
pub use kdtree::{KdTree, Neighbor};
pub use neighbors::Neighbors;
pub use voxel_map::{MapNeighbor, VoxelHashMap, VoxelMapParams, VoxelStats};
