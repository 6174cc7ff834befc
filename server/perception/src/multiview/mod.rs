//! Several views of one scene: where cameras stood, where points are.
//!
//! Comes in: pixels that show the same points in two images, or pixels and the points themselves, and the cameras.
//! Goes out: [`estimate_essential`] the relative pose (its translation of length 1: two images do not tell the scale),
//! [`estimate_homography`] the plane-to-plane map, [`estimate_two_view`] whichever of both explains more, with why a pose
//! is not to be had, [`triangulate()`] a point with its covariance, [`solve_pnp`] a camera's pose among known points.
//!
//! All estimators draw samples from a seed (same input, same seed, same answer), score by truncated squares and stop when
//! a better sample has become unlikely. Pixels go through the cameras' distortion; thresholds are pixels.

mod essential;
mod five_point;
mod homography;
mod p3p;
mod pnp;
mod polynomial;
mod ransac;
mod triangulate;
mod two_view;

#[cfg(test)]
mod tests;

pub use essential::{EssentialEstimate, estimate_essential};
pub use homography::{HomographyEstimate, estimate_homography};
pub use pnp::{PnpEstimate, solve_pnp};
pub use ransac::RansacParams;
pub use triangulate::{TriangulatedPoint, triangulate};
pub use two_view::{TwoViewEstimate, TwoViewModel, TwoViewOutcome, estimate_two_view};

use nalgebra::{Point2, Vector2};
use percept_geometry::{CameraIntrinsics, GeometryError};

/// Why nothing could be estimated.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum MultiviewError {
    /// A parameter, an intrinsic or the length of a list is out of bounds.
    #[error(transparent)]
    Input(#[from] GeometryError),
    /// Fewer usable (finite) correspondences than the model needs.
    #[error("correspondences: {got} are usable, at least {needed} are needed")]
    TooFew {
        /// Usable correspondences.
        got: usize,
        /// Needed.
        needed: usize,
    },
    /// No sample gave a model that enough correspondences fit.
    #[error("correspondences: no model fits {needed} of {got} of them; they may be wrong, or all in one place or line")]
    NoModel {
        /// Usable correspondences.
        got: usize,
        /// Needed.
        needed: usize,
    },
}

/// Same lengths, or an error that names the second list.
fn same_length(field: &'static str, expected: usize, actual: usize) -> Result<(), GeometryError> {
    if expected == actual { Ok(()) } else { Err(GeometryError::ShapeMismatch { field, expected, actual }) }
}

/// A pixel as the point on its ray at depth 1.
fn normalised(camera: &CameraIntrinsics, pixel: &Point2<f64>) -> Vector2<f64> {
    camera.ray(pixel.x, pixel.y).coords.xy()
}

fn finite(p: &Point2<f64>) -> bool {
    p.x.is_finite() && p.y.is_finite()
}
