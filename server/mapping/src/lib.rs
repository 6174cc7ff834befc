//! Keyframes with poses in, map layers out.
//!
//! Comes in: [`KeyframeScan`](percept_geometry::KeyframeScan)s with their `t_map_base`, and
//! [`Correction`](percept_geometry::Correction)s of those poses. Goes out: [`MapLayers`], an immutable picture that is
//! cheap to clone: a 2D [`OccupancyMap`], a [`CloudMap`], and if wanted a [`VoxelMap`], a [`HeightMap`] and a [`SurfaceMap`], each
//! composed of what [`Submap`]s hold where it is read.
//! No pose is estimated here, and nothing is read or written outside memory: submaps that are to leave it go to the caller's
//! [`MapStore`]. Start with [`Map`]; what a layer is stands in [`Layer`].

mod angles;
mod blocks;
mod bytes;
pub mod cloud;
mod composed;
mod contradicted;
pub mod distance;
mod error;
pub mod given;
mod ground;
pub mod height;
mod keyframe_view;
mod layer;
mod layer_slot;
mod layers;
mod live;
pub mod map;
mod moving;
pub mod occupancy;
mod params;
mod seen;
mod sorted;
mod store;
mod stored_scan;
mod submap;
mod submap_id;
pub mod surface;
pub mod voxels;

pub use bytes::{Damaged, Reader};
pub use cloud::{CloudMap, CloudParams, CloudTile, FusedCloud};
pub use composed::Composed;
pub use contradicted::Contradicted;
pub use error::MappingError;
pub use height::{DenseHeights, HeightCell, HeightGrid, HeightMap, HeightParams, HeightTile, Storey, Traversability};
pub use keyframe_view::KeyframeView;
pub use layer::{Footprint, Layer, Placement, TileKey};
pub use layer_slot::LayerSlot;
pub use layers::{LayerBoxes, LayerSlots, MapLayers, SubmapLayers};
pub use live::{LiveFrame, LiveParams};
pub use map::{CorrectionReport, Map, MapEntry, MapKeyframe, RebuildStep, RebuildStepDone, StoreAhead};
pub use moving::{Sight, moving};
pub use occupancy::{DenseGrid, Occupancy, OccupancyGrid, OccupancyMap, OccupancyParams, OccupancyTile};
pub use params::MapParams;
pub use store::{BlobId, MapMemory, MapStore};
pub use submap::Submap;
pub use submap_id::SubmapId;
pub use surface::{MeshData, MeshOptions, SurfaceGrid, SurfaceMap, SurfaceParams, SurfaceTile};
pub use voxels::{VoxelBlock, VoxelGrid, VoxelMap, VoxelParams, VoxelTile};
