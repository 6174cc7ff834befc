//! Features of images.

use crate::{Error, Result};
use percept_geometry::GrayImage;
use percept_perception::features2d::{FeatureError, Features, Orb, OrbParams, Sift, SiftParams};

/// How features are found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum FeatureMethod {
    /// Oriented FAST corners with bits.
    Orb(OrbParams),
    /// Blobs in scale space with numbers.
    Sift(SiftParams),
}

/// Features that could not be found or matched.
pub fn feature_error(e: FeatureError) -> Error {
    match e {
        FeatureError::Params(e) => e.into(),
        FeatureError::ImageTooLarge { .. } => Error::exhausted("IMAGE_TOO_LARGE", "image", e.to_string()),
        FeatureError::KindsDiffer => Error::invalid("DESCRIPTORS_DIFFER", "train", e.to_string()),
        FeatureError::TooManyDescriptors { .. } => Error::exhausted("DESCRIPTORS_TOO_MANY", "query", e.to_string()),
    }
}

/// Features of an image.
///
/// # Errors
/// `OUT_OF_RANGE`, `IMAGE_TOO_LARGE`.
pub fn extract_features(image: &GrayImage, method: &FeatureMethod) -> Result<Features> {
    match method {
        FeatureMethod::Orb(params) => Orb::new(*params).and_then(|orb| orb.extract(image)),
        FeatureMethod::Sift(params) => Sift::new(*params).and_then(|mut sift| sift.extract(image)),
    }
    .map_err(feature_error)
}
