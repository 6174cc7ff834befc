//! Clouds in, structure out: fewer points, normals, planes, clusters, features, boxes.
//!
//! Functions take positions (or a [`PointCloud`](percept_geometry::PointCloud) where channels matter) and
//! answer with indices into them, so that the caller keeps its channels. Points with a non-finite coordinate
//! belong to nothing: no plane, cluster, box or feature ever counts them. Coordinates far from the origin
//! (1e7 m) lose what f32 loses and nothing more.

mod boxes;
mod cells;
mod clusters;
mod downsample;
mod eigen;
mod features;
mod hull;
mod hull3;
mod local;
mod local_features;
mod minimal_box;
mod normals;
mod orient;
mod outliers;
mod plane;
mod planes;
mod sample;
mod scatter;

pub use boxes::{upright_box, upright_box_along, upright_box_trimmed};
pub(crate) use clusters::DisjointSets;
pub use clusters::{ClusterParams, Clusters, DbscanParams, cluster, dbscan};
pub use downsample::voxel_downsample;
pub use eigen::{SymmetricEigen3, symmetric_eigen3};
pub use features::ShapeFeatures;
pub use hull::{Rectangle, convex_hull, minimum_area_rectangle};
pub use hull3::{Hull3, convex_hull_3d};
pub(crate) use local::sums_within;
pub use local_features::{LocalFeatures, local_features};
pub use minimal_box::{minimal_box, minimal_box_of_hull};
pub(crate) use normals::nearest_normals;
pub use normals::{NormalParams, estimate_normals};
pub use orient::{SpanningTreeParams, orient_by_spanning_tree};
pub use outliers::{RadiusOutlierParams, StatisticalOutlierParams, radius_outliers, statistical_outliers};
pub(crate) use plane::segment_among;
pub use plane::{PlaneParams, PlaneSegment, segment_plane};
pub use planes::{PlaneKind, PlanesParams, TypedPlane, segment_planes};
pub use sample::{crop_box, crop_polygon, crop_range, sample_farthest, sample_random, sample_uniform};
pub use scatter::Scatter;

use percept_geometry::GeometryError;

/// Why a cloud could not be worked on.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum CloudError {
    /// A parameter is out of its bounds, or a channel has another length than the positions.
    #[error(transparent)]
    Input(#[from] GeometryError),
    /// A coordinate divided by the voxel size does not fit the range of voxel indices.
    #[error(
        "voxel_size_m: {voxel_size_m} is too small for a coordinate of {coordinate_m} m, use at least {at_least_m}"
    )]
    VoxelTooSmall {
        /// Voxel size as given, metres.
        voxel_size_m: f64,
        /// The coordinate of largest magnitude, metres.
        coordinate_m: f64,
        /// Smallest voxel size that works, metres.
        at_least_m: f64,
    },
}

pub(crate) fn positive(field: &'static str, value: f64) -> Result<(), GeometryError> {
    if value.is_finite() && value > 0.0 {
        return Ok(());
    }
    Err(GeometryError::OutOfRange { field, value, requirement: "positive and finite" })
}

pub(crate) fn at_least(
    field: &'static str,
    value: usize,
    least: usize,
    requirement: &'static str,
) -> Result<(), GeometryError> {
    if value >= least {
        return Ok(());
    }
    Err(GeometryError::OutOfRange { field, value: value as f64, requirement })
}
