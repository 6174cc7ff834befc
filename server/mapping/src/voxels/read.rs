//! Questions to the voxels of the map: what is at a point, in a box, along a ray.

use super::VoxelGrid;
use super::block::{QUANTUM, UNKNOWN, VOXELS, Values};
use super::compose::{VoxelMap, VoxelTile, tile_of, voxel_at};
use crate::blocks::{BLOCK, BlockKey, block_box, locate};
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

    /// Edge of a voxel, metres.
    pub fn voxel_size_m(&self) -> f64 {
        self.map.params().voxel_size_m
    }

    /// What is in a voxel.
    pub fn state(&mut self, voxel: Voxel) -> VoxelState {
        VoxelState::of(self.log_odds(voxel))
    }

    /// What is at a point of the map; unknown too if it has no number.
    pub fn state_at(&mut self, p: &Point3<f64>) -> VoxelState {
        let voxel = Voxel::containing(p, self.map.params().voxel_size_m);
        voxel.map_or(VoxelState::Unknown, |v| self.state(v))
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
            let state = self.state(voxel);
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

/// Eight by eight by eight voxels of the map.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct VoxelBlock {
    /// Which: the block's lowest corner lies at eight voxels times it.
    pub key: [i32; 3],
    /// Percent occupied, -1 where nothing is known or was not asked for; x fastest, then y, then z.
    pub percent: Box<[i8; VOXELS]>,
}

impl VoxelMap {
    /// Blocks with voxels of which something is known, ascending: those within a box (by their centres), or all; free ones left out
    /// if `occupied_only`; of those tiles only that changed after a version.
    ///
    /// # Errors
    /// `RegionTooLarge` beyond `max_voxels`.
    pub fn blocks(
        &self,
        region: Option<&Aabb3>,
        occupied_only: bool,
        since_version: u64,
        max_voxels: usize,
    ) -> Result<Vec<VoxelBlock>, MappingError> {
        let size = self.params().voxel_size_m;
        let keys: Vec<TileKey> =
            self.changed_since(since_version).filter(|k| region.is_none_or(|r| reaches(size, r, *k))).collect();
        let mut out: Vec<VoxelBlock> = vec![];
        // Some at a time: what they hold until they are asked for is in memory beside the answer.
        for keys in keys.chunks(64) {
            for (_, tile) in self.tiles(keys.iter().copied()) {
                out.extend(
                    tile.blocks.iter().filter_map(|(key, values)| block_of(size, *key, values, region, occupied_only)),
                );
                if out.len() * VOXELS > max_voxels {
                    let cells = (out.len() * VOXELS) as u64;
                    return Err(MappingError::RegionTooLarge { cells, limit: max_voxels as u64 });
                }
            }
        }
        out.sort_unstable_by_key(|b| b.key);
        Ok(out)
    }
}

/// Whether a tile reaches into a box.
fn reaches(size: f64, region: &Aabb3, key: TileKey) -> bool {
    let edge = f64::from(VoxelGrid::TILE_VOXELS) * size;
    let along = |k: i32, low: f64, high: f64| f64::from(k) * edge <= high && f64::from(k + 1) * edge >= low;
    along(key.0, region.min.x, region.max.x) && along(key.1, region.min.y, region.max.y)
}

fn block_of(
    size: f64,
    key: BlockKey,
    values: &Values,
    region: Option<&Aabb3>,
    occupied_only: bool,
) -> Option<VoxelBlock> {
    let box_of = block_box(key, size);
    if region.is_some_and(|r| (0..3).any(|i| box_of.max[i] < r.min[i] || box_of.min[i] > r.max[i])) {
        return None;
    }
    let is_within = region.is_none_or(|r| r.contains(&box_of.min) && r.contains(&box_of.max));
    let is_asked = |slot: usize| is_within || region.is_none_or(|r| r.contains(&voxel_at(key, slot).center(size)));
    let percent = |slot: usize| {
        let value = values[slot];
        if value == UNKNOWN || (occupied_only && value <= 0) || !is_asked(slot) { -1 } else { percent_of(value) }
    };
    let percent: Box<[i8; VOXELS]> = Box::new(std::array::from_fn(percent));
    percent.iter().any(|p| *p >= 0).then_some(VoxelBlock { key: [key.0, key.1, key.2], percent })
}

/// Log-odds in quanta as a probability in percent: at least 51 of what is more likely occupied than not, at most 50 of what is not.
fn percent_of(value: i8) -> i8 {
    let percent = 100.0 / (1.0 + (-f32::from(value) * QUANTUM).exp());
    if value > 0 { percent.round().max(51.0) as i8 } else { percent.round().min(50.0) as i8 }
}

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
