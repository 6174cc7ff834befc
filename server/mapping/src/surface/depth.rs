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
use percept_geometry::{CameraIntrinsics, DepthImage, Distortion, GeometryError, Pose, RgbImage};
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
        let view = View {
            depth: depth.data(),
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
