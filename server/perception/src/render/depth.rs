//! A depth image in colours.

use super::colors;
use percept_geometry::{DepthImage, GeometryError, RgbImage};

/// Draws depth from near (blue) to far (red); black where nothing was measured. `range_m` is what gets the first and the
/// last colour; none takes the nearest and farthest hundredth as such.
///
/// # Errors
/// `OutOfRange` for a range that does not rise; what is wrong with the image's own shape.
pub fn render_depth(depth: &DepthImage, range_m: Option<(f32, f32)>) -> Result<RgbImage, GeometryError> {
    let values = depth.data();
    let (near, far) = match range_m {
        Some((near, far)) if near.is_finite() && far.is_finite() && near < far => (near, far),
        Some((_, far)) => {
            let requirement = "finite, and above the near end of the range";
            return Err(GeometryError::OutOfRange { field: "range_m", value: far.into(), requirement });
        }
        None => usual_range(values),
    };
    let color = |v: &f32| if *v > 0.0 { colors::ramp((v - near) / (far - near)) } else { [0; 3] };
    let pixels: Vec<[u8; 3]> = values.iter().map(color).collect();
    RgbImage::new(depth.width(), depth.height(), pixels.into_flattened())
}

fn usual_range(values: &[f32]) -> (f32, f32) {
    let mut known: Vec<f32> = values.iter().copied().filter(|v| *v > 0.0).collect();
    known.sort_by(f32::total_cmp);
    let at = |share: f64| known.get((share * known.len().saturating_sub(1) as f64) as usize).copied();
    let (near, far) = (at(0.01).unwrap_or(0.0), at(0.99).unwrap_or(1.0));
    (near, far.max(near + 1e-3))
}
