//! A submap's surface as bytes: what is known of each block, and what was seen through.

use super::block::{Colors, ONE, SurfaceBlock, VOXELS};
use super::touched::MOST_BLOCKS;
use super::{SurfaceGrid, SurfaceParams};
use crate::blocks::BlockKey;
use crate::bytes::{Damaged, Reader, put_i32, put_u16, put_u32, put_u64};
use crate::cloud::free::{Count, FreeSpace};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Blocks of a stored part; bounds what damaged bytes may ask for.
const MAX_BLOCKS: usize = 1 << 22;
/// Whether a block has colours.
const COLORED: u16 = 1;

pub(super) fn encode(grid: &SurfaceGrid, out: &mut Vec<u8>) {
    put_u32(out, grid.blocks.len() as u32);
    for (key, block) in grid.blocks.iter() {
        put_key(out, *key);
        put_u16(out, if block.color.is_some() { COLORED } else { 0 });
        let known = |slot: &usize| block.weight[*slot] > 0;
        for word in 0..VOXELS / 64 {
            let bits = (0..64).filter(|bit| known(&(word * 64 + bit))).fold(0u64, |all, bit| all | 1 << bit);
            put_u64(out, bits);
        }
        for slot in (0..VOXELS).filter(known) {
            put_u16(out, block.distance[slot] as u16);
            put_u16(out, block.weight[slot]);
            for channel in block.color.iter().flat_map(|c| c.iter()) {
                put_u16(out, channel[slot]);
            }
        }
    }
    put_u32(out, grid.free.blocks.len() as u32);
    for (key, count) in grid.free.blocks.iter() {
        put_key(out, *key);
        count.as_flattened().iter().for_each(|word| put_u64(out, *word));
    }
}

pub(super) fn decode(params: &SurfaceParams, from: &mut Reader<'_>) -> Result<SurfaceGrid, Damaged> {
    // They come in order, of which a tree is built at once.
    let (mut blocks, mut free) = (vec![], vec![]);
    for _ in 0..from.count(MAX_BLOCKS)? {
        let key = take_key(from, blocks.last().map(|b: &(BlockKey, _)| b.0))?;
        blocks.push((key, Arc::new(take_block(from)?)));
    }
    for _ in 0..from.count(MAX_BLOCKS)? {
        let key = take_key(from, free.last().map(|b: &(BlockKey, _)| b.0))?;
        let mut count = Count::default();
        for word in count.as_flattened_mut() {
            *word = from.u64()?;
        }
        free.push((key, Arc::new(count)));
    }
    let free = FreeSpace { blocks: Arc::new(BTreeMap::from_iter(free)) };
    Ok(SurfaceGrid::of_blocks(*params, BTreeMap::from_iter(blocks), free))
}

fn take_block(from: &mut Reader<'_>) -> Result<SurfaceBlock, Damaged> {
    let flags = from.u16()?;
    if flags > COLORED {
        return Err(Damaged);
    }
    let mut known = [0u64; VOXELS / 64];
    for word in &mut known {
        *word = from.u64()?;
    }
    let mut block = SurfaceBlock::unknown();
    let mut colors: Option<Box<Colors>> = (flags == COLORED).then(|| Box::new([[0; VOXELS]; 3]));
    for slot in (0..VOXELS).filter(|slot| known[slot / 64] >> (slot % 64) & 1 == 1) {
        block.distance[slot] = from.u16()? as i16;
        block.weight[slot] = from.u16()?;
        if block.weight[slot] == 0 || f32::from(block.distance[slot]) < -ONE {
            return Err(Damaged);
        }
        for channel in colors.iter_mut().flat_map(|c| c.iter_mut()) {
            channel[slot] = from.u16()?;
        }
    }
    block.color = colors;
    Ok(block)
}

fn put_key(out: &mut Vec<u8>, key: BlockKey) {
    [key.0, key.1, key.2].iter().for_each(|v| put_i32(out, *v));
}

/// A key after the one before.
fn take_key(from: &mut Reader<'_>, before: Option<BlockKey>) -> Result<BlockKey, Damaged> {
    let key = (from.i32()?, from.i32()?, from.i32()?);
    let is_sound = [key.0, key.1, key.2].iter().all(|v| f64::from(*v).abs() <= MOST_BLOCKS);
    if is_sound && before.is_none_or(|before| before < key) { Ok(key) } else { Err(Damaged) }
}
