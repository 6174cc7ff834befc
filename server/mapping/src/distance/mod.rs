//! Distance to the nearest obstacle, and which way it grows: a signed Euclidean distance field of the grid or the voxels.
//!
//! It is exact between centres of cells up to a largest distance, and computed tile by tile where it is read: a tile is computed anew
//! only if something changed within that distance of it. Start with [`VoxelDistances`] or [`GridDistances`].

mod cache;
mod kernel;
mod map;

pub(crate) use cache::DistanceCache;
pub use map::{Distance, GridDistances, VoxelDistances};
