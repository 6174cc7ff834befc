//! Voxels in blocks.

use nalgebra::Point3;
use percept_geometry::Voxel;

/// Edge of a block, voxels.
pub(super) const BLOCK: i32 = 8;

/// Which block, by its indices along x, y, z.
pub(super) type BlockKey = (i32, i32, i32);

/// The mean point of a voxel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VoxelMean {
    /// Place in the block: `(z * BLOCK + y) * BLOCK + x`.
    pub(super) slot: u16,
    /// Whether `color` means anything.
    pub(super) colored: bool,
    /// Keyframes that saw it, less those that saw through it.
    pub(super) weight: f32,
    /// Mean position from the voxel's smallest corner, metres: small, so that f32 is exact far from the origin.
    pub(super) offset: [f32; 3],
    /// Mean colour, 0..=255.
    pub(super) color: [f32; 3],
}

/// Block of a voxel, and its place there.
#[inline]
pub(super) fn locate(v: Voxel) -> (BlockKey, u16) {
    let slot = (v.z.rem_euclid(BLOCK) * BLOCK + v.y.rem_euclid(BLOCK)) * BLOCK + v.x.rem_euclid(BLOCK);
    ((v.x.div_euclid(BLOCK), v.y.div_euclid(BLOCK), v.z.div_euclid(BLOCK)), slot as u16)
}

/// Smallest corner of a voxel, metres.
pub(super) fn corner(block: BlockKey, slot: u16, size: f64) -> Point3<f64> {
    let slot = i32::from(slot);
    let axis = |block: i32, index: i32| (f64::from(block) * f64::from(BLOCK) + f64::from(index)) * size;
    Point3::new(axis(block.0, slot % BLOCK), axis(block.1, slot / BLOCK % BLOCK), axis(block.2, slot / (BLOCK * BLOCK)))
}
