//! SIFT: blobs found in scale space, described by histograms of gradients.
//!
//! **Source:** Lowe, "Distinctive image features from scale-invariant keypoints", IJCV 2004; RootSIFT by Arandjelovic
//! and Zisserman, CVPR 2012. In the order of the work: `scale_space` (Gaussians), `extrema` (keypoints),
//! `orientation`, `descriptor`.

mod binary;
mod descriptor;
mod extrema;
mod orientation;
mod scale_space;

pub use binary::binary_sift;

use super::{Descriptors, FeatureError, Features, Keypoint, check_size, within};
use percept_geometry::GrayImage;
use rayon::prelude::*;
use scale_space::{Extremum, ScaleSpace};
use serde::{Deserialize, Serialize};

/// How [`Sift`] finds features.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SiftParams {
    /// Most features of an image, 1 to 100000: those of the highest contrast.
    pub max_features: usize,
    /// Least contrast, of the full range of grey, divided by the 3 layers of an octave; 0 to 1.
    pub contrast_threshold: f64,
    /// Greatest ratio of curvatures: larger keeps more of what lies on edges; at least 1.
    pub edge_threshold: f64,
    /// Hellinger's kernel on top: square roots of the parts.
    pub root: bool,
}

impl Default for SiftParams {
    fn default() -> Self {
        Self { max_features: 1000, contrast_threshold: 0.04, edge_threshold: 10.0, root: false }
    }
}

impl SiftParams {
    /// Checks every field.
    ///
    /// # Errors
    /// `OutOfRange` naming the field.
    pub fn validate(&self) -> Result<(), FeatureError> {
        within("max_features", self.max_features as f64, 1.0, 1e5, "between 1 and 100000")?;
        within("contrast_threshold", self.contrast_threshold, 0.0, 1.0, "between 0 and 1")?;
        within("edge_threshold", self.edge_threshold, 1.0, 1e6, "at least 1")
    }
}

/// Finds SIFT features; keeps its images from call to call.
#[derive(Debug)]
pub struct Sift {
    params: SiftParams,
    space: ScaleSpace,
}

impl Sift {
    /// With checked parameters.
    ///
    /// # Errors
    /// `OutOfRange` naming the field.
    pub fn new(params: SiftParams) -> Result<Self, FeatureError> {
        params.validate()?;
        Ok(Self { params, space: ScaleSpace::default() })
    }

    /// Features of an image, highest contrast first; none in an image under 8 x 8. A place with two main directions
    /// counts as two features.
    ///
    /// # Errors
    /// `ImageTooLarge`.
    pub fn extract(&mut self, image: &GrayImage) -> Result<Features, FeatureError> {
        check_size(image)?;
        self.space.build(image);
        let space = &self.space;
        let mut found: Vec<Extremum> = extrema::find(space, &self.params);
        let order = |a: &Extremum, b: &Extremum| {
            let place = |e: &Extremum| (e.octave, e.layer, e.row, e.column);
            b.response.total_cmp(&a.response).then(place(a).cmp(&place(b)))
        };
        found.sort_unstable_by(order);
        // Two starts may end at the same place.
        found.dedup_by(|a, b| a.octave == b.octave && a.layer == b.layer && a.row == b.row && a.column == b.column);
        // Each has one direction at least: more than this many are never needed.
        found.truncate(self.params.max_features);
        let directed: Vec<Vec<f32>> =
            found.par_iter().with_min_len(16).map(|e| orientation::directions(space.image(e), e)).collect();
        let oriented: Vec<(&Extremum, f32)> = found
            .iter()
            .zip(&directed)
            .flat_map(|(e, angles)| angles.iter().map(move |&a| (e, a)))
            .take(self.params.max_features)
            .collect();
        let descriptors = oriented
            .par_iter()
            .with_min_len(16)
            .map(|&(e, angle)| descriptor::describe(space.image(e), e, angle, self.params.root))
            .collect();
        let keypoints = oriented.iter().map(|&(e, angle)| keypoint(e, angle)).collect();
        Ok(Features { keypoints, descriptors: Descriptors::Bytes(descriptors) })
    }
}

/// In pixels of the given image: octave 0 of the scale space has twice its size.
fn keypoint(e: &Extremum, angle: f32) -> Keypoint {
    let pixel = 0.5 * (1u32 << e.octave) as f32;
    let angle_rad = if angle > std::f32::consts::PI { angle - std::f32::consts::TAU } else { angle };
    Keypoint {
        u: e.x * pixel,
        v: e.y * pixel,
        size_px: 2.0 * e.sigma * pixel,
        angle_rad,
        response: e.response,
        octave: e.octave as i32 - 1,
    }
}
