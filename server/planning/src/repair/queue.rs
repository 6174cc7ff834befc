//! The open list of a search that goes on: entries may be void, and are sorted out when they come up.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Cost with the estimate to the start, cost alone: the smaller is expanded first.
pub(super) type Key = (u64, u64);

/// Cells by key, the smallest first; of equals the one of the smaller index.
#[derive(Debug, Clone, Default)]
pub(super) struct OpenList {
    heap: BinaryHeap<Reverse<(Key, u32)>>,
}

impl OpenList {
    pub(super) fn push(&mut self, key: Key, index: usize) {
        self.heap.push(Reverse((key, index as u32)));
    }

    pub(super) fn pop(&mut self) {
        self.heap.pop();
    }

    pub(super) fn peek(&self) -> Option<(Key, usize)> {
        self.heap.peek().map(|Reverse((key, index))| (*key, *index as usize))
    }

    pub(super) fn len(&self) -> usize {
        self.heap.len()
    }

    /// Takes all cells out, each once, ascending.
    pub(super) fn take_cells(&mut self) -> Vec<usize> {
        let mut out: Vec<usize> = self.heap.drain().map(|Reverse((_, index))| index as usize).collect();
        out.sort_unstable();
        out.dedup();
        out
    }
}
