//! Keyframes with poses in, map layers out.
//!
//! Comes in: [`KeyframeScan`](percept_geometry::KeyframeScan)s with their `t_map_base`, and
//! [`Correction`](percept_geometry::Correction)s of those poses. Goes out: [`MapLayers`], an immutable picture
//! that is cheap to clone (layers share what did not change): a 2D [`OccupancyGrid`] and a [`FusedCloud`].
//! No pose is estimated here, and nothing is read or written outside memory. Start with [`Map`].

pub mod cloud;
mod error;
mod layers;
pub mod map;
pub mod occupancy;
mod revision;

pub use cloud::{CloudParams, FusedCloud};
pub use error::MappingError;
pub use layers::MapLayers;
pub use map::{CorrectionReport, Map, MapKeyframe, MapParams};
pub use occupancy::{DenseGrid, OccupancyGrid, OccupancyParams};
pub use revision::Revision;
