//! Questions to the voxels of the map: what is at a point, in a box, along a ray.

use super::block::{QUANTUM, UNKNOWN};
use super::compose::{VoxelMap, VoxelTile, tile_of};
use crate::blocks::{BLOCK, locate};
use crate::error::MappingError;
use crate::layer::TileKey;
use nalgebra::{Point3, Unit, Vector3};
use percept_geometry::{Aabb3, Voxel};
use rustc_hash::FxHashMap;
use std::sync::Arc;

/// What is in a voxel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum VoxelState {
    /// No beam has been there.
    Unknown,
    /// Log-odds of being occupied are 0 or less.
    Free,
    /// They are more.
    Occupied,
}

impl VoxelState {
    fn of(log_odds: Option<f32>) -> Self {
        match log_odds {
            None => Self::Unknown,
            Some(v) if v > 0.0 => Self::Occupied,
            Some(_) => Self::Free,
        }
    }
}

/// Where a ray ended.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RayHit {
    /// What ended it: a voxel that is occupied or, if asked for, unknown. Free: nothing did within its range.
    pub state: VoxelState,
    /// That voxel; the last one if nothing ended the ray.
    pub voxel: Voxel,
    /// From the origin to where the ray enters that voxel, or its range, metres.
    pub distance_m: f64,
}

/// Reads voxels of the map, and keeps the tiles that it has read.
#[derive(Debug)]
pub struct VoxelReader<'a> {
    map: &'a VoxelMap,
    tiles: FxHashMap<TileKey, Option<Arc<VoxelTile>>>,
}

impl<'a> VoxelReader<'a> {
    /// Of the map at one moment.
    pub fn new(map: &'a VoxelMap) -> Self {
        Self { map, tiles: FxHashMap::default() }
    }

    /// Log-odds of a voxel; none where no beam has been.
    pub fn log_odds(&mut self, voxel: Voxel) -> Option<f32> {
        let (key, slot) = locate(voxel);
        let map = self.map;
        let tile = self.tiles.entry(tile_of(key)).or_insert_with(|| map.tile(tile_of(key)));
        let value = tile.as_ref()?.block(key)?[usize::from(slot)];
        (value != UNKNOWN).then_some(f32::from(value) * QUANTUM)
    }

    /// What is at a point of the map; unknown too if it has no number.
    pub fn state_at(&mut self, p: &Point3<f64>) -> VoxelState {
        let voxel = Voxel::containing(p, self.map.params().voxel_size_m);
        VoxelState::of(voxel.and_then(|v| self.log_odds(v)))
    }

    /// Follows a ray to the first voxel that is occupied, or unknown if `unknown_ends`, for at most `range_m` metres. The voxel that
    /// it starts in counts as well. None if the origin has no number, or the range is not finite and at most
    /// [`MAX_RAY_VOXELS`] voxels.
    pub fn cast(
        &mut self,
        origin: &Point3<f64>,
        direction: &Unit<Vector3<f64>>,
        range_m: f64,
        unknown_ends: bool,
    ) -> Option<RayHit> {
        let size = self.map.params().voxel_size_m;
        if !(range_m >= 0.0 && range_m <= MAX_RAY_VOXELS * size) {
            return None;
        }
        let mut voxel = Voxel::containing(origin, size)?;
        Voxel::containing(&(origin + direction.as_ref() * range_m), size)?;
        let low = voxel.center(size) - Vector3::repeat(0.5 * size);
        let step = direction.map(|d| if d < 0.0 { -1 } else { 1 });
        // How far along the ray the next border of each axis lies, and how far apart borders are.
        let mut next = Vector3::from_fn(|i, _| {
            let border = low[i] + if step[i] > 0 { size } else { 0.0 };
            if direction[i] == 0.0 { f64::INFINITY } else { (border - origin[i]) / direction[i] }
        });
        let apart = direction.map(|d| size / d.abs());
        let mut distance_m = 0.0;
        loop {
            let state = VoxelState::of(self.log_odds(voxel));
            if state == VoxelState::Occupied || (unknown_ends && state == VoxelState::Unknown) {
                return Some(RayHit { state, voxel, distance_m });
            }
            let axis = next.imin();
            if next[axis] > range_m {
                return Some(RayHit { state: VoxelState::Free, voxel, distance_m: range_m });
            }
            distance_m = next[axis].max(0.0);
            next[axis] += apart[axis];
            match axis {
                0 => voxel.x += step.x,
                1 => voxel.y += step.y,
                _ => voxel.z += step.z,
            }
        }
    }
}

/// Voxels along the longest ray that is followed: a kilometre at 0.05 m.
pub const MAX_RAY_VOXELS: f64 = 20_000.0;

impl VoxelMap {
    /// All voxels within a box of which something is known (those whose centre lies in it), in order of tiles, blocks, places, with
    /// their log-odds.
    ///
    /// # Errors
    /// `RegionTooLarge` beyond `max_voxels`.
    pub fn within(&self, region: &Aabb3, max_voxels: usize) -> Result<Vec<(Voxel, f32)>, MappingError> {
        let size = self.params().voxel_size_m;
        let tile = |v: f64| (v / (f64::from(8 * BLOCK) * size)).floor() as i32;
        let (low, high) = ((tile(region.min.x), tile(region.min.y)), (tile(region.max.x), tile(region.max.y)));
        let mut out = vec![];
        for (_, tile) in self.tiles(self.tile_keys_within(low, high)) {
            let inside = |v: Voxel| region.contains(&v.center(size));
            out.extend(tile.voxels().filter(|(v, _)| inside(*v)));
            if out.len() > max_voxels {
                return Err(MappingError::RegionTooLarge { cells: out.len() as u64, limit: max_voxels as u64 });
            }
        }
        Ok(out)
    }
}
