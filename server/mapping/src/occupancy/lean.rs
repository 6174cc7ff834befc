//! An open tile of which planar scans alone know something, or that was packed before: a number a cell.

use super::OccupancyParams;
use super::evidence::Evidence;
use super::kinds::{Kinds, Step};
use super::mark::{Heights, Mark};
use super::planar::{PlanarTile, ROWS};
use std::sync::Arc;

const CELLS: usize = ROWS * ROWS;

/// Each cell's kind of evidence, row-major `64 x 64`.
#[derive(Debug, Clone)]
pub(super) struct LeanTile {
    kinds: Vec<u16>,
    /// A bit a cell, a word a row: what is as free as it can be already, for planar marks of these heights. Most of what a robot sees
    /// free it has seen free often.
    settled: [u64; ROWS],
    settled_for: Heights,
}

impl LeanTile {
    /// Of kinds of evidence, and which of them a cell has; none if the grid has no numbers for that.
    pub(super) fn new(grid: &mut Arc<Kinds>, kinds: &[Evidence], cells: impl Iterator<Item = usize>) -> Option<Self> {
        if !grid.has_room(CELLS) {
            return None;
        }
        let numbers: Vec<u16> = kinds.iter().map(|evidence| number(grid, evidence)).collect();
        Some(Self { kinds: cells.map(|kind| numbers[kind]).collect(), settled: [0; ROWS], settled_for: Heights::NONE })
    }

    /// What is known of a cell.
    pub(super) fn at<'a>(&self, grid: &'a Kinds, slot: usize) -> Option<&'a Evidence> {
        grid.get(*self.kinds.get(slot)?)
    }

    /// Adds planar marks; the grid has to have numbers for as many kinds as there are cells.
    pub(super) fn add(
        &mut self,
        grid: &mut Arc<Kinds>,
        marks: &PlanarTile<'_>,
        heights: Heights,
        params: &OccupancyParams,
    ) {
        if self.settled_for != heights {
            (self.settled, self.settled_for) = ([0; ROWS], heights);
        }
        for row in 0..ROWS {
            let (mut free, mut hit) = (marks.free[row] & !self.settled[row], marks.hit[row]);
            if free | hit == 0 {
                continue;
            }
            // What was hit is not settled.
            self.settled[row] &= !hit;
            let cells = &mut self.kinds[row * ROWS..][..ROWS];
            while let Some(kind) = step(cells, &mut free, &mut self.settled[row], grid.steps(heights).0) {
                Arc::make_mut(grid).learn(kind, Mark::Free(heights), params);
            }
            while let Some(kind) = step(cells, &mut hit, &mut 0, grid.steps(heights).1) {
                Arc::make_mut(grid).learn(kind, Mark::Hit(heights), params);
            }
        }
    }

    /// Adds another mark to a cell; the grid has to have a number for one more kind.
    pub(super) fn add_at(&mut self, grid: &mut Arc<Kinds>, slot: usize, mark: Mark, params: &OccupancyParams) {
        let Some(mut evidence) = self.at(grid, slot).copied() else { return };
        evidence.add(mark, true, params);
        self.kinds[slot] = number(grid, &evidence);
        self.settled[slot / ROWS] &= !(1 << (slot % ROWS));
    }

    /// What it takes, bytes.
    pub(super) fn memory_bytes(&self) -> usize {
        size_of::<Self>() + size_of_val(&self.kinds[..])
    }
}

/// The number of a kind. Copies of a grid share what is known already.
fn number(grid: &mut Arc<Kinds>, evidence: &Evidence) -> u16 {
    grid.find(evidence).unwrap_or_else(|| Arc::make_mut(grid).number(evidence))
}

/// Moves the marked cells of a row on. The kind of the first one of which it is not known where to, which is still marked then.
#[inline]
fn step(cells: &mut [u16], marked: &mut u64, settled: &mut u64, steps: &[Step]) -> Option<u16> {
    while *marked != 0 {
        let x = marked.trailing_zeros() as usize;
        let cell = &mut cells[x];
        let step = steps.get(usize::from(*cell)).filter(|step| step.is_known());
        let Some(step) = step else { return Some(*cell) };
        *cell = step.kind();
        *settled |= step.settled() << x;
        *marked &= *marked - 1;
    }
    None
}

#[cfg(test)]
mod tests;
