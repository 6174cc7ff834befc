//! What a detector finds in an image.

use std::sync::Arc;

/// A rectangle of an image, pixels, edges parallel to the image's. The top left corner of the image is (0, 0) and its
/// bottom right one (width, height): a pixel in column `u` lies from `u` to `u + 1`, half a pixel off from the centres
/// that [`CameraIntrinsics`](percept_geometry::CameraIntrinsics) counts by.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ImageBox {
    /// Left edge, pixels.
    pub left_px: f64,
    /// Top edge, pixels.
    pub top_px: f64,
    /// Right edge, pixels.
    pub right_px: f64,
    /// Bottom edge, pixels.
    pub bottom_px: f64,
}

impl ImageBox {
    /// From the centre and the lengths of the edges, pixels.
    pub fn around(center_px: [f64; 2], size_px: [f64; 2]) -> Self {
        let ([x, y], [w, h]) = (center_px, size_px);
        Self { left_px: x - 0.5 * w, top_px: y - 0.5 * h, right_px: x + 0.5 * w, bottom_px: y + 0.5 * h }
    }

    /// Width, pixels.
    pub fn width_px(&self) -> f64 {
        self.right_px - self.left_px
    }

    /// Height, pixels.
    pub fn height_px(&self) -> f64 {
        self.bottom_px - self.top_px
    }

    /// Area, square pixels; 0 if it is turned inside out.
    pub fn area_px(&self) -> f64 {
        self.width_px().max(0.0) * self.height_px().max(0.0)
    }

    /// Whether all four edges are finite and it holds something.
    pub fn is_proper(&self) -> bool {
        let edges = [self.left_px, self.top_px, self.right_px, self.bottom_px];
        edges.iter().all(|e| e.is_finite()) && self.area_px() > 0.0
    }

    /// The part of it in an image of this size; may be turned inside out.
    #[must_use]
    pub fn clipped(&self, width: usize, height: usize) -> Self {
        let (w, h) = (width as f64, height as f64);
        Self {
            left_px: self.left_px.clamp(0.0, w),
            top_px: self.top_px.clamp(0.0, h),
            right_px: self.right_px.clamp(0.0, w),
            bottom_px: self.bottom_px.clamp(0.0, h),
        }
    }

    /// Area shared over area of the union, 0 to 1.
    pub fn iou(&self, other: &Self) -> f64 {
        let shared = Self {
            left_px: self.left_px.max(other.left_px),
            top_px: self.top_px.max(other.top_px),
            right_px: self.right_px.min(other.right_px),
            bottom_px: self.bottom_px.min(other.bottom_px),
        };
        let shared = shared.area_px();
        let union = self.area_px() + other.area_px() - shared;
        if union > 0.0 { (shared / union).clamp(0.0, 1.0) } else { 0.0 }
    }
}

/// A thing found in an image.
#[derive(Debug, Clone, PartialEq)]
pub struct Detection2d {
    /// What it is, in the detector's own words.
    pub label: Arc<str>,
    /// The place of the label among the detector's.
    pub label_index: usize,
    /// How sure the detector is, 0 to 1: its own score, not a calibrated probability.
    pub score: f64,
    /// Where it is, within the image.
    pub bbox: ImageBox,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn overlap_matches_the_closed_form() {
        let a = ImageBox::around([10.0, 10.0], [4.0, 4.0]);
        assert!((a.iou(&a) - 1.0).abs() < 1e-12);
        assert!((a.iou(&ImageBox::around([12.0, 10.0], [4.0, 4.0])) - 1.0 / 3.0).abs() < 1e-12);
        assert_eq!(a.iou(&ImageBox::around([20.0, 10.0], [4.0, 4.0])), 0.0);
        assert_eq!(a.iou(&ImageBox::around([f64::NAN, 10.0], [4.0, 4.0])), 0.0);
    }

    #[test]
    fn what_lies_outside_of_the_image_is_cut_off() {
        let b = ImageBox::around([0.0, 50.0], [20.0, 10.0]).clipped(100, 52);
        assert_eq!((b.left_px, b.top_px, b.right_px, b.bottom_px), (0.0, 45.0, 10.0, 52.0));
        assert!(b.is_proper() && !ImageBox::around([-50.0, 5.0], [20.0, 10.0]).clipped(100, 52).is_proper());
        assert!(!ImageBox::around([f64::NAN, 5.0], [20.0, 10.0]).is_proper());
    }
}
