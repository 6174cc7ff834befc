//! Outside files and messages: bytes in, geometry types out, and back.
//!
//! Comes in: the bytes of point clouds, meshes, octrees, images, grids, trajectories and logs, or the path of a recording.
//! Goes out: checked geometry types, or a [`FormatError`] that names the place and the value.
//! Sizes are compared with [`Limits`] and with the bytes that are there before memory is taken; no input panics.
//! No perception happens here, and only [`dataset`] and [`read_file`] touch the file system.
//! Start with [`dataset::open`], then the codec of the format in question.

pub mod breezy;
pub mod carmen;
mod clouds;
pub mod dataset;
pub mod draco;
mod error;
pub mod euroc;
pub mod g2o;
pub mod geotiff;
pub mod gltf;
pub mod images;
pub mod kitti;
pub mod las;
mod layout;
mod limits;
pub mod nav2;
pub mod octomap;
pub mod open3d;
pub mod pcd;
pub mod pgm;
pub mod ply;
mod scalar;
mod text;
pub mod trajectory;
pub mod xyz;

pub use clouds::{CloudFile, CloudFormat, load_cloud, read_cloud_file, save_cloud, sniff_cloud};
pub use dataset::{Dataset, DatasetKind};
pub use error::{FormatError, Place};
pub use g2o::{G2oEdge, G2oFile, G2oGraph, parse_g2o, write_g2o};
pub use images::{decode_color, decode_depth_png};
pub use limits::{Limits, read_file};
pub use nav2::GridMap;
pub use octomap::{OctreeLeaf, OctreeMap};
