//! What has three dimensions, seen in parallel projection: meshes, clouds, voxels.

mod camera;
mod cloud;
mod mesh;
mod picture;
mod raster;
mod voxels;

pub use camera::{View, ViewFrom};
pub use cloud::cloud_view;
pub use mesh::mesh_view;
pub use voxels::{voxels_slice, voxels_view};
