//! What the cloud keeps of a voxel.

pub(super) use crate::blocks::{BLOCK, BlockKey, corner, locate};

/// The mean point of a voxel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VoxelMean {
    /// Place in the block: `(z * BLOCK + y) * BLOCK + x`.
    pub(crate) slot: u16,
    /// Whether `color` means anything.
    pub(crate) colored: bool,
    /// Keyframes that saw it, less those that saw through it.
    pub(crate) weight: f32,
    /// Mean position from the voxel's smallest corner, metres: small, so that f32 is exact far from the origin.
    pub(crate) offset: [f32; 3],
    /// Mean colour, 0..=255.
    pub(crate) color: [f32; 3],
}
