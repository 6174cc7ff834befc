//! A submap's surface laid over what earlier submaps say of a tile.

use super::SurfaceGrid;
use super::block::{Observation, SurfaceBlock, VOXELS};
use super::tile::{TILE_BLOCKS, Under};
use crate::blocks::{BLOCK, BlockKey, corner, locate};
use crate::cloud::free::count_at;
use crate::layer::{Placement, TileKey, moved, tiles_of};
use nalgebra::{Point3, Vector3};
use percept_geometry::{Aabb3, Pose, Voxel};
use std::collections::BTreeSet;
use std::sync::Arc;

/// Takes weight from what lies behind a surface where this submap saw through, by how many of its keyframes did; unless it has a
/// surface there itself.
pub(super) fn carve(part: &SurfaceGrid, place: &Placement, under: &mut Under) {
    let params = part.params();
    let t_submap_map = place.t_map_submap.inverse();
    for (key, block) in under.iter_mut() {
        if !block.has_inside() || (place.is_aligned() && !part.free.blocks.contains_key(key)) {
            continue;
        }
        let mut gone: Vec<(usize, u8)> = vec![];
        for slot in (0..VOXELS).filter(|slot| block.distance[*slot] < 0) {
            let own = if place.is_aligned() {
                Some((*key, slot as u16))
            } else {
                let p = t_submap_map * center(*key, slot, params.voxel_size_m);
                Voxel::containing(&p, params.voxel_size_m).map(locate)
            };
            let Some((own, own_slot)) = own else { continue };
            let passes = part.free.blocks.get(&own).map_or(0, |count| count_at(count, own_slot));
            let stands = |b: &Arc<SurfaceBlock>| b.distance[usize::from(own_slot)] < 0;
            if passes > 0 && !part.blocks.get(&own).is_some_and(stands) {
                gone.push((slot, passes));
            }
        }
        if !gone.is_empty() {
            let block = Arc::make_mut(block);
            gone.into_iter().for_each(|(slot, passes)| block.carve(slot, passes.into(), params.max_weight));
        }
    }
}

/// Merges this submap's voxels into those of a tile of the map by weight.
pub(super) fn lay_over(part: &SurfaceGrid, place: &Placement, tile: TileKey, under: &mut Under) {
    let params = part.params();
    let (x0, y0) = (tile.0.saturating_mul(TILE_BLOCKS), tile.1.saturating_mul(TILE_BLOCKS));
    let (xs, ys) = (x0..x0.saturating_add(TILE_BLOCKS), y0..y0.saturating_add(TILE_BLOCKS));
    let mut merge = |key: BlockKey, block: Arc<SurfaceBlock>| match under.get_mut(&key) {
        None => {
            under.insert(key, block);
        }
        Some(known) => Arc::make_mut(known).merge(&block, params),
    };
    if place.is_aligned() {
        let rows = part.blocks.range((xs.start, i32::MIN, i32::MIN)..(xs.end, i32::MIN, i32::MIN));
        rows.filter(|(key, _)| ys.contains(&key.1)).for_each(|(key, block)| merge(*key, Arc::clone(block)));
        return;
    }
    let edge = f64::from(BLOCK) * params.voxel_size_m;
    let mut keys: BTreeSet<BlockKey> = BTreeSet::new();
    for (key, _) in part.blocks.iter() {
        let low = corner(*key, 0, params.voxel_size_m);
        let reach = moved(&place.t_map_submap, &Aabb3 { min: low, max: low + Vector3::repeat(edge) });
        let Some((first, last)) = tiles_of(edge, &reach) else { continue };
        let heights = (reach.min.z / edge).floor() as i32..=(reach.max.z / edge).floor() as i32;
        for x in first.0.max(xs.start)..=last.0.min(xs.end - 1) {
            for y in first.1.max(ys.start)..=last.1.min(ys.end - 1) {
                keys.extend(heights.clone().map(|z| (x, y, z)));
            }
        }
    }
    let t_submap_map = place.t_map_submap.inverse();
    for key in keys {
        if let Some(block) = resampled(part, &t_submap_map, key) {
            merge(key, Arc::new(block));
        }
    }
}

/// A block of the map as a submap has it: at the centres of the map's voxels, interpolated between the eight voxels of the submap
/// around each; unknown unless all eight are known. None if nothing is.
fn resampled(part: &SurfaceGrid, t_submap_map: &Pose, key: BlockKey) -> Option<SurfaceBlock> {
    let params = part.params();
    let voxel = params.voxel_size_m;
    let mut near = Near::around(part, t_submap_map, key);
    let mut out = SurfaceBlock::unknown();
    let mut any = false;
    for slot in 0..VOXELS {
        // In voxels, centres at whole numbers.
        let p = (t_submap_map * center(key, slot, voxel)).coords / voxel - Vector3::repeat(0.5);
        if let Some(seen) = near.at(&p) {
            out.fold(slot, &seen, params.max_weight);
            any = true;
        }
    }
    any.then_some(out)
}

/// Blocks of a submap around one of the map.
struct Near<'a> {
    first: BlockKey,
    /// `4 x 4 x 4`: what a turned block and a voxel around it may reach into.
    blocks: Vec<Option<&'a SurfaceBlock>>,
}

impl<'a> Near<'a> {
    fn around(part: &'a SurfaceGrid, t_submap_map: &Pose, key: BlockKey) -> Self {
        let (voxel, edge) = (part.params().voxel_size_m, f64::from(BLOCK) * part.params().voxel_size_m);
        let low = corner(key, 0, voxel);
        let reach = moved(t_submap_map, &Aabb3 { min: low, max: low + Vector3::repeat(edge) });
        let first = reach.min.map(|v| ((v - voxel) / edge).floor() as i32);
        let at = |i: i32| (first.x + i % 4, first.y + i / 4 % 4, first.z + i / 16);
        let blocks = (0..64).map(|i| part.blocks.get(&at(i)).map(|b| &**b)).collect();
        Self { first: (first.x, first.y, first.z), blocks }
    }

    fn voxel(&self, v: Voxel) -> Option<(&'a SurfaceBlock, usize)> {
        let (key, slot) = locate(v);
        let off = [key.0 - self.first.0, key.1 - self.first.1, key.2 - self.first.2];
        let is_near = off.iter().all(|o| (0..4).contains(o));
        let block = self.blocks.get(((off[2] * 4 + off[1]) * 4 + off[0]) as usize).filter(|_| is_near)?;
        Some(((*block)?, usize::from(slot)))
    }

    /// What lies at a point given in voxels.
    fn at(&mut self, p: &Vector3<f64>) -> Option<Observation> {
        let low = p.map(f64::floor);
        let share = p - low;
        let (mut distance, mut weight) = (0.0, f32::INFINITY);
        let (mut color, mut color_share) = (Vector3::zeros(), 0.0);
        for i in 0..8usize {
            let step = Vector3::new(i & 1, i >> 1 & 1, i >> 2).cast::<f64>();
            let v = (low + step).map(|v| v as i32);
            let (block, slot) = self.voxel(Voxel { x: v.x, y: v.y, z: v.z })?;
            let seen = block.observation(slot)?;
            let part = (0..3).map(|a| if step[a] > 0.0 { share[a] } else { 1.0 - share[a] }).product::<f64>() as f32;
            distance += seen.distance * part;
            weight = seen.weight.min(weight);
            if let Some(seen) = seen.color {
                color += Vector3::from(seen) * part;
                color_share += part;
            }
        }
        let color = (color_share > 0.0).then(|| (color / color_share).into());
        Some(Observation { distance, weight, color })
    }
}

fn center(key: BlockKey, slot: usize, voxel: f64) -> Point3<f64> {
    corner(key, slot as u16, voxel) + Vector3::repeat(0.5 * voxel)
}
