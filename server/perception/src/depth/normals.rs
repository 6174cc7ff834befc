//! Normals straight from a depth image: the fast form of [`VertexMap`](super::VertexMap) and [`NormalMap::new`].
//!
//! Bound: about 90 vector operations and 12 bytes written a pixel.

use super::room::{Room, filled_in_bands};
use super::{NormalMap, NormalMapParams, RayTable, check_size, size};
use nalgebra::Vector3;
use percept_geometry::{DepthImage, GeometryError, by_processor};

/// Rows of one unit of work; fixed, so that results do not depend on threads.
const BAND: usize = 32;
/// Pixels that are worked on together.
const BLOCK: usize = 64;
/// Normals that are written together.
const PART: usize = 16;

impl NormalMap {
    /// The normals that [`NormalMap::new`] finds on the image's vertices, without storing these.
    ///
    /// # Errors
    /// `OutOfRange` naming the parameter; `ShapeMismatch` if the image is not of the table's size.
    pub fn of_depth(depth: &DepthImage, rays: &RayTable, params: &NormalMapParams) -> Result<Self, GeometryError> {
        params.validate()?;
        check_size("depth", (rays.width(), rays.height()), size(depth))?;
        let (width, height) = size(depth);
        let jump = params.max_jump_fraction as f32 * params.step_px as f32;
        let min_cos = params.max_incidence_rad.min(std::f64::consts::FRAC_PI_2).cos() as f32;
        let normals = filled_in_bands(width * height, width * BAND, |i, normals| {
            let (v0, num_rows) = (i * BAND, BAND.min(height - i * BAND));
            let band = Band::new(depth, rays, v0, num_rows, params.step_px);
            normals_of_band(&band, num_rows, jump, min_cos * min_cos, normals);
        });
        Ok(Self { width, height, normals })
    }
}

/// A band's depths, NaN where nothing is, and its rays, with `step` rows and columns around.
struct Band {
    step: usize,
    width: usize,
    room: usize,
    depths: Vec<f32>,
    /// One row for all where they are the same in each.
    xs: Vec<f32>,
    x_room: usize,
    ys: Vec<f32>,
}

impl Band {
    fn new(depth: &DepthImage, rays: &RayTable, v0: usize, num_rows: usize, step: usize) -> Self {
        let (width, height) = size(depth);
        let room = width.next_multiple_of(BLOCK) + 2 * step;
        let all_rows = num_rows + 2 * step;
        let (x_rows, x_room) = if rays.is_separable() { (1, 0) } else { (all_rows, room) };
        let mut band = Self {
            step,
            width,
            room,
            depths: vec![f32::NAN; room * all_rows],
            xs: vec![0.0; room * x_rows],
            x_room,
            ys: vec![0.0; room * all_rows],
        };
        let mut scratch = Vec::new();
        for i in 0..all_rows {
            let v = (v0 + i).wrapping_sub(step);
            if v < height {
                let (xs, ys) = rays.row(v, &mut scratch);
                let row = i * room + step..i * room + step + width;
                band.xs[i * x_room + step..][..width].copy_from_slice(xs);
                band.ys[row.clone()].copy_from_slice(ys);
                depths_of_row(&depth.data()[v * width..(v + 1) * width], xs, ys, &mut band.depths[row]);
            }
        }
        band
    }

    /// x and y at depth 1, and the depths of a block: from column `u - step` of row `i - step` on.
    #[inline(always)]
    fn block<'a>(&'a self, i: usize, u: usize) -> [&'a [f32; BLOCK]; 3] {
        let chunk = |values: &'a [f32], at: usize| values[at..].first_chunk().unwrap_or(&[0.0; BLOCK]);
        [
            chunk(&self.xs, i * self.x_room + u),
            chunk(&self.ys, i * self.room + u),
            chunk(&self.depths, i * self.room + u),
        ]
    }
}

by_processor! {
    [avx512]
    fn depths_of_row(depths: &[f32], xs: &[f32], ys: &[f32], out: &mut [f32]) {
        let n = depths.len();
        let (xs, ys, out) = (&xs[..n], &ys[..n], &mut out[..n]);
        for i in 0..n {
            let finite = (xs[i] + ys[i]) * 0.0 == 0.0;
            out[i] = if finite & (depths[i] > 0.0) { depths[i] } else { f32::NAN };
        }
    }
}

/// The neighbour ahead minus the one behind; the pixel itself where one of them is not on its surface.
#[inline(always)]
fn difference(p: [f32; 3], ahead: [f32; 3], behind: [f32; 3], reach: f32) -> [f32; 3] {
    // NaN is not within reach.
    let a = (ahead[2] - p[2]).abs() <= reach;
    let b = (behind[2] - p[2]).abs() <= reach;
    let one = |k: usize| (if a { ahead[k] } else { p[k] }) - (if b { behind[k] } else { p[k] });
    [one(0), one(1), one(2)]
}

/// 1 / sqrt(v), relative error below 3e-7, for positive normal numbers: a first guess from the bits (Lomont, "Fast
/// inverse square root", 2003), then Newton. Takes half the time of a root and a division, and is the same everywhere.
#[inline(always)]
fn inverse_root(v: f32) -> f32 {
    let mut r = f32::from_bits(0x5F37_59DFu32.wrapping_sub(v.to_bits() >> 1));
    let half = 0.5 * v;
    for _ in 0..3 {
        r *= 1.5 - half * r * r;
    }
    r
}

#[inline(always)]
fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

by_processor! {
    [avx512]
    fn normals_of_band(band: &Band, num_rows: usize, jump: f32, min_cos2: f32, out: &mut Room<'_, Vector3<f32>>) {
        let step = band.step;
        for i in step..num_rows + step {
            for u in (0..band.width).step_by(BLOCK) {
                let (p, left, right) = (band.block(i, u + step), band.block(i, u), band.block(i, u + 2 * step));
                let (up, down) = (band.block(i - step, u + step), band.block(i + step, u + step));
                let (mut nx, mut ny, mut nz) = ([0.0f32; BLOCK], [0.0f32; BLOCK], [0.0f32; BLOCK]);
                for j in 0..BLOCK {
                    let of = |b: [&[f32; BLOCK]; 3]| [b[0][j] * b[2][j], b[1][j] * b[2][j], b[2][j]];
                    let here = of(p);
                    let reach = jump * here[2];
                    let a = difference(here, of(down), of(up), reach);
                    let b = difference(here, of(right), of(left), reach);
                    let n = [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
                    let (n2, facing) = (dot(n, n), -dot(n, here));
                    // At a grazing angle the differences are mostly noise; a zero normal fails, too.
                    let good = facing * facing > min_cos2 * (n2 * dot(here, here));
                    let scale = inverse_root(n2).copysign(facing);
                    nx[j] = if good { n[0] * scale } else { 0.0 };
                    ny[j] = if good { n[1] * scale } else { 0.0 };
                    nz[j] = if good { n[2] * scale } else { 0.0 };
                }
                for k in (0..BLOCK.min(band.width - u)).step_by(PART) {
                    let mut part = [Vector3::zeros(); PART];
                    for j in 0..PART {
                        part[j] = Vector3::new(nx[k + j], ny[k + j], nz[k + j]);
                    }
                    out.push(&part, band.width - u - k);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::VertexMap;
    use super::*;
    use percept_geometry::CameraIntrinsics;
    use percept_geometry::camera::Distortion;
    use rand::{RngExt, SeedableRng};

    #[test]
    fn the_fast_normals_are_those_of_the_vertex_map() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(3);
        for (w, h, step_px) in [(1, 1, 1), (40, 3, 2), (3, 70, 1), (131, 67, 2), (64, 40, 5)] {
            let camera = CameraIntrinsics {
                distortion: Distortion::PlumbBob([-0.1, 0.02, 1e-3, 0.0, 0.0]),
                ..CameraIntrinsics::pinhole(w, h, 90.0, 91.0, w as f64 / 2.0, h as f64 / 2.0)
            };
            let data = (0..w * h).map(|i| match rng.random_range(0..20) {
                0 => 0.0,
                1 => 4.0,
                _ => 2.0 + 0.01 * (i % w) as f32 + 0.02 * (i / w) as f32 + rng.random_range(0.0..0.01f32),
            });
            let depth = DepthImage::new(w, h, data.collect()).unwrap();
            let (rays, params) = (RayTable::new(&camera).unwrap(), NormalMapParams { step_px, ..Default::default() });
            let plain = NormalMap::new(&VertexMap::new(&depth, &rays).unwrap(), &params).unwrap();
            let fast = NormalMap::of_depth(&depth, &rays, &params).unwrap();
            for (i, (a, b)) in fast.normals.iter().zip(&plain.normals).enumerate() {
                assert!((a - b).norm() < 2e-6, "{w} x {h}, pixel {i}: {a} {b}");
            }
        }
    }
}
