//! One keyframe as means by voxel, and as what it saw through.

use super::CloudParams;
use super::block::{BlockKey, VoxelMean, corner, locate};
use super::free::seen_through;
use super::range_image::RangeImage;
use crate::KeyframeView;
use crate::seen::Seen;
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
        let mut keys: Vec<(BlockKey, u16, u32)> = Vec::with_capacity(in_map.len());
        for (i, p) in in_map.iter().enumerate() {
            let range = (p - sensor).norm();
            if !(range >= params.range_min_m && range <= params.range_max()) {
                continue;
            }
            if let Some(voxel) = Voxel::containing(p, params.voxel_size_m) {
                let (block, slot) = locate(voxel);
                keys.push((block, slot, i as u32));
            }
        }
        keys.sort_unstable();
        let mut blocks: Vec<(BlockKey, Vec<VoxelMean>)> = Vec::new();
        for group in keys.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)) {
            let (block, slot, _) = group[0];
            let mean = mean_of(params, scan, in_map, block, slot, group.iter().map(|k| k.2 as usize));
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
