//! A tile of cells, of which only those are held that are known.

use super::HeightParams;
use super::bits::Bits;
use super::cell::{Cell, Pass};
use crate::bytes::{Damaged, Reader, put_f32, put_u16, put_u32, put_u64};
use crate::occupancy::TILE;

/// Rows of a tile, and cells.
const ROWS: usize = TILE as usize;
pub(super) const CELLS: usize = ROWS * ROWS;
/// Edge of a block, whose cells share where beams passed, cells.
pub(super) const BLOCK: i32 = 2;
/// Blocks along a tile's edge, and all of them.
const BLOCKS: usize = (TILE / BLOCK) as usize;
pub(super) const NUM_BLOCKS: usize = BLOCKS * BLOCKS;

/// A tile, row-major `64 x 64`, never changed: what a keyframe adds makes another one.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Tile {
    /// A bit a known cell, and how many there are in the rows before.
    known: [u64; ROWS],
    before: [u16; ROWS],
    /// Those, in the order of their slots.
    cells: Vec<Cell>,
    /// One a block, row-major `32 x 32`; empty if no beam passed.
    passes: Vec<Pass>,
}

/// What a keyframe says of a tile.
#[derive(Debug, Clone)]
pub(super) struct Seen {
    /// By slot, ascending.
    pub(super) cells: Vec<(u16, Cell)>,
    /// By block: heights at which beams passed, and that of the ground, metres.
    pub(super) passes: Vec<(u16, Bits, f32)>,
}

/// The block of a slot.
pub(super) fn block_of(slot: usize) -> usize {
    let edge = BLOCK as usize;
    slot / ROWS / edge * BLOCKS + slot % ROWS / edge
}

impl Tile {
    pub(super) const EMPTY: Self = Self { known: [0; ROWS], before: [0; ROWS], cells: vec![], passes: vec![] };

    pub(super) fn at(&self, slot: usize) -> Option<&Cell> {
        let (row, bit) = (slot / ROWS, 1u64 << (slot % ROWS));
        let word = *self.known.get(row)?;
        if word & bit == 0 {
            return None;
        }
        self.cells.get(usize::from(self.before[row]) + (word & (bit - 1)).count_ones() as usize)
    }

    pub(super) fn pass(&self, slot: usize) -> &Pass {
        self.passes.get(block_of(slot)).unwrap_or(&Pass::NONE)
    }

    /// Known cells with their slots, ascending.
    pub(super) fn iter(&self) -> impl Iterator<Item = (usize, &Cell)> {
        let slots = self.known.iter().enumerate().flat_map(|(row, word)| {
            let bits =
                std::iter::successors(Some(*word).filter(|w| *w != 0), |w| Some(w & (w - 1)).filter(|w| *w != 0));
            bits.map(move |w| row * ROWS + w.trailing_zeros() as usize)
        });
        slots.zip(&self.cells)
    }

    /// The same after a keyframe.
    pub(super) fn with(&self, seen: &Seen, params: &HeightParams) -> Self {
        let mut passes = self.passes.clone();
        if passes.is_empty() && !seen.passes.is_empty() {
            passes = vec![Pass::NONE; NUM_BLOCKS];
        }
        let mut passed = [Bits::NONE; NUM_BLOCKS];
        for (block, bits, z) in &seen.passes {
            passed[usize::from(*block)] = *bits;
            passes[usize::from(*block)].add(*bits, *z);
        }
        let pass_of = |slot: usize| passes.get(block_of(slot)).unwrap_or(&Pass::NONE);
        let mut cells = Vec::with_capacity(self.cells.len() + seen.cells.len());
        let (mut old, mut new) = (self.iter().peekable(), seen.cells.iter().peekable());
        loop {
            let slot = match (old.peek(), new.peek()) {
                (None, None) => break,
                (Some((slot, _)), None) => *slot,
                (None, Some((slot, _))) => usize::from(*slot),
                (Some((a, _)), Some((b, _))) => (*a).min(usize::from(*b)),
            };
            let before = old.next_if(|(s, _)| *s == slot).map(|(_, cell)| *cell);
            let cell = match (before, new.next_if(|(s, _)| usize::from(*s) == slot)) {
                (before, Some((_, seen))) => {
                    let mut cell = before.unwrap_or(Cell::unknown(seen.z));
                    cell.look(seen, passed[block_of(slot)], pass_of(slot), params);
                    cell
                }
                (Some(mut cell), None) => {
                    cell.pass(passed[block_of(slot)]);
                    cell
                }
                (None, None) => continue,
            };
            cells.push((slot, cell));
        }
        Self::of(cells.into_iter().filter(|(_, cell)| cell.is_known()), passes)
    }

    /// Of cells by slot, ascending.
    fn of(slots: impl Iterator<Item = (usize, Cell)>, passes: Vec<Pass>) -> Self {
        let mut known = [0u64; ROWS];
        let mut cells = Vec::with_capacity(slots.size_hint().1.unwrap_or(0));
        for (slot, cell) in slots {
            known[slot / ROWS] |= 1 << (slot % ROWS);
            cells.push(cell);
        }
        Self { known, before: Self::counted(&known), cells, passes }
    }

    fn counted(known: &[u64; ROWS]) -> [u16; ROWS] {
        let mut count = 0;
        known.map(|word| {
            count += word.count_ones() as u16;
            count - word.count_ones() as u16
        })
    }

    /// Takes no more memory than it needs.
    pub(super) fn packed(&self) -> Self {
        let mut out = self.clone();
        out.cells.shrink_to_fit();
        out
    }

    /// What it takes, bytes.
    pub(super) fn memory_bytes(&self) -> usize {
        let passes = self.passes.capacity() * size_of::<Pass>();
        size_of::<Self>() + self.cells.capacity() * size_of::<Cell>() + passes
    }

    pub(super) fn encode(&self, out: &mut Vec<u8>) {
        self.known.iter().for_each(|word| put_u64(out, *word));
        for cell in &self.cells {
            [cell.z, cell.variance, cell.top, cell.overhang].iter().for_each(|v| put_f32(out, *v));
            put_u32(out, cell.standing.0);
            put_u16(out, cell.num);
            out.extend_from_slice(&[cell.drops, cell.evidence]);
        }
        let passes = || self.passes.iter().enumerate().filter(|(_, pass)| pass.num > 0);
        put_u32(out, passes().count() as u32);
        for (block, pass) in passes() {
            put_u16(out, block as u16);
            put_u32(out, pass.once.0);
            put_u32(out, pass.often.0);
            put_f32(out, pass.z);
            out.push(pass.num);
        }
    }

    pub(super) fn decode(from: &mut Reader<'_>) -> Result<Self, Damaged> {
        let mut known = [0; ROWS];
        for word in &mut known {
            *word = from.u64()?;
        }
        let num: usize = known.iter().map(|word| word.count_ones() as usize).sum();
        if num > from.len() {
            return Err(Damaged);
        }
        let cells = (0..num).map(|_| cell(from)).collect::<Result<_, _>>()?;
        let num_passes = from.count(NUM_BLOCKS)?;
        let mut passes = vec![Pass::NONE; if num_passes > 0 { NUM_BLOCKS } else { 0 }];
        for _ in 0..num_passes {
            let block = usize::from(from.u16()?);
            let (once, often) = (Bits(from.u32()?), Bits(from.u32()?));
            let pass = Pass { once, often, z: from.f32()?, num: from.u8()? };
            if !pass.z.is_finite() || pass.num == 0 {
                return Err(Damaged);
            }
            *passes.get_mut(block).ok_or(Damaged)? = pass;
        }
        Ok(Self { known, before: Self::counted(&known), cells, passes })
    }
}

fn cell(from: &mut Reader<'_>) -> Result<Cell, Damaged> {
    let [z, variance, top, overhang] = [from.f32()?, from.f32()?, from.f32()?, from.f32()?];
    let standing = Bits(from.u32()?);
    let cell = Cell { z, variance, top, overhang, standing, num: from.u16()?, drops: from.u8()?, evidence: from.u8()? };
    let is_sound = z.is_finite()
        && variance > 0.0
        && (cell.num == 0 || variance.is_finite())
        && !top.is_infinite()
        && top.is_nan() == standing.is_empty()
        && !overhang.is_infinite()
        && cell.is_known();
    is_sound.then_some(cell).ok_or(Damaged)
}
