//! Image features: a grey image in, keypoints with descriptors out; two sets of descriptors in, matches out.
//!
//! [`Orb`] is quick and binary, [`Sift`] is slow and steady; [`match_features`] pairs either by brute force. Pixel
//! centres have whole coordinates, (0, 0) the top-left one. Nothing here knows cameras: see `multiview`.

mod blur;
mod distance;
mod fast;
mod matching;
mod orb;
mod pattern;
mod pyramid;
mod sift;
mod spread;

pub use matching::{FeatureMatch, MatchParams, match_features};
pub use orb::{Orb, OrbParams};
pub use sift::{Sift, SiftParams, binary_sift};

use percept_geometry::GeometryError;

/// A distinct place of an image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Keypoint {
    /// Column in the full image, pixels.
    pub u: f32,
    /// Row in the full image, pixels.
    pub v: f32,
    /// Diameter of what was described, pixels of the full image.
    pub size_px: f32,
    /// Main direction from the x axis towards the y axis (down), `-pi..=pi`.
    pub angle_rad: f32,
    /// How distinct it is: Harris' measure for ORB, |DoG| for SIFT; comparable within one image only.
    pub response: f32,
    /// Pyramid level (ORB) or octave (SIFT, -1 is the doubled image).
    pub octave: i32,
}

/// Descriptors of one image, one after another.
#[derive(Debug, Clone, PartialEq)]
pub enum Descriptors {
    /// 256 bits each, compared by Hamming's distance.
    Binary(Vec<[u64; 4]>),
    /// 128 numbers 0..=255 each, compared by Euclid's distance.
    Bytes(Vec<[u8; 128]>),
}

impl Descriptors {
    /// How many.
    pub fn len(&self) -> usize {
        match self {
            Self::Binary(d) => d.len(),
            Self::Bytes(d) => d.len(),
        }
    }

    /// None at all.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// Keypoints and, in the same order, their descriptors.
#[derive(Debug, Clone, PartialEq)]
pub struct Features {
    /// Where.
    pub keypoints: Vec<Keypoint>,
    /// What it looks like there; as many as keypoints.
    pub descriptors: Descriptors,
}

/// Why features cannot be found or matched.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum FeatureError {
    /// A parameter is outside its bounds.
    #[error(transparent)]
    Params(#[from] GeometryError),
    /// The image has more pixels than can be taken.
    #[error("image: {width} x {height} is larger than {limit} pixels a side: shrink it")]
    ImageTooLarge {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
        /// Most pixels a side.
        limit: usize,
    },
    /// Binary descriptors cannot be compared with bytes.
    #[error("descriptors: the two sets are of different kinds: extract both by the same method")]
    KindsDiffer,
    /// More descriptors than can be compared at once.
    #[error("descriptors: {count} are more than {limit}: lower max_features")]
    TooManyDescriptors {
        /// As given.
        count: usize,
        /// Most.
        limit: usize,
    },
}

/// Most pixels a side of an image.
const MAX_SIDE: usize = 16384;

fn check_size(image: &percept_geometry::GrayImage) -> Result<(), FeatureError> {
    let (width, height) = (image.width(), image.height());
    if width > MAX_SIDE || height > MAX_SIDE || width * height > 1 << 26 {
        return Err(FeatureError::ImageTooLarge { width, height, limit: MAX_SIDE });
    }
    Ok(())
}

/// A parameter that has to lie in a range.
fn within(field: &'static str, value: f64, low: f64, high: f64, requirement: &'static str) -> Result<(), FeatureError> {
    if value >= low && value <= high {
        Ok(())
    } else {
        Err(GeometryError::OutOfRange { field, value, requirement }.into())
    }
}
