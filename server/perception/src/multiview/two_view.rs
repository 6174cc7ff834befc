//! Which model two images call for.

use super::essential::{Pair, essential_of, sampson2};
use super::homography::PlaneToPlane;
use super::ransac::{Problem, search};
use super::{EssentialEstimate, HomographyEstimate, MultiviewError, RansacParams};
use super::{estimate_essential, estimate_homography, finite, normalised};
use nalgebra::{Point2, Unit};
use percept_geometry::CameraIntrinsics;

/// Which model explains more of the correspondences.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TwoViewModel {
    /// A scene with depth, seen from two places.
    Essential,
    /// One plane, or a turn in place.
    Homography,
}

/// What the two images allow.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TwoViewOutcome {
    /// The relative pose is known, but for the length of the translation.
    Pose,
    /// Nearly all rays are parallel: the camera turned, or hardly moved; only the rotation is known.
    LittleParallax,
    /// A plane fills the images: the essential matrix may be ambiguous; the pose is the likelier one.
    Planar,
}

/// Both models and the choice between them.
#[derive(Debug, Clone, PartialEq)]
pub struct TwoViewEstimate {
    /// The choice.
    pub model: TwoViewModel,
    /// What follows for the pose.
    pub outcome: TwoViewOutcome,
    /// The relative pose and its inliers.
    pub essential: EssentialEstimate,
    /// The homography of rays at depth 1 in pixels of undistorted cameras; none if nothing fits one.
    pub homography: Option<HomographyEstimate>,
    /// Cost of the essential matrix by Torr's criterion; the model with less is chosen.
    pub gric_essential: f64,
    /// Cost of the homography.
    pub gric_homography: f64,
}

/// Estimates both models and chooses by the geometric robust information criterion: residuals, truncated, plus what the
/// dimension of the model and its parameters cost. The threshold is taken for the 95 % bound of an epipolar distance.
///
/// Source: Torr, "An assessment of information criteria for motion model selection", 1997.
///
/// # Errors
/// As [`estimate_essential`].
pub fn estimate_two_view(
    a: &[Point2<f64>],
    b: &[Point2<f64>],
    camera_a: &CameraIntrinsics,
    camera_b: &CameraIntrinsics,
    params: &RansacParams,
) -> Result<TwoViewEstimate, MultiviewError> {
    let essential = estimate_essential(a, b, camera_a, camera_b, params)?;
    let focal = 0.25 * (camera_a.fx + camera_a.fy + camera_b.fx + camera_b.fy);
    let usable: Vec<usize> = (0..a.len()).filter(|&i| finite(&a[i]) && finite(&b[i])).collect();
    let pairs: Vec<Pair> = usable.iter().map(|&i| (normalised(camera_a, &a[i]), normalised(camera_b, &b[i]))).collect();
    let plane = PlaneToPlane::new(&pairs, params.threshold_px / focal);
    let n = pairs.len() as f64;
    // Residuals in units of the noise, truncated at twice the codimension; the data have four dimensions.
    let gric = |errors: &dyn Fn(usize) -> f64, dimension: f64, parameters: f64| {
        let residuals: f64 = (0..pairs.len()).map(|i| (3.84 * errors(i)).min(2.0 * (4.0 - dimension))).sum();
        residuals + 4f64.ln() * dimension * n + (4.0 * n).ln() * parameters
    };
    let t = &essential.t_b_a;
    let e = essential_of(&t.rotation, &Unit::new_normalize(t.translation.vector));
    let threshold2 = (params.threshold_px / focal).powi(2);
    let gric_essential = gric(&|i| sampson2(&e, &pairs[i]) / threshold2, 3.0, 5.0);
    // The transfer error counts the noise of both images in each: half of it is the distance to the model.
    let gric_homography =
        search(&plane, params).map_or(f64::INFINITY, |found| gric(&|i| 0.5 * plane.error2(&found.model, i), 2.0, 8.0));
    let is_plane = gric_homography < gric_essential;
    let little = essential.num_with_parallax * 4 < essential.inliers.len();
    Ok(TwoViewEstimate {
        model: if is_plane { TwoViewModel::Homography } else { TwoViewModel::Essential },
        outcome: match (little, is_plane) {
            (true, _) => TwoViewOutcome::LittleParallax,
            (false, true) => TwoViewOutcome::Planar,
            (false, false) => TwoViewOutcome::Pose,
        },
        homography: estimate_homography(a, b, params).ok(),
        essential,
        gric_essential,
        gric_homography,
    })
}
