//! The fused cloud: one mean point a voxel, which vanishes when it is seen through.
//!
//! A keyframe becomes a [`CloudUpdate`] (its returns by voxel, how far it saw in each direction, and which voxels it saw
//! through); adding it to the [`FusedCloud`] of its submap first carves what it saw through, then folds in what it saw.
//! [`CloudMap`] is the cloud of the whole map, in which each submap carves those before it.

pub(crate) mod block;
mod compose;
pub(crate) mod free;
mod fused;
mod params;
pub(crate) mod range_image;
mod shift;
mod update;

pub use compose::{CloudMap, CloudTile};
pub use fused::FusedCloud;
pub use params::CloudParams;
pub use update::CloudUpdate;
