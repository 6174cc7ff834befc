//! One keyframe as means by voxel, and as what it saw through.

use super::CloudParams;
use super::block::{BlockKey, VoxelMean, corner, locate};
use super::free::seen_through;
use super::range_image::RangeImage;
use crate::KeyframeView;
use crate::seen::Seen;
use crate::sorted::sort_by_key;
use nalgebra::{Point3, Vector3};
use percept_geometry::{KeyframeScan, Voxel};
use std::sync::Arc;

/// What one keyframe says about the cloud. Depends on the pose and the scan alone, so that many keyframes can be
/// worked on at once.
#[derive(Debug, Clone)]
pub struct CloudUpdate {
    /// Ascending by block; in a block ascending by slot.
    pub(super) blocks: Vec<(BlockKey, Vec<VoxelMean>)>,
    pub(super) ranges: Arc<RangeImage>,
    /// Voxels that were seen through, ascending by block.
    pub(super) free: Vec<(BlockKey, Seen)>,
}

impl CloudUpdate {
    /// The returns of a keyframe, by voxel. Returns out of range, not finite, or beyond the range
    /// of the indices are left out; the far ones still show that what lies before them is gone.
    pub fn new(params: &CloudParams, view: &KeyframeView<'_>) -> Self {
        let (sensor, in_map, scan) = (view.sensor(), view.hits(), view.scan);
        let mut voxels: Vec<(BlockKey, u16, u32)> = Vec::with_capacity(in_map.len());
        let (mut low, mut high) = ([i32::MAX; 3], [i32::MIN; 3]);
        for (i, p) in in_map.iter().enumerate() {
            let range = (p - sensor).norm();
            if !(range >= params.range_min_m && range <= params.range_max()) {
                continue;
            }
            if let Some(voxel) = Voxel::containing(p, params.voxel_size_m) {
                let (block, slot) = locate(voxel);
                for (axis, at) in [block.0, block.1, block.2].into_iter().enumerate() {
                    (low[axis], high[axis]) = (low[axis].min(at), high[axis].max(at));
                }
                voxels.push((block, slot, i as u32));
            }
        }
        // Numbers in the order of blocks and slots. Blocks within the largest range are less than 2^15 apart.
        let size: [u64; 3] = std::array::from_fn(|i| u64::from(high[i].abs_diff(low[i])) + 1);
        let from_low = |at: i32, axis: usize| u64::from(at.abs_diff(low[axis]));
        let number = |(x, y, z): BlockKey, slot: u16| {
            ((from_low(x, 0) * size[1] + from_low(y, 1)) * size[2] + from_low(z, 2)) << 9 | u64::from(slot)
        };
        let numbered = voxels.iter().enumerate().map(|(at, (block, slot, _))| (number(*block, *slot), at as u32));
        let mut order: Vec<(u64, u32)> = numbered.collect();
        sort_by_key(&mut order);
        let mut blocks: Vec<(BlockKey, Vec<VoxelMean>)> = Vec::new();
        for group in order.chunk_by(|a, b| a.0 == b.0) {
            let (block, slot, _) = voxels[group[0].1 as usize];
            let points = group.iter().map(|(_, at)| voxels[*at as usize].2 as usize);
            let mean = mean_of(params, scan, in_map, block, slot, points);
            match blocks.last_mut() {
                Some((last, voxels)) if *last == block => voxels.push(mean),
                _ => blocks.push((block, vec![mean])),
            }
        }
        let nothing = || Arc::new(RangeImage::new(sensor, std::iter::empty()));
        let ranges = if params.carve_weight > 0.0 { Arc::clone(view.ranges()) } else { nothing() };
        let free = seen_through(&ranges, params, scan.planar);
        Self { blocks, ranges, free }
    }
}

fn mean_of(
    params: &CloudParams,
    scan: &KeyframeScan,
    in_map: &[Point3<f64>],
    block: BlockKey,
    slot: u16,
    indices: impl ExactSizeIterator<Item = usize>,
) -> VoxelMean {
    let corner = corner(block, slot, params.voxel_size_m);
    let n = indices.len() as f64;
    let (mut offset, mut color) = (Vector3::<f64>::zeros(), Vector3::<f64>::zeros());
    for i in indices {
        offset += in_map[i] - corner;
        if let Some(colors) = &scan.hits.colors {
            color += Vector3::from(colors[i]).cast::<f64>();
        }
    }
    VoxelMean {
        slot,
        colored: scan.hits.colors.is_some(),
        weight: 1.0,
        offset: (offset / n).cast::<f32>().into(),
        color: (color / n).cast::<f32>().into(),
    }
}
