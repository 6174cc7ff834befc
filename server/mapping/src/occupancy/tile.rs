//! A tile of evidence: open while it is filled, packed once it is not.

use super::OccupancyParams;
use super::evidence::Evidence;
use super::read::TILE;
use crate::bytes::{Damaged, Reader, put_u32, put_u64};
use std::collections::HashMap;

const CELLS: usize = (TILE * TILE) as usize;

/// A tile, row-major `TILE x TILE`.
#[derive(Debug, Clone, Default)]
pub(super) enum EvidenceTile {
    /// Nothing was seen.
    #[default]
    Empty,
    /// Every cell.
    Open(Vec<Evidence>),
    /// Each kind of evidence once, and which one a cell has: cells of a tile are much alike.
    Packed(Vec<Evidence>, Vec<u16>),
    /// The same, of at most 256 kinds.
    Narrow(Vec<Evidence>, Vec<u8>),
}

impl EvidenceTile {
    /// What is known of a cell.
    pub(super) fn at(&self, slot: usize) -> Option<&Evidence> {
        match self {
            Self::Empty => None,
            Self::Open(cells) => cells.get(slot),
            Self::Packed(kinds, index) => kinds.get(usize::from(*index.get(slot)?)),
            Self::Narrow(kinds, index) => kinds.get(usize::from(*index.get(slot)?)),
        }
    }

    /// Opens it.
    pub(super) fn cells(&mut self, params: &OccupancyParams) -> &mut [Evidence] {
        if !matches!(self, Self::Open(_)) {
            let none = Evidence::none(params);
            *self = Self::Open((0..CELLS).map(|slot| self.at(slot).copied().unwrap_or(none)).collect());
        }
        match self {
            Self::Open(cells) => cells,
            _ => &mut [],
        }
    }

    /// The same cells in less memory.
    pub(super) fn packed(&self, params: &OccupancyParams) -> Self {
        let none = Evidence::none(params);
        let (mut kinds, mut index) = (Vec::new(), Vec::with_capacity(CELLS));
        let mut known: HashMap<[u64; 6], u16> = HashMap::new();
        let mut last: Option<([u64; 6], u16)> = None;
        for slot in 0..CELLS {
            let cell = self.at(slot).unwrap_or(&none);
            let bits = cell.bits();
            let kind = last.filter(|l| l.0 == bits).map_or_else(
                || {
                    *known.entry(bits).or_insert_with(|| {
                        kinds.push(*cell);
                        (kinds.len() - 1) as u16
                    })
                },
                |l| l.1,
            );
            last = Some((bits, kind));
            index.push(kind);
        }
        kinds.shrink_to_fit();
        if kinds.len() <= 256 {
            Self::Narrow(kinds, index.iter().map(|k| *k as u8).collect())
        } else {
            Self::Packed(kinds, index)
        }
    }

    pub(super) fn same_cells(&self, other: &Self) -> bool {
        (0..CELLS).all(|slot| self.at(slot).map(Evidence::bits) == other.at(slot).map(Evidence::bits))
    }

    /// What it takes, bytes.
    pub(super) fn memory_bytes(&self) -> usize {
        let (kinds, index) = match self {
            Self::Empty => (0, 0),
            Self::Open(cells) => (cells.len(), 0),
            Self::Packed(kinds, index) => (kinds.len(), 2 * index.len()),
            Self::Narrow(kinds, index) => (kinds.len(), index.len()),
        };
        kinds * size_of::<Evidence>() + index
    }

    /// As bytes; packs it for that.
    pub(super) fn encode(&self, params: &OccupancyParams, out: &mut Vec<u8>) {
        let packed;
        let (kinds, index) = match self {
            Self::Packed(kinds, index) => (kinds, index.clone()),
            Self::Narrow(kinds, index) => (kinds, index.iter().map(|k| u16::from(*k)).collect()),
            Self::Empty | Self::Open(_) => {
                packed = self.packed(params);
                return packed.encode(params, out);
            }
        };
        put_u32(out, kinds.len() as u32);
        kinds.iter().flat_map(|k| k.bits()).for_each(|v| put_u64(out, v));
        // Runs of a kind: how many, and which.
        let runs: Vec<&[u16]> = index.chunk_by(|a, b| a == b).collect();
        put_u32(out, runs.len() as u32);
        for run in runs {
            put_u32(out, (run.len() as u32) << 16 | u32::from(run[0]));
        }
    }

    pub(super) fn decode(from: &mut Reader<'_>) -> Result<Self, Damaged> {
        let num_kinds = from.count(CELLS)?;
        let mut kinds = Vec::with_capacity(num_kinds);
        for _ in 0..num_kinds {
            let mut bits = [0; 6];
            for word in &mut bits {
                *word = from.u64()?;
            }
            kinds.push(Evidence::of_bits(bits));
        }
        let mut index: Vec<u16> = Vec::with_capacity(CELLS);
        for _ in 0..from.count(CELLS)? {
            let run = from.u32()?;
            let (length, kind) = ((run >> 16) as usize, (run & 0xffff) as u16);
            if usize::from(kind) >= kinds.len() || index.len() + length > CELLS {
                return Err(Damaged);
            }
            index.extend(std::iter::repeat_n(kind, length));
        }
        if index.len() != CELLS {
            return Err(Damaged);
        }
        Ok(if kinds.len() <= 256 {
            Self::Narrow(kinds, index.iter().map(|k| *k as u8).collect())
        } else {
            Self::Packed(kinds, index)
        })
    }
}
