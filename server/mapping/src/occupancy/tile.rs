//! A tile of evidence: open while it is filled, packed once it is not.

use super::OccupancyParams;
use super::evidence::Evidence;
use super::kinds::Kinds;
use super::lean::LeanTile;
use super::mark::{Heights, Mark};
use super::planar::PlanarTile;
use super::read::TILE;
use crate::bytes::{Damaged, Reader, put_u32, put_u64};
use std::collections::HashMap;
use std::sync::Arc;

const CELLS: usize = (TILE * TILE) as usize;

/// A tile, row-major `TILE x TILE`.
#[derive(Debug, Clone, Default)]
pub(super) enum EvidenceTile {
    /// Nothing was seen.
    #[default]
    Empty,
    /// Every cell.
    Open(Vec<Evidence>),
    /// Every cell, for planar marks; what the numbers mean, the grid knows.
    Lean(LeanTile),
    /// Each kind of evidence once, and which one a cell has: cells of a tile are much alike.
    Packed(Vec<Evidence>, Vec<u16>),
    /// The same, of at most 256 kinds.
    Narrow(Vec<Evidence>, Vec<u8>),
}

impl EvidenceTile {
    /// What is known of a cell, in a grid of these kinds.
    pub(super) fn at<'a>(&'a self, grid: &'a Kinds, slot: usize) -> Option<&'a Evidence> {
        match self {
            Self::Empty => None,
            Self::Open(cells) => cells.get(slot),
            Self::Lean(tile) => tile.at(grid, slot),
            Self::Packed(kinds, index) => kinds.get(usize::from(*index.get(slot)?)),
            Self::Narrow(kinds, index) => kinds.get(usize::from(*index.get(slot)?)),
        }
    }

    /// Opens it.
    pub(super) fn cells(&mut self, grid: &Kinds, params: &OccupancyParams) -> &mut [Evidence] {
        if !matches!(self, Self::Open(_)) {
            let none = Evidence::none(params);
            *self = Self::Open((0..CELLS).map(|slot| self.at(grid, slot).copied().unwrap_or(none)).collect());
        }
        match self {
            Self::Open(cells) => cells,
            _ => &mut [],
        }
    }

    /// Opens it for planar marks, unless every cell is open or the grid has not got as many numbers as that may take.
    fn lean(&mut self, grid: &mut Arc<Kinds>, params: &OccupancyParams) -> Option<&mut LeanTile> {
        match self {
            Self::Empty => {
                *self = Self::Lean(LeanTile::new(grid, &[Evidence::none(params)], std::iter::repeat_n(0, CELLS))?);
            }
            Self::Packed(kinds, index) => {
                *self = Self::Lean(LeanTile::new(grid, kinds, index.iter().map(|k| usize::from(*k)))?);
            }
            Self::Narrow(kinds, index) => {
                *self = Self::Lean(LeanTile::new(grid, kinds, index.iter().map(|k| usize::from(*k)))?);
            }
            Self::Open(_) | Self::Lean(_) => {}
        }
        match self {
            Self::Lean(tile) if grid.has_room(CELLS) => Some(tile),
            _ => None,
        }
    }

    /// Adds planar marks.
    pub(super) fn add(
        &mut self,
        grid: &mut Arc<Kinds>,
        marks: &PlanarTile<'_>,
        heights: Heights,
        params: &OccupancyParams,
    ) {
        if let Some(tile) = self.lean(grid, params) {
            return tile.add(grid, marks, heights, params);
        }
        for (row, cells) in self.cells(grid, params).chunks_mut(TILE as usize).enumerate() {
            marks.visit_row(row, heights, |x, mark| cells[x].add(mark, true, params));
        }
    }

    /// Adds a planar scan's mark to one cell, and says whether something is known of it then.
    pub(super) fn add_at(&mut self, grid: &mut Arc<Kinds>, slot: usize, mark: Mark, params: &OccupancyParams) -> bool {
        match self.lean(grid, params) {
            Some(tile) => tile.add_at(grid, slot, mark, params),
            None => self.cells(grid, params)[slot].add(mark, true, params),
        }
        self.at(grid, slot).is_some_and(|evidence| !evidence.log_odds.is_nan())
    }

    /// The same cells in less memory.
    pub(super) fn packed(&self, grid: &Kinds, params: &OccupancyParams) -> Self {
        let none = Evidence::none(params);
        let (mut kinds, mut index) = (Vec::new(), Vec::with_capacity(CELLS));
        let mut known: HashMap<[u64; 6], u16> = HashMap::new();
        let mut last: Option<([u64; 6], u16)> = None;
        for slot in 0..CELLS {
            let cell = self.at(grid, slot).unwrap_or(&none);
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

    /// Whether every cell is equal, each tile in a grid of its own kinds.
    pub(super) fn same_cells(&self, grid: &Kinds, other: &Self, other_grid: &Kinds) -> bool {
        let bits = |tile: &Self, grid, slot| tile.at(grid, slot).map(Evidence::bits);
        (0..CELLS).all(|slot| bits(self, grid, slot) == bits(other, other_grid, slot))
    }

    /// What it takes, bytes.
    pub(super) fn memory_bytes(&self) -> usize {
        let (kinds, index) = match self {
            Self::Empty => (0, 0),
            Self::Open(cells) => (cells.len(), 0),
            Self::Lean(tile) => (0, tile.memory_bytes()),
            Self::Packed(kinds, index) => (kinds.len(), 2 * index.len()),
            Self::Narrow(kinds, index) => (kinds.len(), index.len()),
        };
        kinds * size_of::<Evidence>() + index
    }

    /// As bytes; packs it for that.
    pub(super) fn encode(&self, grid: &Kinds, params: &OccupancyParams, out: &mut Vec<u8>) {
        let packed;
        let (kinds, index) = match self {
            Self::Packed(kinds, index) => (kinds, index.clone()),
            Self::Narrow(kinds, index) => (kinds, index.iter().map(|k| u16::from(*k)).collect()),
            Self::Empty | Self::Open(_) | Self::Lean(_) => {
                packed = self.packed(grid, params);
                return packed.encode(grid, params, out);
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
