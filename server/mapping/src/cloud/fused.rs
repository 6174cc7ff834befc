//! The fused cloud of a submap, in blocks that copies share.

use super::block::{BLOCK, BlockKey, VoxelMean, corner};
use super::free::FreeSpace;
use super::range_image::RangeImage;
use super::{CloudParams, CloudUpdate};
use crate::KeyframeView;
use crate::MappingError;
use crate::error::check_keyframe;
use nalgebra::Point3;
use percept_geometry::{Aabb3, KeyframeScan, PointCloud, Pose};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Voxels of a block, ascending by slot; never empty in the map.
pub(super) type Block = Vec<VoxelMean>;

/// Colour given to voxels without one in a cloud that has colours.
pub(super) const NO_COLOR: [u8; 3] = [128; 3];

/// One mean point and colour a voxel, in one frame, unbounded: what a submap holds of the cloud.
/// [`CloudMap`](super::CloudMap) lays those of all submaps over each other.
///
/// A voxel's weight is the number of keyframes that saw it (at most `max_weight`), less `carve_weight` for each
/// that saw through it; at zero it vanishes, so that who walked by leaves no lasting smear. Where there was nothing to see
/// through counts as well: earlier submaps may hold something there. Cloning costs two references; a clone never sees later changes. Order of points: by block, then by voxel, always the same.
#[derive(Debug, Clone)]
pub struct FusedCloud {
    params: CloudParams,
    pub(super) blocks: Arc<BTreeMap<BlockKey, Arc<Block>>>,
    pub(super) free: FreeSpace,
    extent: Aabb3,
    num_points: usize,
}

impl FusedCloud {
    /// An empty cloud.
    ///
    /// # Errors
    /// `InvalidParam`.
    pub fn new(params: CloudParams) -> Result<Self, MappingError> {
        params.validate()?;
        Ok(Self::empty(params))
    }

    pub(super) fn empty(params: CloudParams) -> Self {
        Self { params, blocks: Arc::default(), free: FreeSpace::default(), extent: Aabb3::empty(), num_points: 0 }
    }

    pub(super) fn of_blocks(params: CloudParams, blocks: BTreeMap<BlockKey, Arc<Block>>, free: FreeSpace) -> Self {
        let num_points = blocks.values().map(|b| b.len()).sum();
        let mut extent = Aabb3::empty();
        blocks.keys().for_each(|key| grow(&mut extent, *key, params.voxel_size_m));
        Self { params, blocks: Arc::new(blocks), free, extent, num_points }
    }

    /// Parameters.
    pub fn params(&self) -> &CloudParams {
        &self.params
    }

    /// Adds what a keyframe saw from `t_map_base`.
    ///
    /// # Errors
    /// `PoseNotFinite`; `Scan` if the colours are not one a point or the height is not finite.
    pub fn integrate(&mut self, t_map_base: &Pose, scan: &KeyframeScan) -> Result<(), MappingError> {
        check_keyframe(t_map_base, scan)?;
        self.apply(&CloudUpdate::new(&self.params, &KeyframeView::new(t_map_base, scan)));
        Ok(())
    }

    /// Adds an update made with this cloud's parameters: carves first, then folds in.
    pub fn apply(&mut self, update: &CloudUpdate) {
        self.carve_seen(&update.ranges);
        self.free.add(&update.free);
        let blocks = Arc::make_mut(&mut self.blocks);
        for (key, seen) in &update.blocks {
            let known: &[VoxelMean] = blocks.get(key).map_or(&[], |b| b);
            let merged = merge(known, seen, self.params.max_weight);
            grow(&mut self.extent, *key, self.params.voxel_size_m);
            self.num_points += merged.len() - known.len();
            blocks.insert(*key, Arc::new(merged));
        }
    }

    fn carve_seen(&mut self, ranges: &RangeImage) {
        let reach = ranges.max_range().min(self.params.range_max());
        let edge = f64::from(BLOCK) * self.params.voxel_size_m;
        let near = |key: &BlockKey| {
            let center = corner(*key, 0, self.params.voxel_size_m) + nalgebra::Vector3::repeat(0.5 * edge);
            // Means rounded to f32 may stick out of their voxel a little.
            (center - ranges.sensor()).norm() <= reach + edge
                && ranges.may_see_through(&center, 0.87 * edge, &self.params)
        };
        let touched: Vec<(BlockKey, Arc<Block>)> =
            self.blocks.iter().filter(|(key, _)| near(key)).map(|(key, block)| (*key, block.clone())).collect();
        let changed: Vec<(BlockKey, usize, Block)> = touched
            .par_iter()
            .filter_map(|(key, block)| Some((*key, block.len(), self.carved(*key, block, ranges)?)))
            .collect();
        if changed.is_empty() {
            return;
        }
        let blocks = Arc::make_mut(&mut self.blocks);
        for (key, before, block) in changed {
            self.num_points -= before - block.len();
            if block.is_empty() {
                blocks.remove(&key);
            } else {
                blocks.insert(key, Arc::new(block));
            }
        }
    }

    /// The block without what `ranges` saw through; none if nothing changes.
    fn carved(&self, key: BlockKey, block: &Block, ranges: &RangeImage) -> Option<Block> {
        let sees = |some: &[VoxelMean]| ranges.sees_through(some.iter().map(|v| self.position(key, v)), &self.params);
        let mut through = [0u64; (BLOCK * BLOCK * BLOCK) as usize / 64];
        through.iter_mut().zip(block.chunks(64)).for_each(|(through, some)| *through = sees(some));
        let is_through = |i: &usize| through[i / 64] >> (i % 64) & 1 == 1;
        let first = (0..block.len()).find(is_through)?;
        let mut out = block[..first].to_vec();
        for (i, v) in block.iter().enumerate().skip(first) {
            let loss = if is_through(&i) { self.params.carve_weight } else { 0.0 };
            if v.weight > loss {
                out.push(VoxelMean { weight: v.weight - loss, ..*v });
            }
        }
        Some(out)
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.num_points
    }

    /// What its voxels take, bytes.
    pub fn memory_bytes(&self) -> usize {
        self.num_points * size_of::<VoxelMean>() + self.free.memory_bytes()
    }

    /// A box around all blocks that ever were.
    pub(super) fn extent(&self) -> &Aabb3 {
        &self.extent
    }

    /// Whether there is no point.
    pub fn is_empty(&self) -> bool {
        self.num_points == 0
    }

    /// The box around all points; empty if there is none. Visits every point.
    pub fn bounds(&self) -> Aabb3 {
        let mut out = Aabb3::empty();
        for (key, v) in self.voxels(|_| true) {
            out.grow(&self.position(key, v));
        }
        out
    }

    /// All points, with colours if any has one (grey where it has none). Copies.
    pub fn to_cloud(&self) -> PointCloud {
        self.collect(self.voxels(|_| true))
    }

    /// The points within `radius_m` of `center`, as [`FusedCloud::to_cloud`] gives them.
    pub fn points_within(&self, center: &Point3<f64>, radius_m: f64) -> PointCloud {
        let edge = f64::from(BLOCK) * self.params.voxel_size_m;
        let near = |key: &BlockKey| {
            let low = corner(*key, 0, self.params.voxel_size_m);
            let nearest = low.sup(&center.inf(&(low + nalgebra::Vector3::repeat(edge))));
            // A mean rounded to f32 may stick out of its voxel a little.
            (nearest - center).norm() <= radius_m + 1e-3 * edge
        };
        let inside = |(key, v): &(BlockKey, &VoxelMean)| (self.position(*key, v) - center).norm() <= radius_m;
        self.collect(self.voxels(near).filter(inside))
    }

    fn voxels(&self, wanted: impl Fn(&BlockKey) -> bool) -> impl Iterator<Item = (BlockKey, &VoxelMean)> {
        let blocks = self.blocks.iter().filter(move |(key, _)| wanted(key));
        blocks.flat_map(|(key, block)| block.iter().map(|v| (*key, v)))
    }

    fn collect<'a>(&self, voxels: impl Iterator<Item = (BlockKey, &'a VoxelMean)>) -> PointCloud {
        let (mut positions, mut colors, mut any) = (Vec::new(), Vec::new(), false);
        for (key, v) in voxels {
            positions.push(self.position(key, v).cast::<f32>());
            colors.push(if v.colored { v.color.map(|c| c.round() as u8) } else { NO_COLOR });
            any |= v.colored;
        }
        PointCloud { colors: any.then_some(colors), ..PointCloud::from_positions(positions) }
    }

    fn position(&self, key: BlockKey, v: &VoxelMean) -> Point3<f64> {
        corner(key, v.slot, self.params.voxel_size_m) + nalgebra::Vector3::from(v.offset).cast::<f64>()
    }
}

/// Equal in every voxel.
impl PartialEq for FusedCloud {
    fn eq(&self, other: &Self) -> bool {
        self.params == other.params && self.blocks == other.blocks && self.free == other.free
    }
}

fn grow(extent: &mut Aabb3, key: BlockKey, voxel_size_m: f64) {
    let low = corner(key, 0, voxel_size_m);
    extent.grow(&low);
    extent.grow(&(low + nalgebra::Vector3::repeat(f64::from(BLOCK) * voxel_size_m)));
}

/// Two blocks ascending by slot become one; where both have a voxel, its mean is weighted by keyframes.
pub(super) fn merge(known: &[VoxelMean], seen: &[VoxelMean], max_weight: f32) -> Block {
    let mut out = Vec::with_capacity(known.len() + seen.len());
    let (mut a, mut b) = (known.iter().peekable(), seen.iter().peekable());
    while let (Some(x), Some(y)) = (a.peek(), b.peek()) {
        match x.slot.cmp(&y.slot) {
            std::cmp::Ordering::Less => out.extend(a.next()),
            std::cmp::Ordering::Greater => out.extend(b.next()),
            std::cmp::Ordering::Equal => {
                out.push(fold(x, y, max_weight));
                a.next();
                b.next();
            }
        }
    }
    out.extend(a);
    out.extend(b);
    out
}

pub(super) fn fold(known: &VoxelMean, seen: &VoxelMean, max_weight: f32) -> VoxelMean {
    let share = seen.weight / (known.weight + seen.weight);
    let mix = |a: [f32; 3], b: [f32; 3]| std::array::from_fn(|i| a[i] + (b[i] - a[i]) * share);
    let color = match (known.colored, seen.colored) {
        (true, true) => mix(known.color, seen.color),
        (true, false) => known.color,
        _ => seen.color,
    };
    VoxelMean {
        slot: known.slot,
        colored: known.colored || seen.colored,
        weight: (known.weight + seen.weight).min(max_weight),
        offset: mix(known.offset, seen.offset),
        color,
    }
}
