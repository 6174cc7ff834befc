//! Depth image to cloud.

use super::{RayTable, check_size, positive, size};
use nalgebra::Point3;
use percept_geometry::{CameraIntrinsics, DepthImage, GeometryError, PointCloud, RgbImage};
use serde::{Deserialize, Serialize};

/// Which pixels become points.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct UnprojectParams {
    /// Every `stride_px`-th column and row is taken, from the first on; at least 1.
    pub stride_px: usize,
    /// Nearest depth taken, metres.
    pub min_depth_m: f64,
    /// Farthest depth taken, metres.
    pub max_depth_m: f64,
}

impl Default for UnprojectParams {
    fn default() -> Self {
        Self { stride_px: 1, min_depth_m: 0.1, max_depth_m: 10.0 }
    }
}

impl UnprojectParams {
    /// Checks the bounds.
    ///
    /// # Errors
    /// `OutOfRange` naming the field.
    pub fn validate(&self) -> Result<(), GeometryError> {
        if self.stride_px == 0 {
            return Err(GeometryError::OutOfRange { field: "stride_px", value: 0.0, requirement: "at least 1" });
        }
        positive("max_depth_m", self.max_depth_m)?;
        if !(self.min_depth_m >= 0.0 && self.min_depth_m < self.max_depth_m) {
            return Err(GeometryError::OutOfRange {
                field: "min_depth_m",
                value: self.min_depth_m,
                requirement: "at least 0 and below max_depth_m",
            });
        }
        Ok(())
    }
}

/// The cloud of a depth image, optical frame, in row-major order of its pixels, with the colours of `color`
/// if given (registered to the depth, same size). Pixels without return or out of the bounds give no point.
///
/// # Errors
/// `OutOfRange` for parameters or intrinsics; `ShapeMismatch` naming the image that is not of the
/// intrinsics' size.
pub fn unproject(
    depth: &DepthImage,
    color: Option<&RgbImage>,
    intrinsics: &CameraIntrinsics,
    params: &UnprojectParams,
) -> Result<PointCloud, GeometryError> {
    unproject_with(depth, color, &RayTable::new(intrinsics)?, params)
}

/// As [`unproject`], with rays computed before.
///
/// # Errors
/// As [`unproject`].
pub fn unproject_with(
    depth: &DepthImage,
    color: Option<&RgbImage>,
    rays: &RayTable,
    params: &UnprojectParams,
) -> Result<PointCloud, GeometryError> {
    params.validate()?;
    check_size("depth", (rays.width(), rays.height()), size(depth))?;
    if let Some(color) = color {
        check_size("color", (rays.width(), rays.height()), (color.width(), color.height()))?;
    }
    let stride = params.stride_px;
    let room = depth.width().div_ceil(stride) * depth.height().div_ceil(stride);
    let mut positions = Vec::with_capacity(room);
    let mut colors = Vec::with_capacity(if color.is_some() { room } else { 0 });
    // Zero, 'no return', is below every bound.
    let (min, max) = ((params.min_depth_m as f32).max(f32::MIN_POSITIVE), params.max_depth_m as f32);
    for v in (0..depth.height()).step_by(stride) {
        for u in (0..depth.width()).step_by(stride) {
            let d = depth.at(u, v);
            if !(d >= min && d <= max) {
                continue;
            }
            let (x, y) = rays.ray(u, v);
            if !(x.is_finite() && y.is_finite()) {
                continue;
            }
            positions.push(Point3::new(x * d, y * d, d));
            if let Some(color) = color {
                colors.push(color.at(u, v));
            }
        }
    }
    Ok(PointCloud { positions, colors: color.map(|_| colors), ..PointCloud::default() })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera() -> CameraIntrinsics {
        CameraIntrinsics::pinhole(5, 4, 4.0, 4.0, 2.0, 1.5)
    }

    #[test]
    fn points_carry_their_pixels_colours_and_bad_pixels_give_none() {
        let mut data = vec![2.0; 20];
        data[0] = 0.0;
        data[1] = 0.05;
        data[2] = 11.0;
        let depth = DepthImage::new(5, 4, data).unwrap();
        let rgb = RgbImage::new(5, 4, (0..60).collect()).unwrap();
        let cloud = unproject(&depth, Some(&rgb), &camera(), &UnprojectParams::default()).unwrap();
        assert_eq!(cloud.len(), 17);
        assert_eq!(cloud.positions[0], Point3::new(0.5, -0.75, 2.0));
        assert_eq!(cloud.colors.unwrap()[0], [9, 10, 11]);
    }

    #[test]
    fn stride_takes_pixels_from_the_first_on() {
        let depth = DepthImage::new(5, 4, vec![1.0; 20]).unwrap();
        let cloud =
            unproject(&depth, None, &camera(), &UnprojectParams { stride_px: 2, ..Default::default() }).unwrap();
        assert_eq!(cloud.len(), 6);
        assert_eq!(cloud.positions[5], Point3::new(0.5, 0.125, 1.0));
    }

    #[test]
    fn sizes_that_disagree_are_named() {
        let depth = DepthImage::new(4, 5, vec![1.0; 20]).unwrap();
        let error = unproject(&depth, None, &camera(), &UnprojectParams::default()).unwrap_err();
        assert_eq!(error, GeometryError::ShapeMismatch { field: "depth", expected: 5, actual: 4 });
        let params = UnprojectParams { min_depth_m: 3.0, max_depth_m: 2.0, ..Default::default() };
        assert!(params.validate().unwrap_err().to_string().starts_with("min_depth_m"));
    }
}
