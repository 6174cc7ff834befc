//! Voxels in blocks: how three-dimensional layers keep them.

use nalgebra::{Point3, Vector3};
use percept_geometry::{Aabb3, Voxel};

/// Edge of a block, voxels.
pub(crate) const BLOCK: i32 = 8;

/// Which block, by its indices along x, y, z.
pub(crate) type BlockKey = (i32, i32, i32);

/// Block of a voxel, and its place there.
#[inline]
pub(crate) fn locate(v: Voxel) -> (BlockKey, u16) {
    let slot = (v.z.rem_euclid(BLOCK) * BLOCK + v.y.rem_euclid(BLOCK)) * BLOCK + v.x.rem_euclid(BLOCK);
    ((v.x.div_euclid(BLOCK), v.y.div_euclid(BLOCK), v.z.div_euclid(BLOCK)), slot as u16)
}

/// Smallest corner of a voxel, metres.
pub(crate) fn corner(block: BlockKey, slot: u16, size: f64) -> Point3<f64> {
    let slot = i32::from(slot);
    let axis = |block: i32, index: i32| (f64::from(block) * f64::from(BLOCK) + f64::from(index)) * size;
    Point3::new(axis(block.0, slot % BLOCK), axis(block.1, slot / BLOCK % BLOCK), axis(block.2, slot / (BLOCK * BLOCK)))
}

/// The box of a block, a little inside so that it does not reach into the one beside, metres.
pub(crate) fn block_box(block: BlockKey, size: f64) -> Aabb3 {
    let edge = f64::from(BLOCK) * size;
    let low = corner(block, 0, size);
    Aabb3 { min: low + Vector3::repeat(1e-6 * edge), max: low + Vector3::repeat((1.0 - 1e-6) * edge) }
}
