//! Returns that do not belong: far from their neighbours' median; and holes small enough to close.

use super::{MedianHoles, MedianParams, median, positive, size};
use percept_geometry::{DepthImage, GeometryError};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Which returns [`remove_outliers`] drops.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DepthOutlierParams {
    /// Side of the window, pixels: 3 or 5.
    pub size_px: usize,
    /// Standard deviations of the window's returns that a return may lie off their median.
    pub ratio: f64,
    /// A return this close to the median stays however even its neighbours are: part of the depth.
    pub min_deviation_fraction: f64,
    /// A return with fewer others in its window is dropped.
    pub min_neighbours: usize,
}

impl Default for DepthOutlierParams {
    fn default() -> Self {
        Self { size_px: 5, ratio: 2.0, min_deviation_fraction: 0.01, min_neighbours: 4 }
    }
}

/// The image without returns that lie further off the median of their window than `ratio` of its standard deviations.
/// Windows end at the border; pixels without return do not count.
///
/// # Errors
/// `OutOfRange` naming the parameter.
pub fn remove_outliers(depth: &DepthImage, params: &DepthOutlierParams) -> Result<DepthImage, GeometryError> {
    positive("ratio", params.ratio)?;
    positive("min_deviation_fraction", params.min_deviation_fraction)?;
    let medians = median(depth, &MedianParams { size_px: params.size_px, holes: MedianHoles::Ignored })?;
    let ((w, h), data, r) = (size(depth), depth.data(), params.size_px / 2);
    let mut out = data.to_vec();
    out.par_chunks_mut(w.max(1)).enumerate().for_each(|(v, row)| {
        let rows = v.saturating_sub(r)..(v + r + 1).min(h);
        for (u, pixel) in row.iter_mut().enumerate().filter(|(_, d)| **d > 0.0) {
            let middle = medians.at(u, v);
            let off = (*pixel - middle).abs();
            let (mut count, mut sum, mut squares) = (0usize, 0.0f32, 0.0f32);
            for y in rows.clone() {
                for d in &data[y * w + u.saturating_sub(r)..y * w + (u + r + 1).min(w)] {
                    if *d > 0.0 {
                        count += 1;
                        sum += d - middle;
                        squares += (d - middle) * (d - middle);
                    }
                }
            }
            let mean = sum / count as f32;
            let deviation = (squares / count as f32 - mean * mean).max(0.0).sqrt();
            let least = params.min_deviation_fraction as f32 * middle;
            if count <= params.min_neighbours || off > least.max(params.ratio as f32 * deviation) {
                *pixel = 0.0;
            }
        }
    });
    DepthImage::new(w, h, out)
}

/// Which holes [`fill_holes`] closes.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FillParams {
    /// Rounds; each closes holes from their rim by one or two pixels.
    pub iterations: usize,
    /// Returns that a hole's 5 x 5 window must hold, 1 to 24.
    pub min_neighbours: usize,
    /// Returns of the window farther apart than this part of the depth are two surfaces: the hole stays, as nothing
    /// tells to which it belongs.
    pub max_jump_fraction: f64,
}

impl Default for FillParams {
    fn default() -> Self {
        Self { iterations: 1, min_neighbours: 12, max_jump_fraction: 0.05 }
    }
}

/// Closes small holes within one surface with the mean of the returns around them; returns stay as they are.
///
/// # Errors
/// `OutOfRange` naming the parameter.
pub fn fill_holes(depth: &DepthImage, params: &FillParams) -> Result<DepthImage, GeometryError> {
    positive("max_jump_fraction", params.max_jump_fraction)?;
    for (field, value, most) in [("iterations", params.iterations, 64), ("min_neighbours", params.min_neighbours, 24)] {
        if !(1..=most).contains(&value) {
            let requirement = if most == 64 { "between 1 and 64" } else { "between 1 and 24" };
            return Err(GeometryError::OutOfRange { field, value: value as f64, requirement });
        }
    }
    let (w, h) = size(depth);
    let mut data = depth.data().to_vec();
    for _ in 0..params.iterations {
        let before = data.clone();
        data.par_chunks_mut(w.max(1)).enumerate().for_each(|(v, row)| {
            for (u, pixel) in row.iter_mut().enumerate().filter(|(_, d)| **d == 0.0) {
                *pixel = filling(&before, (w, h), u, v, params).unwrap_or(0.0);
            }
        });
        if data == before {
            break;
        }
    }
    DepthImage::new(w, h, data)
}

fn filling(data: &[f32], (w, h): (usize, usize), u: usize, v: usize, params: &FillParams) -> Option<f32> {
    let (mut count, mut sum, mut near, mut far) = (0usize, 0.0f32, f32::INFINITY, 0.0f32);
    for y in v.saturating_sub(2)..(v + 3).min(h) {
        for &d in &data[y * w + u.saturating_sub(2)..y * w + (u + 3).min(w)] {
            if d > 0.0 {
                (count, sum, near, far) = (count + 1, sum + d, near.min(d), far.max(d));
            }
        }
    }
    let one_surface = far - near <= params.max_jump_fraction as f32 * near;
    (count >= params.min_neighbours && one_surface).then(|| sum / count as f32)
}

/// Depth as 16-bit units of `metres_per_unit` (16UC1), rounded; 0 where there is no return or the depth does not fit.
///
/// # Errors
/// `OutOfRange` if `metres_per_unit` is not positive and finite.
pub fn to_units(depth: &DepthImage, metres_per_unit: f64) -> Result<Vec<u16>, GeometryError> {
    positive("metres_per_unit", metres_per_unit)?;
    let unit = |d: &f32| {
        let units = (f64::from(*d) / metres_per_unit).round();
        // 65535 reads as 'no return'.
        if units < 65535.0 { units as u16 } else { 0 }
    };
    Ok(depth.data().iter().map(unit).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn slope() -> Vec<f32> {
        (0..40 * 30).map(|i| 1.0 + 0.002 * (i % 40) as f32).collect()
    }

    #[test]
    fn a_flying_pixel_goes_and_its_surface_stays() {
        let mut data = slope();
        data[15 * 40 + 20] = 1.3;
        let clean = remove_outliers(&DepthImage::new(40, 30, data).unwrap(), &DepthOutlierParams::default()).unwrap();
        let gone: Vec<usize> = (0..1200).filter(|&i| clean.data()[i] == 0.0).collect();
        assert_eq!(gone, [15 * 40 + 20]);
    }

    #[test]
    fn lone_returns_go() {
        let mut data = vec![0.0; 1200];
        data[500] = 1.0;
        let clean = remove_outliers(&DepthImage::new(40, 30, data).unwrap(), &DepthOutlierParams::default()).unwrap();
        assert_eq!(clean.data()[500], 0.0);
    }

    #[test]
    fn a_hole_in_a_surface_closes_and_one_between_two_stays() {
        let mut data = slope();
        data[500] = 0.0;
        let filled = fill_holes(&DepthImage::new(40, 30, data.clone()).unwrap(), &FillParams::default()).unwrap();
        assert!((filled.data()[500] - slope()[500]).abs() < 1e-3);
        data.iter_mut().enumerate().filter(|(i, _)| i % 40 > 20).for_each(|(_, d)| *d *= 2.0);
        let filled = fill_holes(&DepthImage::new(40, 30, data).unwrap(), &FillParams::default()).unwrap();
        assert_eq!(filled.data()[500], 0.0);
    }

    #[test]
    fn units_come_back() {
        let units: Vec<u16> = (0..=65534).collect();
        let depth = DepthImage::from_u16(65535, 1, &units, 0.0002).unwrap();
        assert_eq!(to_units(&depth, 0.0002).unwrap(), units);
        assert_eq!(to_units(&DepthImage::new(1, 1, vec![70.0]).unwrap(), 0.001).unwrap(), [0]);
        assert!(to_units(&depth, 0.0).is_err());
    }
}
