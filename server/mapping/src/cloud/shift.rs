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

#[cfg(test)]
mod tests {
    use super::super::block::{corner, locate};
    use super::*;
    use percept_geometry::se3;
    use proptest::prelude::*;

    proptest! {
        /// As voxels are moved one by one, by metres.
        #[test]
        fn voxels_come_to_lie_where_the_motion_takes_their_means(
            twist in prop::array::uniform6(-3.0..3.0f64),
            key in (-500..500i32, -500..500i32, -50..50i32),
            slot in 0..512u16,
            share in prop::array::uniform3(0.0..1.0f32),
            size in 0.01..0.5f64,
        ) {
            let motion = se3::exp(&twist.into());
            let offset = share.map(|s| s * size as f32);
            let v = VoxelMean { slot, colored: false, weight: 1.0, offset, color: [0.0; 3] };
            let plain = motion * (corner(key, slot, size) + Vector3::from(offset).cast::<f64>());
            let shift = Shift::new(&motion, size);
            let moved = shift.block(key).position(&v);
            prop_assert!((moved.coords * size - plain.coords).norm() < 1e-9);
            let border = moved.coords.map(|c| (c - c.round()).abs()).min();
            if border > 1e-6 {
                prop_assert_eq!(Some(locate(voxel_at(&moved))), Voxel::containing(&plain, size).map(locate));
            }
        }
    }
}
