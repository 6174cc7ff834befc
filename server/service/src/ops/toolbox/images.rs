//! Several views of one scene.

use super::Toolbox;
use crate::{Error, ErrorCode, Result, reason};
use nalgebra::Point2;
use percept_geometry::{CameraIntrinsics, Pose, RgbImage};
use percept_perception::detection::Detection2d;
use percept_perception::multiview::{MultiviewError, TriangulatedPoint, triangulate};
use rayon::prelude::*;

/// Views of one triangulation, at most.
const MAX_VIEWS: usize = 64;

/// A model that could not be estimated.
pub fn multiview_error(e: MultiviewError) -> Error {
    match e {
        MultiviewError::Input(e) => e.into(),
        MultiviewError::TooFew { .. } => Error::invalid("CORRESPONDENCES_TOO_FEW", "", e.to_string()),
        MultiviewError::NoModel { .. } => Error::invalid("NO_MODEL", "", e.to_string()),
    }
}

/// Things in an image, by a learned detector of the server.
///
/// # Errors
/// `DETECTOR_NOT_FOUND`; `IMAGE_EMPTY`; `INTERNAL` if the model fails.
pub fn detect_in_image(toolbox: &Toolbox, name: &str, image: &RgbImage) -> Result<Vec<Detection2d>> {
    let detectors = toolbox.image_detectors();
    let unknown = || Error {
        code: ErrorCode::NotFound,
        ..crate::ops::unknown_detector("detector", name, detectors, reason::DETECTOR_NOT_FOUND)
    };
    let detector = detectors.get(name).ok_or_else(unknown)?;
    if image.width() == 0 || image.height() == 0 {
        return Err(Error::invalid(reason::IMAGE_EMPTY, "image", "the image has no pixels; send one with some"));
    }
    detector.detect(image).map_err(Error::internal)
}

/// A camera with a known pose, and what it sees.
#[derive(Debug, Clone, PartialEq)]
pub struct PosedView {
    /// The camera.
    pub camera: CameraIntrinsics,
    /// Optical frame to world.
    pub t_world_camera: Pose,
    /// N, not finite where it does not see a point.
    pub pixels: Vec<Point2<f64>>,
}

/// N points from their pixels; none where fewer than two views see one, or their rays are parallel.
///
/// # Errors
/// `VIEWS_INVALID`, `SIZE_MISMATCH`, and those of the intrinsics.
pub fn triangulate_points(views: &[PosedView]) -> Result<Vec<Option<TriangulatedPoint>>> {
    if !(2..=MAX_VIEWS).contains(&views.len()) {
        let words = format!("views has {} entries; send 2 to {MAX_VIEWS}", views.len());
        return Err(Error::invalid("VIEWS_INVALID", "views", words));
    }
    let n = views[0].pixels.len();
    if let Some(i) = views.iter().position(|v| v.pixels.len() != n) {
        let words = format!("views[{i}] has {} pixels and views[0] {n}; send one a point", views[i].pixels.len());
        return Err(Error::invalid("SIZE_MISMATCH", format!("views[{i}].pixels"), words));
    }
    let cameras: Vec<CameraIntrinsics> = views.iter().map(|v| v.camera).collect();
    let poses: Vec<Pose> = views.iter().map(|v| v.t_world_camera).collect();
    let point = |i: usize| {
        let pixels: Vec<Point2<f64>> = views.iter().map(|v| v.pixels[i]).collect();
        match triangulate(&pixels, &cameras, &poses) {
            Ok(point) => Ok(Some(point)),
            Err(MultiviewError::Input(e)) => Err(Error::from(e)),
            Err(_) => Ok(None),
        }
    };
    (0..n).into_par_iter().map(point).collect()
}
