//! Depth images into the grid: the fast way, for whoever has whole images.

use super::SurfaceGrid;
use super::block::{SurfaceBlock, UNIT, loss};
use super::kernel::{Placed, View, integrate_block};
use super::params::CARVE_MARGIN_RATIO;
use super::touched::Depths;
use crate::MappingError;
use crate::blocks::{BLOCK, BlockKey, corner};
use crate::error::check_pose;
use nalgebra::{Point3, Vector3};
use percept_geometry::{CameraIntrinsics, DepthImage, Distortion, GeometryError, Pose, RgbImage, by_processor};
use rayon::prelude::*;
use std::sync::Arc;

/// Blocks that one image may touch: half a gigabyte with colours. An image of a room at 2 cm touches some 600.
const MAX_BLOCKS_OF_IMAGE: usize = 1 << 17;

impl SurfaceGrid {
    /// Adds a depth image (`H x W`, metres along the optical axis) taken by `camera` at `t_submap_camera`, and the colour image
    /// of the same camera, pixel by pixel, if there is one. Every voxel that is seen takes the distance to what its pixel sees,
    /// up to the truncation distance behind it, with a weight of 1 a look; blocks that hold a surface which the image sees
    /// through lose that, if `carve` is set. Work runs on the current rayon pool.
    ///
    /// What was seen free is kept in blocks that hold a surface, and not beyond: this part takes back its own surfaces that
    /// have gone, and leaves those of earlier submaps to keyframes.
    ///
    /// Source: Curless and Levoy 1996; Newcombe et al. 2011; blocks as in Niessner et al., "Real-time 3D reconstruction at scale
    /// using voxel hashing", 2013.
    ///
    /// # Errors
    /// `PoseNotFinite`; `Scan` if the camera is not sound, its lens not undone, or an image not of its size; `TooManyBlocks`. The
    /// grid is unchanged then.
    pub fn integrate_depth(
        &mut self,
        depth: &DepthImage,
        color: Option<&RgbImage>,
        camera: &CameraIntrinsics,
        t_submap_camera: &Pose,
    ) -> Result<(), MappingError> {
        check_pose(t_submap_camera)?;
        check_images(depth, color, camera)?;
        let params = *self.params();
        let (near, far) = (params.range_min_m.max(1e-3) as f32, params.range_max() as f32);
        let depths = Depths::new(depth, camera, near, far);
        let keys = depths.touched(t_submap_camera, params.voxel_size_m, params.truncation());
        if keys.len() > MAX_BLOCKS_OF_IMAGE {
            return Err(MappingError::TooManyBlocks { blocks: keys.len(), limit: MAX_BLOCKS_OF_IMAGE });
        }
        let margin = [params.carve_margin(0.0) as f32, CARVE_MARGIN_RATIO as f32];
        let shortest = if params.carve { shortest_around(depth) } else { vec![] };
        let view = View {
            depth: depth.data(),
            shortest: &shortest,
            color: color.map(RgbImage::data),
            width: depth.width() as f32,
            height: depth.height() as f32,
            focal: [camera.fx as f32, camera.fy as f32],
            center: [camera.cx as f32, camera.cy as f32],
            near,
            far,
            truncation: params.truncation() as f32,
            margin: if params.carve { margin } else { [f32::INFINITY, 0.0] },
            max_weight: params.max_weight * UNIT,
            loss: loss(params.max_weight),
        };
        let t_camera_submap = t_submap_camera.inverse();
        let voxel = params.voxel_size_m;
        let is_carved = |key: &BlockKey, block: &SurfaceBlock| {
            let radius = 0.5 * f64::from(BLOCK) * voxel * 3.0f64.sqrt();
            let center = t_camera_submap * (corner(*key, 0, voxel) + Vector3::repeat(4.0 * voxel));
            let deepest = f64::from(depths.largest_around(&center, radius));
            params.carve && deepest > center.z - radius + params.carve_margin(center.z) && block.has_inside()
        };
        let colored = self.update_blocks(&keys, is_carved, |key, block| {
            integrate_block(&view, &placed(&t_camera_submap, key, voxel), block);
        });
        self.num_colored += colored;
        Ok(())
    }

    /// Works on some blocks, in order and made if there are none of them, and on others that are wanted; how many of them have got
    /// colours.
    fn update_blocks(
        &mut self,
        keys: &[BlockKey],
        is_wanted: impl Fn(&BlockKey, &SurfaceBlock) -> bool,
        work: impl Fn(BlockKey, &mut SurfaceBlock) + Sync,
    ) -> usize {
        let blocks = Arc::make_mut(&mut self.blocks);
        for key in keys {
            blocks.entry(*key).or_insert_with(|| Arc::new(SurfaceBlock::unknown()));
        }
        let mut next = keys.iter().peekable();
        let wanted: Vec<(BlockKey, &mut Arc<SurfaceBlock>)> = blocks
            .iter_mut()
            .filter_map(|(key, block)| {
                let is_touched = next.next_if(|touched| *touched == key).is_some();
                (is_touched || is_wanted(key, block)).then_some((*key, block))
            })
            .collect();
        let gained = |(key, block): (BlockKey, &mut Arc<SurfaceBlock>)| {
            let block = Arc::make_mut(block);
            let had_color = block.color.is_some();
            work(key, block);
            usize::from(block.color.is_some() && !had_color)
        };
        wanted.into_par_iter().with_min_len(16).map(gained).sum()
    }
}

/// The least depth of each pixel and the eight around it: 0 beside one without a return.
fn shortest_around(depth: &DepthImage) -> Vec<f32> {
    let (width, height) = (depth.width(), depth.height());
    let mut out = Vec::with_capacity(width * height);
    let mut column = vec![0.0f32; width];
    for v in 0..height {
        let row = |v: usize| &depth.data()[v * width..][..width];
        least_of(row(v.saturating_sub(1)), row(v), row((v + 1).min(height - 1)), &mut column);
        let last = out.len();
        out.extend_from_slice(&column);
        let (left, right) = (&column[..width - 1], &column[1..]);
        let out: &mut [f32] = &mut out[last..];
        least_beside(&mut out[1..], left);
        least_beside(&mut out[..width - 1], right);
    }
    out
}

by_processor! {
    [avx512]
    /// The least of three rows, column by column.
    fn least_of(a: &[f32], b: &[f32], c: &[f32], out: &mut [f32]) {
        for (((a, b), c), out) in a.iter().zip(b).zip(c).zip(out) {
            let least = if *a < *b { *a } else { *b };
            *out = if *c < least { *c } else { least };
        }
    }
}

by_processor! {
    [avx512]
    /// Lowers to what stands beside.
    fn least_beside(out: &mut [f32], beside: &[f32]) {
        for (out, beside) in out.iter_mut().zip(beside) {
            *out = if *beside < *out { *beside } else { *out };
        }
    }
}

/// A block in the camera's frame.
fn placed(t_camera_submap: &Pose, key: BlockKey, voxel: f64) -> Placed {
    let first: Point3<f64> = t_camera_submap * (corner(key, 0, voxel) + Vector3::repeat(0.5 * voxel));
    let step = |axis: usize| (t_camera_submap.rotation * (Vector3::ith(axis, voxel))).cast::<f32>().into();
    Placed { first: first.cast::<f32>().into(), steps: [step(0), step(1), step(2)] }
}

fn check_images(depth: &DepthImage, color: Option<&RgbImage>, camera: &CameraIntrinsics) -> Result<(), GeometryError> {
    camera.validate()?;
    if camera.distortion != Distortion::None {
        let requirement = "none: undo the lens first";
        return Err(GeometryError::OutOfRange { field: "distortion", value: 1.0, requirement });
    }
    let same = |field, expected, actual| {
        if expected == actual { Ok(()) } else { Err(GeometryError::ShapeMismatch { field, expected, actual }) }
    };
    same("depth columns", camera.width, depth.width())?;
    same("depth rows", camera.height, depth.height())?;
    same("colour columns", camera.width, color.map_or(camera.width, RgbImage::width))?;
    same("colour rows", camera.height, color.map_or(camera.height, RgbImage::height))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shortest_around_a_pixel_is_the_least_of_nine() {
        for (width, height) in [(1usize, 1usize), (1, 5), (7, 1), (37, 11)] {
            let data: Vec<f32> = (0..width * height).map(|i| 1.0 + (i * 7919 % 101) as f32).collect();
            let depth = DepthImage::new(width, height, data).unwrap();
            let found = shortest_around(&depth);
            for (i, found) in found.iter().enumerate() {
                let (u, v) = (i % width, i / width);
                let rows = v.saturating_sub(1)..=(v + 1).min(height - 1);
                let around = rows.flat_map(|v| (u.saturating_sub(1)..=(u + 1).min(width - 1)).map(move |u| (u, v)));
                assert_eq!(*found, around.map(|(u, v)| depth.at(u, v)).fold(f32::INFINITY, f32::min));
            }
        }
    }
}
