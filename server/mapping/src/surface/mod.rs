//! The surface: signed distances in voxels around it, and the mesh that they give.
//!
//! A keyframe becomes a [`SurfaceUpdate`] (what its beams say of the voxels around their ends, and which voxels they saw
//! through), which the [`SurfaceGrid`] of its submap takes in; a whole depth image goes into the grid directly
//! ([`SurfaceGrid::integrate_depth`]). [`SurfaceMap`] is the surface of the whole map, in which each submap carves those before
//! it, and gives the mesh ([`SurfaceMap::mesh`]). Nothing is known of where no beam was: holes stay holes.

mod beams;
mod block;
mod compose;
mod cubes;
mod depth;
mod extract;
mod grid;
mod kernel;
mod layer;
mod mesh;
mod mesh_data;
mod params;
mod piece;
mod stored;
mod tile;
mod touched;
mod update;

pub use grid::SurfaceGrid;
pub use mesh::MeshOptions;
pub use mesh_data::MeshData;
pub use params::SurfaceParams;
pub use tile::SurfaceTile;
pub use update::SurfaceUpdate;

/// The surface of the whole map, unbounded. Submaps that lie as they were begun are merged voxel by voxel, weighed by looks; those that
/// a correction has moved are read at the centres of the map's voxels, between eight of their own. Before that, what a submap
/// saw through loses weight by how many of its keyframes did, unless something of its own stands there.
pub type SurfaceMap = crate::Composed<SurfaceGrid>;
