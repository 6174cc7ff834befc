//! Depth images in, points and normals out, in the optical frame (x right, y down, z forward).
//!
//! [`unproject()`] makes a cloud; [`VertexMap`] and [`NormalMap`] keep the image's grid, for projective
//! registration; [`DepthPyramid`] shrinks without mixing surfaces across edges. Nothing here knows where
//! the camera is.

#[cfg(target_arch = "x86_64")]
mod avx512;
mod bilateral;
mod boundaries;
mod filter;
mod maps;
mod median;
mod normals;
mod outliers;
mod planes;
mod pyramid;
mod rays;
mod register;
mod room;
mod unproject;

pub use bilateral::{BilateralParams, bilateral};
pub use boundaries::{BoundaryParams, EdgeKind, boundaries};
pub use filter::{EdgeParams, edge_mask};
pub use maps::{NormalMap, NormalMapParams, VertexMap};
pub use median::{MedianHoles, MedianParams, median, median_units};
pub use outliers::{DepthOutlierParams, FillParams, fill_holes, remove_outliers, to_units};
pub use planes::{DepthPlane, DepthPlaneParams, DepthPlanes, depth_planes};
pub use pyramid::{DepthPyramid, PyramidLevel, halve};
pub use rays::RayTable;
pub use register::{RegisteredColor, register_color};
pub use unproject::{UnprojectParams, unproject, unproject_units, unproject_with};

use percept_geometry::{DepthImage, GeometryError};

/// Compares sizes as (width, height); the error tells the first side that differs.
fn check_size(field: &'static str, expected: (usize, usize), actual: (usize, usize)) -> Result<(), GeometryError> {
    for (expected, actual) in [(expected.0, actual.0), (expected.1, actual.1)] {
        if expected != actual {
            return Err(GeometryError::ShapeMismatch { field, expected, actual });
        }
    }
    Ok(())
}

fn size(depth: &DepthImage) -> (usize, usize) {
    (depth.width(), depth.height())
}

fn positive(field: &'static str, value: f64) -> Result<(), GeometryError> {
    if value.is_finite() && value > 0.0 {
        return Ok(());
    }
    Err(GeometryError::OutOfRange { field, value, requirement: "positive and finite" })
}
