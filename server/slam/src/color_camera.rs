//! Where a colour camera sees what a depth camera sees.

use nalgebra::Vector3;
use percept_geometry::CameraIntrinsics;

/// Pinhole of the colour image on the frame's grid, its optical axis parallel to depth's.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct ColorCamera {
    pub(crate) fx: f32,
    pub(crate) fy: f32,
    pub(crate) cx: f32,
    pub(crate) cy: f32,
    /// Focal length times baseline along x, pixel metres.
    pub(crate) bx: f32,
}

impl ColorCamera {
    /// The same as the depth's.
    pub(crate) fn registered(depth: &CameraIntrinsics) -> Self {
        let (fx, fy, cx, cy) = (depth.fx as f32, depth.fy as f32, depth.cx as f32, depth.cy as f32);
        Self { fx, fy, cx, cy, bx: 0.0 }
    }

    /// Pixel of a point in the depth camera's frame (metres, `z > 0`).
    #[inline]
    pub(crate) fn project(&self, p: &Vector3<f32>) -> (f32, f32) {
        let w = 1.0 / p.z;
        ((self.fx * p.x + self.bx) * w + self.cx, self.fy * p.y * w + self.cy)
    }

    /// For the image that was shrunk by `factor` with averaging.
    pub(crate) fn enlarged(&self, factor: f32) -> Self {
        let middle = |c: f32| c * factor + 0.5 * (factor - 1.0);
        Self {
            fx: self.fx * factor,
            fy: self.fy * factor,
            cx: middle(self.cx),
            cy: middle(self.cy),
            bx: self.bx * factor,
        }
    }
}
