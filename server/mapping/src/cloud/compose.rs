//! The cloud of the whole map: submaps' clouds laid over each other, each carving what it saw through.

use super::block::{BLOCK, BlockKey, VoxelMean, corner, locate};
use super::free::{Count, FreeSpace, count_at};
use super::fused::{Block, NO_COLOR, merge};
use super::shift::{Shift, voxel_at};
use super::{CloudParams, CloudUpdate, FusedCloud};
use crate::KeyframeView;
use crate::blocks::block_box;
use crate::bytes::{Damaged, Reader, put_f32, put_i32, put_u16, put_u32, put_u64};
use crate::composed::Composed;
use crate::layer::{Footprint, Layer, Placement, TileKey, joined, moved};
use crate::sorted::sort_by_key;
use nalgebra::{Point3, Vector2, Vector3};
use percept_geometry::{Aabb3, PointCloud};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Edge of a tile of the map, blocks.
const TILE_BLOCKS: i32 = 8;
/// Voxels of a block.
const SLOTS: u64 = BLOCK.pow(3) as u64;
/// Half of a block's diagonal, voxels, and what means of voxels may stick out by.
const HALF_DIAGONAL: f64 = 7.0;
/// Blocks of a stored part; bounds what damaged bytes may ask for.
const MAX_BLOCKS: usize = 1 << 24;

/// One mean point and colour a voxel of the whole map, unbounded. Order of points: by tile, then by block, then by voxel,
/// always the same.
///
/// Each submap's voxels are moved with it and fall into the map's; before that, what it saw through loses weight by how
/// many of its keyframes did (see [`CloudParams::carve_weight`]), unless something of its own stands there.
pub type CloudMap = Composed<FusedCloud>;

/// A tile of the map: a column of all heights.
#[derive(Debug, Clone, PartialEq)]
pub struct CloudTile {
    /// Map frame, metres.
    pub positions: Vec<Point3<f32>>,
    /// One a point, grey where a point has none; empty if no point has one.
    pub colors: Vec<[u8; 3]>,
}

/// A tile while it is composed: voxels of the map by block, none empty.
type Under = BTreeMap<BlockKey, Block>;
/// A block that was looked up, and what was seen through there, if anything was.
type Looked<'a> = (BlockKey, Option<&'a Arc<Count>>);

impl Layer for FusedCloud {
    type Params = CloudParams;
    type Update = CloudUpdate;
    type Under = Under;
    type Tile = CloudTile;

    fn new(params: &CloudParams) -> Self {
        Self::empty(*params)
    }

    fn prepare(params: &CloudParams, view: &KeyframeView<'_>) -> CloudUpdate {
        CloudUpdate::new(params, view)
    }

    fn touched(params: &CloudParams, update: &CloudUpdate) -> Aabb3 {
        let keys = update.blocks.iter().map(|b| b.0).chain(update.free.iter().map(|b| b.0));
        keys.fold(Aabb3::empty(), |out, key| joined(&out, &block_box(key, params.voxel_size_m)))
    }

    fn add(&mut self, update: &CloudUpdate) {
        self.apply(update);
    }

    fn freeze(&mut self) {}

    fn cell_m(params: &CloudParams) -> f64 {
        params.voxel_size_m
    }

    fn range_max_m(params: &CloudParams) -> f64 {
        params.range_max()
    }

    fn tile_edge_m(params: &CloudParams) -> f64 {
        f64::from(TILE_BLOCKS * BLOCK) * params.voxel_size_m
    }

    fn unknown(_: &CloudParams, _: TileKey) -> Under {
        Under::new()
    }

    fn overlay(&self, params: &CloudParams, place: &Placement, tile: TileKey, under: &mut Under) {
        if params.carve_weight > 0.0 {
            self.carve(params, place, under);
        }
        for (key, voxels) in self.voxels_in(params, place, tile) {
            let known = under.entry(key).or_default();
            *known = merge(known, &voxels, params.max_weight);
        }
    }

    fn finish(params: &CloudParams, _: TileKey, under: &Under) -> Option<CloudTile> {
        let voxels = || under.iter().flat_map(|(key, block)| block.iter().map(|v| (*key, v)));
        let positions = voxels().map(|(key, v)| position(params, key, v).cast::<f32>()).collect::<Vec<_>>();
        let color = |v: &VoxelMean| if v.colored { v.color.map(|c| c.round() as u8) } else { NO_COLOR };
        let is_colored = voxels().any(|(_, v)| v.colored);
        let colors = if is_colored { voxels().map(|(_, v)| color(v)).collect() } else { vec![] };
        (!positions.is_empty()).then_some(CloudTile { positions, colors })
    }

    fn memory_bytes(&self) -> usize {
        self.memory_bytes()
    }

    fn tile_bytes(tile: &CloudTile) -> usize {
        size_of_val(&tile.positions[..]) + size_of_val(&tile.colors[..])
    }

    fn under_bytes(under: &Under) -> usize {
        under.values().map(|block| size_of::<BlockKey>() + size_of_val(&block[..])).sum()
    }

    fn footprint(&self, _: &CloudParams) -> Footprint {
        let blocks = self.blocks.keys().chain(self.free.blocks.keys());
        Footprint::of(blocks.map(|(x, y, _)| (x.div_euclid(TILE_BLOCKS), y.div_euclid(TILE_BLOCKS))).collect())
    }

    fn encode(&self, out: &mut Vec<u8>) {
        put_u32(out, self.blocks.len() as u32);
        for (key, block) in self.blocks.iter() {
            put_key(out, *key);
            put_u16(out, block.len() as u16);
            for v in block.iter() {
                put_u16(out, v.slot | u16::from(v.colored) << 15);
                [v.weight].iter().chain(&v.offset).chain(&v.color).for_each(|n| put_f32(out, *n));
            }
        }
        put_u32(out, self.free.blocks.len() as u32);
        for (key, count) in self.free.blocks.iter() {
            put_key(out, *key);
            count.as_flattened().iter().for_each(|word| put_u64(out, *word));
        }
    }

    fn decode(params: &CloudParams, from: &mut Reader<'_>) -> Result<Self, Damaged> {
        // They come in order, of which a tree is built at once.
        let (mut blocks, mut free) = (vec![], vec![]);
        for _ in 0..from.count(MAX_BLOCKS)? {
            let (key, num_voxels) = (take_key(from)?, usize::from(from.u16()?));
            if num_voxels > from.len() {
                return Err(Damaged);
            }
            let mut block = Block::with_capacity(num_voxels);
            for _ in 0..num_voxels {
                block.push(take_voxel(from)?);
            }
            blocks.push((key, Arc::new(block)));
        }
        let blocks = BTreeMap::from_iter(blocks);
        for _ in 0..from.count(MAX_BLOCKS)? {
            let key = take_key(from)?;
            let mut count = Count::default();
            for word in count.as_flattened_mut() {
                *word = from.u64()?;
            }
            free.push((key, Arc::new(count)));
        }
        let free = BTreeMap::from_iter(free);
        Ok(Self::of_blocks(*params, blocks, FreeSpace { blocks: Arc::new(free) }))
    }
}

impl FusedCloud {
    /// Takes weight from what this submap saw through.
    fn carve(&self, params: &CloudParams, place: &Placement, under: &mut Under) {
        let shift = (!place.is_aligned()).then(|| Shift::new(&place.t_map_submap.inverse(), params.voxel_size_m));
        // A block of the map lies across blocks of the submap beside each other: of these each has a place of its own.
        let mut known: [Option<Looked<'_>>; 8] = [None; 8];
        under.retain(|key, block| {
            let shift = shift.as_ref().map(|shift| shift.block(*key));
            block.retain_mut(|v| {
                let (key, slot) = shift.as_ref().map_or((*key, v.slot), |shift| locate(voxel_at(&shift.position(v))));
                let at = &mut known[(key.0 & 1 | (key.1 & 1) << 1 | (key.2 & 1) << 2) as usize];
                let count = match at {
                    Some((last, found)) if *last == key => *found,
                    _ => at.insert((key, self.free.blocks.get(&key))).1,
                };
                let Some(passes) = count.map(|c| count_at(c, slot)).filter(|n| *n > 0) else { return true };
                if self.blocks.get(&key).is_some_and(|b| b.binary_search_by_key(&slot, |s| s.slot).is_ok()) {
                    return true;
                }
                v.weight -= f32::from(passes) * params.carve_weight;
                v.weight > 0.0
            });
            !block.is_empty()
        });
    }

    /// This submap's voxels as voxels of a tile of the map, ascending by block and slot.
    fn voxels_in(&self, params: &CloudParams, place: &Placement, tile: TileKey) -> Vec<(BlockKey, Block)> {
        let (x0, y0) = (tile.0 * TILE_BLOCKS, tile.1 * TILE_BLOCKS);
        let (xs, ys) = (x0..x0 + TILE_BLOCKS, y0..y0 + TILE_BLOCKS);
        if place.is_aligned() {
            let rows = self.blocks.range((xs.start, i32::MIN, i32::MIN)..(xs.end, i32::MIN, i32::MIN));
            return rows.filter(|(key, _)| ys.contains(&key.1)).map(|(k, b)| (*k, Block::clone(b))).collect();
        }
        let edge = f64::from(BLOCK) * params.voxel_size_m;
        if self.extent().is_empty() {
            return vec![];
        }
        let heights = moved(&place.t_map_submap, self.extent());
        let low = Point3::new(f64::from(xs.start) * edge, f64::from(ys.start) * edge, heights.min.z);
        let high = Point3::new(f64::from(xs.end) * edge, f64::from(ys.end) * edge, heights.max.z);
        let column = moved(&place.t_map_submap.inverse(), &Aabb3 { min: low, max: high });
        // A mean rounded to f32 may stick out of its voxel a little.
        let index = |v: f64, aside: f64| (v / edge + aside).floor() as i32;
        let (from, to) = (column.min.map(|v| index(v, -1e-3)), column.max.map(|v| index(v, 1e-3)));
        let near = |key: &BlockKey| (from.y..=to.y).contains(&key.1) && (from.z..=to.z).contains(&key.2);
        let mut found: Vec<(BlockKey, VoxelMean)> = Vec::new();
        let rows = self.blocks.range((from.x, i32::MIN, i32::MIN)..=(to.x, i32::MAX, i32::MAX));
        let shift = Shift::new(&place.t_map_submap, params.voxel_size_m);
        let side = f64::from(TILE_BLOCKS * BLOCK);
        let low = Vector2::new(f64::from(tile.0), f64::from(tile.1)) * side;
        for (key, voxels) in rows.filter(|(key, _)| near(key)) {
            let shift = shift.block(*key);
            let off = (shift.middle().xy() - low).add_scalar(-0.5 * side).abs();
            if off.max() > 0.5 * side + HALF_DIAGONAL {
                continue;
            }
            for v in voxels.iter() {
                let p = shift.position(v);
                let voxel = voxel_at(&p);
                let (block, slot) = locate(voxel);
                if xs.contains(&block.0) && ys.contains(&block.1) {
                    let within = [p.x - f64::from(voxel.x), p.y - f64::from(voxel.y), p.z - f64::from(voxel.z)];
                    let offset = within.map(|v| (v * params.voxel_size_m) as f32);
                    found.push((block, VoxelMean { slot, offset, ..*v }));
                }
            }
        }
        // Stable: those that fall into one voxel are folded in the order of the submap's.
        let mut order = numbered(&found, (xs.start, ys.start));
        sort_by_key(&mut order);
        let mut out: Vec<(BlockKey, Block)> = Vec::new();
        for of_block in order.chunk_by(|a, b| a.0 / SLOTS == b.0 / SLOTS) {
            let mut block = Block::with_capacity(of_block.len());
            for (_, at) in of_block {
                let v = &found[*at as usize].1;
                match block.last_mut().filter(|last| last.slot == v.slot) {
                    // Halves of one surface: together they weigh no more than either.
                    Some(last) => {
                        *last = VoxelMean { weight: last.weight.max(v.weight), ..super::fused::fold(last, v, f32::MAX) }
                    }
                    None => block.push(*v),
                }
            }
            out.push((found[of_block[0].1 as usize].0, block));
        }
        out
    }
}

/// Numbers in the order of blocks and slots, and which voxel each is of; a tile's first column and row of blocks is given.
fn numbered(voxels: &[(BlockKey, VoxelMean)], (x0, y0): (i32, i32)) -> Vec<(u64, u32)> {
    let (lowest, highest) =
        voxels.iter().fold((i32::MAX, i32::MIN), |(low, high), (key, _)| (low.min(key.2), high.max(key.2)));
    let layers = u64::from(highest.abs_diff(lowest)) + 1;
    let number = |((x, y, z), v): &(BlockKey, VoxelMean)| {
        let column = u64::from(x.abs_diff(x0)) * TILE_BLOCKS as u64 + u64::from(y.abs_diff(y0));
        (column * layers + u64::from(z.abs_diff(lowest))) * SLOTS + u64::from(v.slot)
    };
    voxels.iter().map(number).zip(0..).collect()
}

impl CloudMap {
    /// Number of points.
    pub fn len(&self) -> usize {
        self.tiles(self.tile_keys()).iter().map(|(_, t)| t.positions.len()).sum()
    }

    /// Whether there is no point.
    pub fn is_empty(&self) -> bool {
        self.tile_keys().all(|key| self.tile(key).is_none())
    }

    /// The box around all points; empty if there is none.
    pub fn bounds(&self) -> Aabb3 {
        let tiles = self.tiles(self.tile_keys());
        Aabb3::of(tiles.iter().flat_map(|(_, t)| &t.positions))
    }

    /// All points, with colours if any has one (grey where it has none). Copies.
    pub fn to_cloud(&self) -> PointCloud {
        collect(self.tiles(self.tile_keys()), |_| true)
    }

    /// The points within `radius_m` of `center`, as [`CloudMap::to_cloud`] gives them.
    pub fn points_within(&self, center: &Point3<f64>, radius_m: f64) -> PointCloud {
        let edge = FusedCloud::tile_edge_m(self.params());
        // A float beyond the range of i32 becomes the nearest that is in it.
        let tile = |v: f64| (v / edge).floor() as i32;
        let low = (tile(center.x - radius_m), tile(center.y - radius_m));
        let high = (tile(center.x + radius_m), tile(center.y + radius_m));
        collect(self.tiles(self.tile_keys_within(low, high)), |p| (p.cast::<f64>() - center).norm() <= radius_m)
    }
}

fn collect(tiles: Vec<(TileKey, Arc<CloudTile>)>, wanted: impl Fn(&Point3<f32>) -> bool) -> PointCloud {
    let (mut positions, mut colors, mut any) = (Vec::new(), Vec::new(), false);
    for (_, tile) in &tiles {
        for (i, p) in tile.positions.iter().enumerate().filter(|(_, p)| wanted(p)) {
            positions.push(*p);
            colors.push(tile.colors.get(i).copied().unwrap_or(NO_COLOR));
        }
        any |= !tile.colors.is_empty();
    }
    PointCloud { colors: any.then_some(colors), ..PointCloud::from_positions(positions) }
}

fn position(params: &CloudParams, key: BlockKey, v: &VoxelMean) -> Point3<f64> {
    corner(key, v.slot, params.voxel_size_m) + Vector3::from(v.offset).cast::<f64>()
}

fn put_key(out: &mut Vec<u8>, key: BlockKey) {
    [key.0, key.1, key.2].iter().for_each(|v| put_i32(out, *v));
}

fn take_key(from: &mut Reader<'_>) -> Result<BlockKey, Damaged> {
    Ok((from.i32()?, from.i32()?, from.i32()?))
}

/// Its bytes are looked for at once: there are millions.
fn take_voxel(from: &mut Reader<'_>) -> Result<VoxelMean, Damaged> {
    let bytes = from.array::<30>()?;
    let slot = u16::from_le_bytes([bytes[0], bytes[1]]);
    let number = |i: usize| f32::from_le_bytes(std::array::from_fn(|k| bytes[2 + 4 * i + k]));
    let numbers: [f32; 7] = std::array::from_fn(number);
    let [weight, x, y, z, r, g, b] = numbers;
    let (colored, slot) = (slot >> 15 == 1, slot & 0x7fff);
    let is_sound = i32::from(slot) < BLOCK.pow(3) && numbers.iter().all(|n| n.is_finite());
    is_sound.then_some(VoxelMean { slot, colored, weight, offset: [x, y, z], color: [r, g, b] }).ok_or(Damaged)
}
