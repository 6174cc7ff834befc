//! Voxels of one frame as voxels of another.

use super::block::{BLOCK, BlockKey, VoxelMean};
use nalgebra::{Matrix3, Point3, Vector3};
use percept_geometry::{Pose, Voxel};

/// A motion from voxels to voxels: all lengths are edges of one.
pub(super) struct Shift {
    turn: Matrix3<f64>,
    by: Vector3<f64>,
    per_metre: f64,
}

/// The motion of one block's voxels.
pub(super) struct BlockShift<'a> {
    shift: &'a Shift,
    /// Where the block's smallest corner comes to lie.
    corner: Vector3<f64>,
}

impl Shift {
    pub(super) fn new(motion: &Pose, voxel_size_m: f64) -> Self {
        let per_metre = 1.0 / voxel_size_m;
        let turn = *motion.rotation.to_rotation_matrix().matrix();
        Self { turn, by: motion.translation.vector * per_metre, per_metre }
    }

    #[inline]
    pub(super) fn block(&self, key: BlockKey) -> BlockShift<'_> {
        let corner = Vector3::new(f64::from(key.0), f64::from(key.1), f64::from(key.2)) * f64::from(BLOCK);
        BlockShift { shift: self, corner: self.turn * corner + self.by }
    }
}

impl BlockShift<'_> {
    /// Where the block's middle comes to lie.
    #[inline]
    pub(super) fn middle(&self) -> Vector3<f64> {
        self.corner + self.shift.turn * Vector3::repeat(0.5 * f64::from(BLOCK))
    }

    /// Where a voxel's mean comes to lie.
    #[inline]
    pub(super) fn position(&self, v: &VoxelMean) -> Point3<f64> {
        let slot = v.slot;
        let index = [slot % BLOCK as u16, slot / BLOCK as u16 % BLOCK as u16, slot / (BLOCK * BLOCK) as u16];
        let within: [f64; 3] =
            std::array::from_fn(|i| f64::from(index[i]) + f64::from(v.offset[i]) * self.shift.per_metre);
        (self.corner + self.shift.turn * Vector3::from(within)).into()
    }
}

/// The voxel of a position in edges of one; far beyond what there is, the last one.
#[inline]
pub(super) fn voxel_at(p: &Point3<f64>) -> Voxel {
    let floor = |v: f64| {
        let cut = v as i32;
        cut.saturating_sub(i32::from(f64::from(cut) > v))
    };
    Voxel { x: floor(p.x), y: floor(p.y), z: floor(p.z) }
}
