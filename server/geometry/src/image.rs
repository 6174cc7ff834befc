//! Images: row-major, top-left origin, checked sizes.

use crate::GeometryError;

fn check(
    field: &'static str,
    width: usize,
    height: usize,
    channels: usize,
    actual: usize,
) -> Result<(), GeometryError> {
    let expected = width.checked_mul(height).and_then(|n| n.checked_mul(channels)).unwrap_or(usize::MAX);
    if expected == actual { Ok(()) } else { Err(GeometryError::ShapeMismatch { field, expected, actual }) }
}

/// Depth along the optical axis z, metres, `H x W` row-major; 0 is 'no return'.
#[derive(Debug, Clone, PartialEq)]
pub struct DepthImage {
    width: usize,
    height: usize,
    data: Vec<f32>,
}

impl DepthImage {
    /// From `H x W` metres; non-finite and negative values become 0, 'no return'.
    ///
    /// # Errors
    /// `ShapeMismatch` if `data` does not hold `width * height` values.
    pub fn new(width: usize, height: usize, mut data: Vec<f32>) -> Result<Self, GeometryError> {
        check("depth", width, height, 1, data.len())?;
        for d in &mut data {
            if !(d.is_finite() && *d > 0.0) {
                *d = 0.0;
            }
        }
        Ok(Self { width, height, data })
    }

    /// From 16-bit units of `metres_per_unit`; 0 and 65535 (Kinect's overflow) are 'no return'.
    ///
    /// # Errors
    /// `ShapeMismatch` as above; `OutOfRange` if `metres_per_unit` is not positive and finite.
    pub fn from_u16(width: usize, height: usize, units: &[u16], metres_per_unit: f64) -> Result<Self, GeometryError> {
        check("depth", width, height, 1, units.len())?;
        if !(metres_per_unit.is_finite() && metres_per_unit > 0.0) {
            return Err(GeometryError::OutOfRange {
                field: "metres_per_unit",
                value: metres_per_unit,
                requirement: "positive and finite",
            });
        }
        let scale = metres_per_unit as f32;
        let data = units.iter().map(|&u| if u == u16::MAX { 0.0 } else { f32::from(u) * scale }).collect();
        Ok(Self { width, height, data })
    }

    /// Columns.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// `H x W` metres, row-major.
    pub fn data(&self) -> &[f32] {
        &self.data
    }

    /// Depth at column `u`, row `v`, metres; 0 is 'no return'.
    pub fn at(&self, u: usize, v: usize) -> f32 {
        self.data[v * self.width + u]
    }
}

/// RGB8, `H x W x 3` row-major.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RgbImage {
    width: usize,
    height: usize,
    data: Vec<u8>,
}

impl RgbImage {
    /// From `H x W x 3` bytes.
    ///
    /// # Errors
    /// `ShapeMismatch` if `data` does not hold `width * height * 3` bytes.
    pub fn new(width: usize, height: usize, data: Vec<u8>) -> Result<Self, GeometryError> {
        check("colour", width, height, 3, data.len())?;
        Ok(Self { width, height, data })
    }

    /// Columns.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// `H x W x 3` bytes, row-major.
    pub fn data(&self) -> &[u8] {
        &self.data
    }

    /// Colour at column `u`, row `v`.
    pub fn at(&self, u: usize, v: usize) -> [u8; 3] {
        let i = (v * self.width + u) * 3;
        [self.data[i], self.data[i + 1], self.data[i + 2]]
    }

    /// Luma by ITU-R BT.601, 0..255.
    pub fn to_gray(&self) -> GrayImage {
        let data = self
            .data
            .chunks_exact(3)
            .map(|c| ((u32::from(c[0]) * 299 + u32::from(c[1]) * 587 + u32::from(c[2]) * 114 + 500) / 1000) as u8)
            .collect();
        GrayImage { width: self.width, height: self.height, data }
    }
}

/// 8-bit grey, `H x W` row-major.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct GrayImage {
    width: usize,
    height: usize,
    data: Vec<u8>,
}

impl GrayImage {
    /// From `H x W` bytes.
    ///
    /// # Errors
    /// `ShapeMismatch` if `data` does not hold `width * height` bytes.
    pub fn new(width: usize, height: usize, data: Vec<u8>) -> Result<Self, GeometryError> {
        check("gray", width, height, 1, data.len())?;
        Ok(Self { width, height, data })
    }

    /// Columns.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// `H x W` bytes, row-major.
    pub fn data(&self) -> &[u8] {
        &self.data
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_size_that_overflows_is_a_mismatch_not_a_panic() {
        assert!(DepthImage::new(usize::MAX, 2, vec![]).is_err());
        assert!(RgbImage::new(usize::MAX / 2, 2, vec![0; 6]).is_err());
    }

    #[test]
    fn invalid_depths_become_no_return() {
        let image = DepthImage::new(2, 2, vec![f32::NAN, -1.0, f32::INFINITY, 1.5]).unwrap();
        assert_eq!(image.data(), [0.0, 0.0, 0.0, 1.5]);
        let image = DepthImage::from_u16(2, 1, &[65535, 1000], 0.001).unwrap();
        assert_eq!(image.data(), [0.0, 1.0]);
    }
}
