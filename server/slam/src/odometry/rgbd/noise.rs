//! How depth errs with distance.

/// Standard deviation of a smoothed depth, metres at depth `z` metres.
///
/// Source: Khoshelham and Elberink, "Accuracy and resolution of Kinect depth data", 2012 (quadratic in
/// depth, about 2.85e-3 z^2 a pixel with quantisation); stereo cameras follow the same law. The constant
/// is for small wrongs of shape that do not shrink with distance.
#[inline]
pub(crate) fn sigma(z: f32) -> f32 {
    0.002 + 0.0025 * z * z
}
