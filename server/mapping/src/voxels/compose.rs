//! The voxels of the whole map: submaps' evidence laid over each other.

use super::block::{Evidence, QUANTUM, UNKNOWN, VOXELS, Values};
use super::{VoxelGrid, VoxelParams, VoxelUpdate};
use crate::KeyframeView;
use crate::blocks::{BLOCK, BlockKey, block_box, corner, locate};
use crate::bytes::{Damaged, Reader, put_i32, put_u32};
use crate::composed::Composed;
use crate::layer::{Footprint, Layer, Placement, TileKey, moved};
use nalgebra::Vector3;
use percept_geometry::{Aabb3, Voxel};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Edge of a tile of the map, blocks.
const TILE_BLOCKS: i32 = VoxelGrid::TILE_VOXELS / BLOCK;
/// Blocks of a stored part; bounds what damaged bytes may ask for.
const MAX_BLOCKS: usize = 1 << 24;

/// Unbounded 3D occupancy of the whole map: log-odds by voxel, unknown where no beam has been. A submap that was moved is read at the
/// centres of the map's voxels.
pub type VoxelMap = Composed<VoxelGrid>;

/// A tile of the map: a column of all heights.
#[derive(Debug, Clone, PartialEq)]
pub struct VoxelTile {
    /// Ascending; in none of them is all unknown.
    pub(super) blocks: Vec<(BlockKey, Box<Values>)>,
}

impl VoxelTile {
    /// Log-odds of all voxels of which something is known, in order of blocks, then of slots.
    pub fn voxels(&self) -> impl Iterator<Item = (Voxel, f32)> {
        let of_block = |(key, values): &(BlockKey, Box<Values>)| {
            let (key, values) = (*key, **values);
            let known = (0..VOXELS).filter(move |slot| values[*slot] != UNKNOWN);
            known.map(move |slot| (voxel_at(key, slot), f32::from(values[slot]) * QUANTUM))
        };
        self.blocks.iter().flat_map(of_block)
    }

    pub(super) fn block(&self, key: BlockKey) -> Option<&Values> {
        let at = self.blocks.binary_search_by_key(&key, |b| b.0).ok()?;
        Some(&self.blocks[at].1)
    }
}

/// A voxel by its place in a block.
pub(super) fn voxel_at(key: BlockKey, slot: usize) -> Voxel {
    let slot = slot as i32;
    Voxel::new(key.0 * BLOCK + slot % 8, key.1 * BLOCK + slot / 8 % 8, key.2 * BLOCK + slot / 64)
}

/// The tile of a block.
pub(super) fn tile_of(key: BlockKey) -> TileKey {
    (key.0.div_euclid(TILE_BLOCKS), key.1.div_euclid(TILE_BLOCKS))
}

impl Layer for VoxelGrid {
    type Params = VoxelParams;
    type Update = VoxelUpdate;
    type Under = BTreeMap<BlockKey, Box<Values>>;
    type Tile = VoxelTile;

    fn new(params: &VoxelParams) -> Self {
        Self::of_blocks(*params, BTreeMap::new())
    }

    fn prepare(params: &VoxelParams, view: &KeyframeView<'_>) -> VoxelUpdate {
        VoxelUpdate::new(params, view)
    }

    fn touched(params: &VoxelParams, update: &VoxelUpdate) -> Aabb3 {
        update.blocks.iter().fold(Aabb3::empty(), |out, b| {
            let of_block = block_box(b.0, params.voxel_size_m);
            crate::layer::joined(&out, &of_block)
        })
    }

    fn add(&mut self, update: &VoxelUpdate) {
        self.apply(update);
    }

    fn freeze(&mut self) {}

    fn cell_m(params: &VoxelParams) -> f64 {
        if params.enabled { params.voxel_size_m } else { 0.0 }
    }

    fn range_max_m(params: &VoxelParams) -> f64 {
        if params.enabled { params.range_max() } else { 0.0 }
    }

    fn tile_edge_m(params: &VoxelParams) -> f64 {
        f64::from(TILE_BLOCKS * BLOCK) * params.voxel_size_m
    }

    fn unknown(_: &VoxelParams, _: TileKey) -> Self::Under {
        BTreeMap::new()
    }

    fn overlay(&self, params: &VoxelParams, place: &Placement, tile: TileKey, under: &mut Self::Under) {
        let unknown = || Box::new([UNKNOWN; VOXELS]);
        if place.is_aligned() {
            let (x0, y0) = (tile.0 * TILE_BLOCKS, tile.1 * TILE_BLOCKS);
            let rows = self.blocks.range((x0, i32::MIN, i32::MIN)..(x0 + TILE_BLOCKS, i32::MIN, i32::MIN));
            for (key, evidence) in rows.filter(|(key, _)| (y0..y0 + TILE_BLOCKS).contains(&key.1)) {
                for (slot, known) in under.entry(*key).or_insert_with(unknown).iter_mut().enumerate() {
                    *known = evidence.over(slot, *known, self.limits());
                }
            }
            return;
        }
        let t_submap_map = place.t_map_submap.inverse();
        for key in self.blocks_of_map(params, place, tile) {
            for (slot, known) in under.entry(key).or_insert_with(unknown).iter_mut().enumerate() {
                let p = t_submap_map * voxel_at(key, slot).center(params.voxel_size_m);
                let own = Voxel::containing(&p, params.voxel_size_m).map(locate);
                let evidence = own.and_then(|(block, slot)| Some((usize::from(slot), self.blocks.get(&block)?)));
                if let Some((slot, evidence)) = evidence {
                    *known = evidence.over(slot, *known, self.limits());
                }
            }
        }
    }

    fn finish(_: &VoxelParams, _: TileKey, under: &Self::Under) -> Option<VoxelTile> {
        let known = under.iter().filter(|(_, values)| values.iter().any(|v| *v != UNKNOWN));
        let blocks: Vec<_> = known.map(|(key, values)| (*key, values.clone())).collect();
        (!blocks.is_empty()).then_some(VoxelTile { blocks })
    }

    fn memory_bytes(&self) -> usize {
        self.blocks.len() * (size_of::<BlockKey>() + size_of::<Evidence>())
    }

    fn tile_bytes(tile: &VoxelTile) -> usize {
        tile.blocks.len() * (size_of::<(BlockKey, Box<Values>)>() + VOXELS)
    }

    fn under_bytes(under: &Self::Under) -> usize {
        under.len() * (size_of::<(BlockKey, Box<Values>)>() + VOXELS)
    }

    fn footprint(&self, _: &VoxelParams) -> Footprint {
        Footprint::of(self.blocks.keys().map(|key| tile_of(*key)).collect())
    }

    fn encode(&self, out: &mut Vec<u8>) {
        put_u32(out, self.blocks.len() as u32);
        for (key, evidence) in self.blocks.iter() {
            [key.0, key.1, key.2].iter().for_each(|v| put_i32(out, *v));
            for values in [&evidence.values, &evidence.most] {
                // Runs: voxels of a block are much alike.
                let runs: Vec<&[i8]> = values.chunk_by(|a, b| a == b).collect();
                put_u32(out, runs.len() as u32);
                for run in runs {
                    put_u32(out, (run.len() as u32) << 8 | u32::from(run[0] as u8));
                }
            }
        }
    }

    fn decode(params: &VoxelParams, from: &mut Reader<'_>) -> Result<Self, Damaged> {
        let mut blocks = vec![];
        for _ in 0..from.count(MAX_BLOCKS)? {
            let key = (from.i32()?, from.i32()?, from.i32()?);
            let (values, most) = (take_values(from)?, take_values(from)?);
            blocks.push((key, Arc::new(Evidence { values, most })));
        }
        Ok(Self::of_blocks(*params, BTreeMap::from_iter(blocks)))
    }
}

fn take_values(from: &mut Reader<'_>) -> Result<Values, Damaged> {
    let (mut out, mut at) = ([UNKNOWN; VOXELS], 0);
    for _ in 0..from.count(VOXELS)? {
        let run = from.u32()?;
        let end = at + (run >> 8) as usize;
        out.get_mut(at..end).ok_or(Damaged)?.fill(run as u8 as i8);
        at = end;
    }
    if at == VOXELS { Ok(out) } else { Err(Damaged) }
}

impl VoxelGrid {
    /// Blocks of a tile of the map into which any of this submap's may reach, once the submap lies where it does.
    fn blocks_of_map(&self, params: &VoxelParams, place: &Placement, tile: TileKey) -> Vec<BlockKey> {
        let edge = f64::from(BLOCK) * params.voxel_size_m;
        let index = |v: f64| (v / edge).floor() as i32;
        // In the submap's frame, what of it may lie within the tile, at whatever height.
        let t_submap_map = place.t_map_submap.inverse();
        let heights = moved(&place.t_map_submap, &self.blocks_box(params));
        if heights.is_empty() {
            return vec![];
        }
        let column = Aabb3 {
            min: corner((tile.0 * TILE_BLOCKS, tile.1 * TILE_BLOCKS, 0), 0, params.voxel_size_m),
            max: corner(((tile.0 + 1) * TILE_BLOCKS, (tile.1 + 1) * TILE_BLOCKS, 0), 0, params.voxel_size_m),
        };
        let (mut low, mut high) = (column.min, column.max);
        (low.z, high.z) = (heights.min.z, heights.max.z);
        let within = moved(&t_submap_map, &Aabb3 { min: low, max: high });
        let (from, to) = (within.min.map(index), within.max.map(index));
        let mut out = vec![];
        for x in from.x..=to.x {
            let rows = self.blocks.range((x, from.y, i32::MIN)..=(x, to.y, i32::MAX));
            for key in rows.map(|(key, _)| *key).filter(|key| (from.z..=to.z).contains(&key.2)) {
                let b = moved(&place.t_map_submap, &block_box(key, params.voxel_size_m));
                let (low, high) = (b.min.map(index), b.max.map(index));
                for bx in low.x..=high.x {
                    for by in low.y..=high.y {
                        out.extend((low.z..=high.z).map(|bz| (bx, by, bz)).filter(|key| tile_of(*key) == tile));
                    }
                }
            }
        }
        out.sort_unstable();
        out.dedup();
        out
    }

    fn blocks_box(&self, params: &VoxelParams) -> Aabb3 {
        let Some((first, last)) = self.blocks.keys().next().zip(self.blocks.keys().next_back()) else {
            return Aabb3::empty();
        };
        let zs = self.blocks.keys().map(|key| key.2);
        let (low, high) = zs.fold((first.2, last.2), |(a, b), z| (a.min(z), b.max(z)));
        let mut out = block_box((first.0, first.1, low), params.voxel_size_m);
        let ys = self.blocks.keys().map(|key| key.1);
        let (y0, y1) = ys.fold((first.1, last.1), |(a, b), y| (a.min(y), b.max(y)));
        for key in [(first.0, y0, low), (last.0, y1, high)] {
            out = crate::layer::joined(&out, &block_box(key, params.voxel_size_m));
        }
        // Voxels are cubes: their corners may stick out of a box around the blocks' centres by nothing, but heights are rounded.
        out.min -= Vector3::repeat(1e-6);
        out.max += Vector3::repeat(1e-6);
        out
    }
}
