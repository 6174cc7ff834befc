//! Which blocks a depth image has something to say about.

use crate::blocks::{BLOCK, BlockKey};
use nalgebra::{Point3, Vector3};
use percept_geometry::{CameraIntrinsics, DepthImage, Pose, by_processor};
use rustc_hash::FxHashSet;

/// Edge of a square of pixels of which one speaks for all those as deep, where it is small beside a block.
const SQUARE: usize = 8;
/// Squares along the edge of those of which the largest depth is known.
const COARSE: usize = 4;

/// Depths of an image by squares.
pub(super) struct Depths<'a> {
    image: &'a DepthImage,
    camera: CameraIntrinsics,
    near: f32,
    far: f32,
    columns: usize,
    /// Least and largest valid depth of each square up to `far`, row-major; infinite and 0 without any.
    least: Vec<f32>,
    largest: Vec<f32>,
    coarse_columns: usize,
    /// Largest depth of each `COARSE x COARSE` squares, whatever `far` is.
    coarse: Vec<f32>,
}

impl<'a> Depths<'a> {
    /// Depths from `near` to `far`, metres, are valid.
    pub(super) fn new(image: &'a DepthImage, camera: &CameraIntrinsics, near: f32, far: f32) -> Self {
        let columns = image.width().div_ceil(SQUARE);
        let coarse_columns = columns.div_ceil(COARSE);
        let rows = image.height().div_ceil(SQUARE);
        let mut out = Self {
            image,
            camera: *camera,
            near,
            far,
            columns,
            least: Vec::with_capacity(columns * rows),
            largest: Vec::with_capacity(columns * rows),
            coarse_columns,
            coarse: vec![0.0; coarse_columns * rows.div_ceil(COARSE)],
        };
        let width = image.width();
        let (mut least, mut largest, mut deepest) = (vec![], vec![], vec![]);
        for (y, band) in image.data().chunks(SQUARE * width).enumerate() {
            least = filled(least, width, f32::INFINITY);
            (largest, deepest) = (filled(largest, width, 0.0), filled(deepest, width, 0.0));
            for row in band.chunks_exact(width) {
                extremes(row, near, far, &mut least, &mut largest, &mut deepest);
            }
            out.least.extend(least.chunks(SQUARE).map(|c| c.iter().copied().fold(f32::INFINITY, f32::min)));
            out.largest.extend(largest.chunks(SQUARE).map(|c| c.iter().copied().fold(0.0, f32::max)));
            for (x, square) in deepest.chunks(SQUARE * COARSE).enumerate() {
                let coarse = &mut out.coarse[y / COARSE * coarse_columns + x];
                *coarse = square.iter().copied().fold(*coarse, f32::max);
            }
        }
        out
    }

    /// Blocks of the submap that lie within the truncation distance of a return, along its ray; in order.
    pub(super) fn touched(&self, t_submap_camera: &Pose, voxel_m: f64, truncation_m: f64) -> Vec<BlockKey> {
        let edge_m = f64::from(BLOCK) * voxel_m;
        let rotation = t_submap_camera.rotation.to_rotation_matrix();
        let turn = rotation.matrix() / edge_m;
        let origin = t_submap_camera.translation.vector / edge_m;
        let camera = &self.camera;
        let mut found = FxHashSet::default();
        let mut last = BlockKey::default();
        let mut mark = |u: f64, v: f64, least: f64, largest: f64| {
            let ray = Vector3::new((u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, 1.0);
            let ray = turn * ray;
            let ends = [(least - truncation_m).max(0.0), largest + truncation_m].map(|depth| origin + ray * depth);
            walk(&ends[0].into(), &ends[1].into(), |key| {
                if key != last {
                    found.insert(key);
                    last = key;
                }
            });
        };
        // Pixels of a square that see within a quarter of a block in depth of each other see the same, as long as they are next to
        // each other beside a block.
        let even = 0.25 * edge_m as f32;
        let wide = (0.5 * edge_m * camera.fx.min(camera.fy) / SQUARE as f64) as f32;
        for (i, (least, largest)) in self.least.iter().zip(&self.largest).enumerate() {
            if *largest <= 0.0 {
                continue;
            }
            let (x, y) = (i % self.columns * SQUARE, i / self.columns * SQUARE);
            if largest - least <= 2.0 * even && *largest <= wide {
                let middle = 0.5 * (SQUARE - 1) as f64;
                mark(x as f64 + middle, y as f64 + middle, f64::from(*least), f64::from(*largest));
                continue;
            }
            // Depths that were marked, by steps from the least; the last one stands for all that are deeper.
            let mut marked = 0u64;
            for v in y..(y + SQUARE).min(self.image.height()) {
                let row = &self.image.data()[v * self.image.width()..][..self.image.width()];
                for (u, depth) in row.iter().enumerate().skip(x).take(SQUARE) {
                    if *depth < self.near || *depth > self.far {
                        continue;
                    }
                    let step = (((depth - least) / even) as u32).min(63);
                    if step == 63 || *largest > wide || marked >> step & 1 == 0 {
                        marked |= 1 << step;
                        mark(u as f64, v as f64, f64::from(*depth), f64::from(*depth));
                    }
                }
            }
        }
        let mut keys: Vec<BlockKey> = found.into_iter().collect();
        keys.sort_unstable();
        keys
    }

    /// No return that a sphere covers, camera's frame, lies deeper than this, metres; 0 if the sphere is not in view.
    pub(super) fn largest_around(&self, center: &Point3<f64>, radius_m: f64) -> f32 {
        if center.z <= radius_m + 1e-3 {
            // The camera is in it, or nearly.
            return if center.coords.norm() <= radius_m + 0.1 { f32::INFINITY } else { 0.0 };
        }
        let span = |p: f64, f: f64, c: f64, size: usize| {
            // Generous: a sphere off the axis is seen as an ellipse.
            let (at, reach) = (f * p / center.z + c, 1.5 * f * radius_m / (center.z - radius_m) + 1.0);
            let square = (SQUARE * COARSE) as f64;
            let (first, last) = ((at - reach) / square, (at + reach) / square);
            let within = last >= 0.0 && (at - reach) < size as f64;
            within.then(|| (first.max(0.0) as usize, (last as usize).min((size - 1) / (SQUARE * COARSE))))
        };
        let columns = span(center.x, self.camera.fx, self.camera.cx, self.image.width());
        let rows = span(center.y, self.camera.fy, self.camera.cy, self.image.height());
        let (Some((x0, x1)), Some((y0, y1))) = (columns, rows) else { return 0.0 };
        let row = |y: usize| &self.coarse[y * self.coarse_columns..][x0..=x1];
        (y0..=y1).flat_map(row).copied().fold(0.0, f32::max)
    }
}

fn filled(mut scratch: Vec<f32>, len: usize, value: f32) -> Vec<f32> {
    scratch.clear();
    scratch.resize(len, value);
    scratch
}

by_processor! {
    [avx512]
    /// Lowers and raises least and largest valid depth of each column, and the largest of all.
    fn extremes(row: &[f32], near: f32, far: f32, least: &mut [f32], largest: &mut [f32], deepest: &mut [f32]) {
        for (((d, least), largest), deepest) in row.iter().zip(least).zip(largest).zip(deepest) {
            let is_valid = (*d >= near) & (*d <= far);
            let (low, high) = (if is_valid { *d } else { f32::INFINITY }, if is_valid { *d } else { 0.0 });
            *least = if low < *least { low } else { *least };
            *largest = if high > *largest { high } else { *largest };
            *deepest = if *d > *deepest { *d } else { *deepest };
        }
    }
}

/// Shows each cell of edge 1 that a line passes, from `a` to `b`, once. Cells beyond the range of block indices are left out.
/// Source: Amanatides and Woo, "A fast voxel traversal algorithm for ray tracing", 1987.
pub(super) fn walk(a: &Point3<f64>, b: &Point3<f64>, mut visit: impl FnMut(BlockKey)) {
    if !a.iter().chain(b.iter()).all(|v| v.abs() < MOST_BLOCKS) {
        return;
    }
    let along = b - a;
    let mut at = [a.x, a.y, a.z].map(floor);
    let to = [b.x, b.y, b.z].map(floor);
    let mut num = (0..3).map(|i| at[i].abs_diff(to[i])).sum::<u32>();
    let steps: [i32; 3] = std::array::from_fn(|i| if along[i] < 0.0 { -1 } else { 1 });
    let each: [f64; 3] = std::array::from_fn(|i| (1.0 / along[i]).abs());
    let mut next: [f64; 3] = std::array::from_fn(|i| {
        let border = f64::from(at[i]) + if along[i] < 0.0 { 0.0 } else { 1.0 };
        ((border - a[i]) / along[i]).abs()
    });
    visit((at[0], at[1], at[2]));
    while num > 0 {
        // Never past the last cell, whatever rounding makes of the order.
        let left = |i: usize| if at[i] == to[i] { f64::INFINITY } else { next[i] };
        let (x, y, z) = (left(0), left(1), left(2));
        let axis = if x <= y && x <= z {
            0
        } else if y <= z {
            1
        } else {
            2
        };
        at[axis] += steps[axis];
        next[axis] += each[axis];
        visit((at[0], at[1], at[2]));
        num -= 1;
    }
}

/// The whole number below, of what an `i32` holds: a few instructions on any processor.
#[inline]
pub(super) fn floor(v: f64) -> i32 {
    let whole = v as i32;
    whole - i32::from(f64::from(whole) > v)
}

/// Blocks are numbered up to this, so that their voxels have numbers that an `i32` holds.
pub(super) const MOST_BLOCKS: f64 = (1u64 << 27) as f64;

#[cfg(test)]
mod tests {
    use super::*;
    use percept_geometry::se3;
    use std::collections::BTreeSet;

    #[test]
    fn a_walk_shows_the_cells_that_a_line_passes_in_order() {
        let mut state = 3u32;
        let mut spread = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            6.0 * f64::from(state >> 8) / f64::from(1u32 << 24) - 3.0
        };
        for _ in 0..500 {
            let (a, b) = (Point3::new(spread(), spread(), spread()), Point3::new(spread(), spread(), spread()));
            let mut shown = vec![];
            walk(&a, &b, |key| shown.push(key));
            let cell = |p: Point3<f64>| (floor(p.x), floor(p.y), floor(p.z));
            assert_eq!((shown.first(), shown.last()), (Some(&cell(a)), Some(&cell(b))));
            let apart = |a: &BlockKey, b: &BlockKey| a.0.abs_diff(b.0) + a.1.abs_diff(b.1) + a.2.abs_diff(b.2);
            assert!(shown.windows(2).all(|w| apart(&w[0], &w[1]) == 1));
            for i in 0..=1000 {
                assert!(shown.contains(&cell(a + (b - a) * (f64::from(i) / 1000.0))));
            }
        }
        walk(&Point3::origin(), &Point3::new(1e12, 0.0, 0.0), |_| panic!("beyond what has a number"));
        walk(&Point3::origin(), &Point3::new(f64::NAN, 0.0, 0.0), |_| panic!("nowhere"));
    }

    #[test]
    fn squares_of_pixels_touch_what_pixels_touch_one_by_one() {
        let camera = CameraIntrinsics::pinhole(162, 121, 140.0, 140.0, 80.0, 60.0);
        // A slanted wall, a post before it, and a hole.
        let depth = |u: usize, v: usize| {
            let wall = 1.5 + 0.008 * u as f32;
            let post = if (60..75).contains(&u) { 0.9 } else { wall };
            if (100..120).contains(&u) && v > 90 { 0.0 } else { post }
        };
        let data = (0..camera.height).flat_map(|v| (0..camera.width).map(move |u| depth(u, v))).collect();
        let image = DepthImage::new(camera.width, camera.height, data).unwrap();
        let t = Pose::from_parts(
            nalgebra::Translation3::new(0.3, -4.2, 1.0),
            nalgebra::UnitQuaternion::from_euler_angles(0.4, -1.1, 2.0),
        ) * se3::from_xy_yaw(0.0, 0.0, 0.3);
        let (voxel, truncation) = (0.04, 0.16);
        let ours: BTreeSet<BlockKey> =
            Depths::new(&image, &camera, 0.1, 4.0).touched(&t, voxel, truncation).into_iter().collect();
        let mut plain = BTreeSet::new();
        for (u, v) in (0..camera.height).flat_map(|v| (0..camera.width).map(move |u| (u, v))) {
            let depth = f64::from(image.at(u, v));
            if depth > 0.0 {
                let end = |d: f64| {
                    Point3::from((t * Point3::from(camera.ray(u as f64, v as f64).coords * d)).coords / (8.0 * voxel))
                };
                walk(&end(depth - truncation), &end(depth + truncation), |key| {
                    plain.insert(key);
                });
            }
        }
        let (missed, more) = (plain.difference(&ours).count(), ours.difference(&plain).count());
        assert!(
            plain.len() > 100 && missed * 33 < plain.len() && more * 20 < plain.len(),
            "{missed}, {more} of {}",
            plain.len()
        );
    }
}
