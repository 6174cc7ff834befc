//! Three-dimensional occupancy: what beams hit and passed, by voxel.
//!
//! A keyframe becomes a [`VoxelUpdate`] (the voxels that its beams passed, and those in which they ended), which is added to the
//! [`VoxelGrid`] of its submap. [`VoxelMap`] is the occupancy of the whole map: submaps' evidence laid over each other.

mod block;
mod compose;
mod grid;
mod params;
mod rays;
mod read;
mod update;

pub use compose::{VoxelMap, VoxelTile};
pub use grid::VoxelGrid;
pub use params::VoxelParams;
pub use read::{MAX_RAY_VOXELS, RayHit, VoxelBlock, VoxelReader, VoxelState};
pub use update::VoxelUpdate;
