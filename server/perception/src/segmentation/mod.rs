//! Clouds in, regions out: what is ground, which surface goes on smoothly, which parts make one object.
//!
//! Planes and clusters are in [`cloud`](crate::cloud); here are the methods made of several steps. All answer with
//! labels for the points that were given; points with a non-finite coordinate belong to nothing.

mod convexity;
mod ground;
mod objects;
mod occlusion;
mod patches;
mod region_growing;
mod supervoxels;
mod voxels;

pub use convexity::{ConvexityParams, group_convex};
pub use ground::{Ground, GroundParams, GroundPatch, segment_ground};
pub use objects::{Objects, ObjectsParams, segment_objects};
pub use region_growing::{RegionGrowingParams, grow_regions};
pub use supervoxels::{Supervoxel, SupervoxelParams, Supervoxels, supervoxels};
