//! Clouds and depth images as PNG.

use super::format_error;
use crate::Result;
use percept_formats::images;
use percept_geometry::{DepthImage, PointCloud};
use percept_perception::render::{self, RenderParams};

/// A cloud as a PNG; `labels`, one a point, may colour it.
///
/// # Errors
/// `OUT_OF_RANGE`, `SIZE_MISMATCH` naming the field.
pub fn render_cloud(cloud: &PointCloud, labels: Option<&[Option<u32>]>, params: &RenderParams) -> Result<Vec<u8>> {
    images::encode_rgb_png(&render::render_cloud(cloud, labels, params)?).map_err(format_error)
}

/// A depth image as a PNG, from near (blue) to far (red), metres.
///
/// # Errors
/// `OUT_OF_RANGE` for a range that does not rise.
pub fn render_depth(depth: &DepthImage, range_m: Option<(f32, f32)>) -> Result<Vec<u8>> {
    images::encode_rgb_png(&render::render_depth(depth, range_m)?).map_err(format_error)
}
