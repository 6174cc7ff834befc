//! The fused cloud: one mean point a voxel, which vanishes when it is seen through.
//!
//! A keyframe becomes a [`CloudUpdate`] (its returns by voxel, and how far it saw in each direction); adding it
//! to the [`FusedCloud`] first carves what it saw through, then folds in what it saw.

mod fused;
mod params;
mod range_image;
mod update;

pub use fused::FusedCloud;
pub use params::CloudParams;
pub use update::CloudUpdate;
