//! The words of the field: time, frames, poses, clouds, images, cameras, shapes, grids, sensor messages.
//!
//! Comes in: nothing. Goes out: types with checked invariants that every other crate speaks in.
//! No algorithm of perception lives here, only the algebra of the types themselves.
//! Start with [`sensor::SensorFrame`], then [`se3`] and [`grid`].
//!
//! Conventions (REP-103, REP-105): metres, radians, seconds; base and map frames x forward, y left,
//! z up; camera optical frames x right, y down, z forward. `t_a_b` maps coordinates in b to a.

pub mod camera;
pub mod clearance;
pub mod cloud;
pub mod grid;
pub mod image;
pub mod information;
pub mod kept_scan;
pub mod keyframe;
pub mod mesh;
pub mod object;
pub mod se3;
pub mod sensor;
pub mod shapes;
pub mod simd;
pub mod time;

pub use camera::{CameraIntrinsics, Distortion};
pub use clearance::clearance_in_cells;
pub use cloud::{LaserScan, PointCloud};
pub use grid::{Cell, GridGeometry, Voxel};
pub use image::{DepthImage, GrayImage, RgbImage};
pub use kept_scan::{KeptScan, ScanSource};
pub use keyframe::{Correction, FeatureMethod, KeyframeFeature, KeyframeFeatures, KeyframeId, KeyframeScan};
pub use mesh::TriangleMesh;
pub use object::{ClassName, ClassNameError, ObjectClass};
pub use se3::{Covariance6, Pose};
pub use sensor::{SensorData, SensorFrame, SensorId, SensorKind, SensorSpec};
pub use shapes::{Aabb3, OrientedBox3, Plane, Ray};
pub use time::{Stamped, Timestamp};

/// Why a value could not be built: the facts, for the caller to put into words.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum GeometryError {
    /// A buffer's length does not fit the declared shape.
    #[error("{field}: expected {expected} elements, got {actual}")]
    ShapeMismatch {
        /// Field name.
        field: &'static str,
        /// Elements that the declared shape needs.
        expected: usize,
        /// Elements that are there.
        actual: usize,
    },
    /// A number is NaN, infinite or outside its bounds.
    #[error("{field}: {value} is not {requirement}")]
    OutOfRange {
        /// Field name.
        field: &'static str,
        /// The value as given.
        value: f64,
        /// What it has to be, e.g. `finite`, `positive`.
        requirement: &'static str,
    },
    /// A quaternion's norm is off by more than 1e-3.
    #[error("{field}: quaternion norm {norm} differs from 1 by more than 1e-3")]
    NotUnitQuaternion {
        /// Field name.
        field: &'static str,
        /// Norm as given.
        norm: f64,
    },
}
