//! Depth image to cloud.

use super::room::{Room, filled};
use super::{RayTable, check_size, positive, size};
use nalgebra::Point3;
use percept_geometry::{CameraIntrinsics, DepthImage, GeometryError, PointCloud, RgbImage, by_processor};
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
    let row = |v: usize, out: &mut [f32]| out.copy_from_slice(&depth.data()[v * depth.width()..][..depth.width()]);
    unproject_rows(size(depth), row, color, rays, params)
}

/// As [`unproject_with`], from `H x W` 16-bit units of `metres_per_unit`; 0 and 65535 (Kinect's overflow) are no
/// return.
///
/// # Errors
/// As [`unproject`], and those of [`DepthImage::from_u16`].
pub fn unproject_units(
    units: &[u16],
    metres_per_unit: f64,
    color: Option<&RgbImage>,
    rays: &RayTable,
    params: &UnprojectParams,
) -> Result<PointCloud, GeometryError> {
    positive("metres_per_unit", metres_per_unit)?;
    let (w, expected) = (rays.width(), rays.width() * rays.height());
    if units.len() != expected {
        return Err(GeometryError::ShapeMismatch { field: "depth", expected, actual: units.len() });
    }
    let scale = metres_per_unit as f32;
    let row = |v: usize, out: &mut [f32]| metres_of_units(&units[v * w..(v + 1) * w], scale, out);
    unproject_rows((w, rays.height()), row, color, rays, params)
}

/// Pixels that are worked on together.
const BLOCK: usize = 16;

fn unproject_rows(
    (w, h): (usize, usize),
    read_row: impl Fn(usize, &mut [f32]),
    color: Option<&RgbImage>,
    rays: &RayTable,
    params: &UnprojectParams,
) -> Result<PointCloud, GeometryError> {
    params.validate()?;
    check_size("depth", (rays.width(), rays.height()), (w, h))?;
    if let Some(color) = color {
        check_size("colour", (rays.width(), rays.height()), (color.width(), color.height()))?;
    }
    let stride = params.stride_px;
    let room = w.div_ceil(stride) * h.div_ceil(stride);
    let mut colors = Vec::with_capacity(if color.is_some() { room } else { 0 });
    // Zero, 'no return', is below every bound.
    let (min, max) = ((params.min_depth_m as f32).max(f32::MIN_POSITIVE), params.max_depth_m as f32);
    let (mut depths, mut scratch) = (vec![0.0; w], Vec::new());
    let positions = filled(room, |positions| {
        for v in (0..h).step_by(stride) {
            read_row(v, &mut depths);
            let (xs, ys) = rays.row(v, &mut scratch);
            if stride == 1 && color.is_none() {
                points_of_row(&depths, xs, ys, (min, max), positions);
                continue;
            }
            for u in (0..w).step_by(stride) {
                let d = depths[u];
                if d >= min && d <= max && (xs[u] + ys[u]).is_finite() {
                    positions.push(&[Point3::new(xs[u] * d, ys[u] * d, d)], 1);
                    if let Some(color) = color {
                        colors.push(color.at(u, v));
                    }
                }
            }
        }
    });
    Ok(PointCloud { positions, colors: color.map(|_| colors), ..PointCloud::default() })
}

type Points<'a> = Room<'a, Point3<f32>>;

/// Appends the points of a row.
///
/// Bound: the points written, 12 bytes each. Holes cost no branch.
fn points_of_row(depths: &[f32], xs: &[f32], ys: &[f32], bounds: (f32, f32), out: &mut Points<'_>) {
    let (blocks, rest) = depths.as_chunks::<BLOCK>();
    let ((x_blocks, x_rest), (y_blocks, y_rest)) = (xs.as_chunks::<BLOCK>(), ys.as_chunks::<BLOCK>());
    points_of_blocks(blocks, x_blocks, y_blocks, bounds, out);
    for ((&d, &x), &y) in rest.iter().zip(x_rest).zip(y_rest) {
        if d >= bounds.0 && d <= bounds.1 && (x + y).is_finite() {
            out.push(&[Point3::new(x * d, y * d, d)], 1);
        }
    }
}

type Block = [f32; BLOCK];

fn points_of_blocks(depths: &[Block], xs: &[Block], ys: &[Block], bounds: (f32, f32), out: &mut Points<'_>) {
    #[cfg(target_arch = "x86_64")]
    if percept_geometry::simd::has_avx512() {
        // SAFETY: the processor has what the function is compiled for.
        #[allow(unsafe_code)]
        return unsafe { super::avx512::points_of_blocks(depths, xs, ys, bounds, out) };
    }
    plain_points_of_blocks(depths, xs, ys, bounds, out);
}

by_processor! {
    fn plain_points_of_blocks(
        depths: &[Block],
        xs: &[Block],
        ys: &[Block],
        bounds: (f32, f32),
        out: &mut Points<'_>,
    ) {
        let (min, max) = bounds;
        for ((d, x), y) in depths.iter().zip(xs).zip(ys) {
            let mut good = [0u32; BLOCK];
            for j in 0..BLOCK {
                // A ray that is not finite makes the sum so; times zero it is NaN.
                let finite = (x[j] + y[j]) * 0.0 == 0.0;
                good[j] = u32::from((d[j] >= min) & (d[j] <= max) & finite);
            }
            let num_good = good.iter().sum::<u32>() as usize;
            // Most blocks have all their returns or none.
            if num_good == 0 {
                continue;
            }
            let mut points = [Point3::new(0.0, 0.0, 0.0); BLOCK];
            for j in 0..BLOCK {
                points[j] = Point3::new(x[j] * d[j], y[j] * d[j], d[j]);
            }
            if num_good < BLOCK {
                let mut next = 0;
                for j in 0..BLOCK {
                    points[next] = points[j];
                    next += good[j] as usize;
                }
            }
            out.push(&points, num_good);
        }
    }
}

by_processor! {
    [avx512]
    /// Metres; 65535 is no return.
    fn metres_of_units(units: &[u16], scale: f32, out: &mut [f32]) {
        for (out, &u) in out.iter_mut().zip(units) {
            *out = if u == u16::MAX { 0.0 } else { f32::from(u) * scale };
        }
    }
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

    #[test]
    fn rows_in_blocks_and_units_give_the_points_of_each_pixel() {
        let camera = CameraIntrinsics {
            distortion: percept_geometry::camera::Distortion::PlumbBob([-0.2, 0.05, 1e-3, -1e-3, 0.0]),
            ..CameraIntrinsics::pinhole(77, 30, 60.0, 61.0, 38.0, 15.0)
        };
        let rays = RayTable::new(&camera).unwrap();
        // Whole blocks of returns, of none, and mixed ones.
        let units: Vec<u16> =
            (0..77 * 30u32).map(|i| if i % 77 < 32 || i % 3 == 0 { 900 + (i % 500) as u16 } else { 0 }).collect();
        let depth = DepthImage::from_u16(77, 30, &units, 0.001).unwrap();
        let rgb = RgbImage::new(77, 30, vec![7; 77 * 30 * 3]).unwrap();
        let params = UnprojectParams { max_depth_m: 1.3, ..Default::default() };
        let pixel_by_pixel = unproject_with(&depth, Some(&rgb), &rays, &params).unwrap();
        assert!(pixel_by_pixel.len() > 500);
        assert_eq!(unproject_with(&depth, None, &rays, &params).unwrap().positions, pixel_by_pixel.positions);
        assert_eq!(unproject_units(&units, 0.001, None, &rays, &params).unwrap().positions, pixel_by_pixel.positions);
        assert!(unproject_units(&units[1..], 0.001, None, &rays, &params).is_err());
    }

    #[test]
    fn blocks_packed_by_the_processors_widest_vectors_are_the_plain_ones() {
        let rays: Vec<Block> = (0..50).map(|b| std::array::from_fn(|j| (b * 16 + j) as f32 * 0.01 - 3.0)).collect();
        let mut xs = rays.clone();
        (xs[3][5], xs[4][0], xs[7][15]) = (f32::NAN, f32::INFINITY, f32::NEG_INFINITY);
        // Block by block other holes: none, all, and every pattern between.
        let hole = |b: usize, j: usize| (b as u64 * 0x9E37_79B9_7F4A_7C15) >> (b % 40 + j) & 1 == 1;
        let depth = |b: usize, j: usize| if b % 7 > 1 && hole(b, j) { 0.0 } else { 0.4 + 0.1 * (b + j) as f32 };
        let depths: Vec<Block> = (0..50).map(|b| std::array::from_fn(|j| depth(b, j))).collect();
        let fast = filled(50 * 16, |out| points_of_blocks(&depths, &xs, &rays, (0.5, 5.0), out));
        let plain = filled(50 * 16, |out| plain_points_of_blocks(&depths, &xs, &rays, (0.5, 5.0), out));
        assert!((200..750).contains(&plain.len()) && fast == plain);
    }
}
