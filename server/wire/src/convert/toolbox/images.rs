//! Several views of one scene: requests and answers.

use super::bytes_of_indices;
use crate::convert::{geometry, required, sensors};
use crate::v1;
use bytes::Bytes;
use nalgebra::{Matrix3, Point2, Point3};
use percept_geometry::{CameraIntrinsics, GeometryError};
use percept_perception::detection::{Detection2d, ImageDetector, ImageDetectors};
use percept_perception::multiview::{
    EssentialEstimate, HomographyEstimate, PnpEstimate, RansacParams, TriangulatedPoint, TwoViewEstimate, TwoViewModel,
    TwoViewOutcome,
};
use percept_service::Result;
use percept_service::toolbox::PosedView;

fn float64s<const N: usize>(field: &'static str, data: &Bytes) -> Result<Vec<[f64; N]>> {
    if !data.len().is_multiple_of(8 * N) {
        let expected = N * (data.len() / (8 * N) + 1);
        return Err(GeometryError::ShapeMismatch { field, expected, actual: data.len() / 8 }.into());
    }
    let number = |b: &[u8]| f64::from_le_bytes([b[0], b[1], b[2], b[3], b[4], b[5], b[6], b[7]]);
    Ok(data.chunks_exact(8 * N).map(|b| std::array::from_fn(|i| number(&b[8 * i..]))).collect())
}

fn bytes_of_float64s(values: impl Iterator<Item = f64>) -> Bytes {
    values.flat_map(f64::to_le_bytes).collect::<Vec<u8>>().into()
}

fn row_major(m: &Matrix3<f64>) -> Vec<f64> {
    m.transpose().as_slice().to_vec()
}

/// N x 2 pixels.
///
/// # Errors
/// `SIZE_MISMATCH`.
pub fn pixels(field: &'static str, data: &Bytes) -> Result<Vec<Point2<f64>>> {
    Ok(float64s::<2>(field, data)?.into_iter().map(Point2::from).collect())
}

/// N x 3 points.
///
/// # Errors
/// `SIZE_MISMATCH`.
pub fn points(field: &'static str, data: &Bytes) -> Result<Vec<Point3<f64>>> {
    Ok(float64s::<3>(field, data)?.into_iter().map(Point3::from).collect())
}

/// A camera that has to be there.
///
/// # Errors
/// `FIELD_MISSING`, and those of [`sensors::intrinsics`].
pub fn camera(field: &'static str, c: Option<&v1::CameraIntrinsics>) -> Result<CameraIntrinsics> {
    sensors::intrinsics(required(field, c)?).map_err(|e| e.within(field))
}

/// Two cameras; the second is as the first if absent.
///
/// # Errors
/// Those of [`camera`].
pub fn cameras(
    a: Option<&v1::CameraIntrinsics>,
    b: Option<&v1::CameraIntrinsics>,
) -> Result<(CameraIntrinsics, CameraIntrinsics)> {
    Ok((camera("camera_a", a)?, camera("camera_b", b.or(a))?))
}

/// How a model is sought.
pub fn ransac(r: Option<&v1::RansacParams>) -> RansacParams {
    let mut params = RansacParams::default();
    let Some(r) = r else { return params };
    lay_over!(params, r: threshold_px, confidence, max_iterations);
    params.seed = r.seed;
    params
}

/// A relative pose as a message.
pub fn essential_to(e: &EssentialEstimate) -> v1::EstimateEssentialResponse {
    v1::EstimateEssentialResponse {
        essential: row_major(&e.essential),
        t_b_a: Some(geometry::pose_to(&e.t_b_a)),
        inliers: bytes_of_indices(&e.inliers),
        num_with_parallax: e.num_with_parallax as u32,
        rmse_px: e.rmse_px,
        iterations: e.iterations as u32,
    }
}

/// A homography as a message.
pub fn homography_to(h: &HomographyEstimate) -> v1::EstimateHomographyResponse {
    v1::EstimateHomographyResponse {
        homography: row_major(&h.homography),
        inliers: bytes_of_indices(&h.inliers),
        rmse_px: h.rmse_px,
        iterations: h.iterations as u32,
    }
}

/// Both models and the choice as a message.
pub fn two_view_to(t: &TwoViewEstimate) -> v1::EstimateTwoViewResponse {
    let model = match t.model {
        TwoViewModel::Essential => v1::TwoViewModel::Essential,
        TwoViewModel::Homography => v1::TwoViewModel::Homography,
    };
    let outcome = match t.outcome {
        TwoViewOutcome::Pose => v1::TwoViewOutcome::Pose,
        TwoViewOutcome::LittleParallax => v1::TwoViewOutcome::LittleParallax,
        TwoViewOutcome::Planar => v1::TwoViewOutcome::Planar,
    };
    v1::EstimateTwoViewResponse {
        model: model.into(),
        outcome: outcome.into(),
        essential: Some(essential_to(&t.essential)),
        homography: t.homography.as_ref().map(homography_to),
        gric_essential: t.gric_essential,
        gric_homography: t.gric_homography,
    }
}

/// Views of a triangulation.
///
/// # Errors
/// Naming `views[i]`.
pub fn views(r: &v1::TriangulatePointsRequest) -> Result<Vec<PosedView>> {
    let view = |v: &v1::PosedView| -> Result<PosedView> {
        Ok(PosedView {
            camera: camera("camera", v.camera.as_ref())?,
            t_world_camera: geometry::pose("t_world_camera", v.t_world_camera.as_ref())?,
            pixels: pixels("pixels", &v.pixels)?,
        })
    };
    let named = |(i, v)| view(v).map_err(|e| e.within(&format!("views[{i}]")));
    r.views.iter().enumerate().map(named).collect()
}

/// Triangulated points as a message.
pub fn triangulated_to(points: &[Option<TriangulatedPoint>]) -> v1::TriangulatePointsResponse {
    let number = |of: fn(&TriangulatedPoint) -> f64| {
        bytes_of_float64s(points.iter().map(move |p| p.as_ref().map_or(f64::NAN, of)))
    };
    let position = |p: &Option<TriangulatedPoint>| p.as_ref().map_or([f64::NAN; 3], |p| p.position.into());
    // Symmetric: either order is row-major.
    let covariance = |p: &Option<TriangulatedPoint>| {
        p.as_ref().map_or([f64::NAN; 9], |p| std::array::from_fn(|i| p.covariance.as_slice()[i]))
    };
    v1::TriangulatePointsResponse {
        positions: bytes_of_float64s(points.iter().flat_map(position)),
        covariances: bytes_of_float64s(points.iter().flat_map(covariance)),
        parallax_rad: number(|p| p.parallax_rad),
        rmse_px: number(|p| p.rmse_px),
        in_front: points.iter().map(|p| u8::from(p.as_ref().is_some_and(|p| p.in_front))).collect::<Vec<u8>>().into(),
    }
}

/// A camera's pose as a message.
pub fn pnp_to(p: &PnpEstimate) -> v1::SolvePnpResponse {
    v1::SolvePnpResponse {
        t_world_camera: Some(geometry::pose_to(&p.t_world_camera)),
        covariance: Some(geometry::covariance_to(&p.covariance)),
        inliers: bytes_of_indices(&p.inliers),
        rmse_px: p.rmse_px,
        iterations: p.iterations as u32,
    }
}

/// Things in an image as a message.
pub fn image_detections_to(found: &[Detection2d]) -> v1::DetectInImageResponse {
    let convert = |d: &Detection2d| v1::ImageDetection {
        label: d.label.to_string(),
        score: d.score,
        left_px: d.bbox.left_px,
        top_px: d.bbox.top_px,
        right_px: d.bbox.right_px,
        bottom_px: d.bbox.bottom_px,
    };
    v1::DetectInImageResponse { detections: found.iter().map(convert).collect() }
}

/// Learned detectors as a message.
pub fn image_detectors_to(detectors: &ImageDetectors) -> v1::ListImageDetectorsResponse {
    let info = |(name, detector): (&str, &dyn ImageDetector)| v1::ImageDetectorInfo {
        name: name.to_owned(),
        labels: detector.labels().to_vec(),
    };
    v1::ListImageDetectorsResponse { detectors: detectors.iter().map(info).collect() }
}
