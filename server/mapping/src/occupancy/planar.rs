//! Marks of a planar scan: its beams are all about one height, so that two bits a cell say all of it.

use super::mark::{Heights, Mark};
use super::read::TILE;
use percept_geometry::Cell;

/// Rows of a tile, and columns: a word a row.
const ROWS: usize = TILE as usize;

/// Marks on the cells of a square window, in the grid's tiles that anything was marked in.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct PlanarMarks {
    /// What free and hit cells are about.
    pub(super) heights: Heights,
    /// Column and row of the window's first tile, and tiles along its edge.
    first: (i32, i32),
    side: usize,
    /// Row-major `side x side`: one more than the tile's place among those that are there; 0 of one that is not.
    index: Vec<u32>,
    pub(super) tiles: Vec<PlanarTile>,
    /// Cells that the robot's body came through. They are neither free nor hit.
    pub(super) driven: Vec<(Cell, Heights)>,
}

/// A bit a cell, by row.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct PlanarTile {
    pub(super) key: (i32, i32),
    pub(super) free: [u64; ROWS],
    pub(super) hit: [u64; ROWS],
}

impl PlanarMarks {
    /// No marks, of a window of `width` cells from `min`.
    pub(super) fn new(heights: Heights, min: Cell, width: usize) -> Self {
        let first = (min.x.div_euclid(TILE), min.y.div_euclid(TILE));
        // A window of w cells reaches into at most so many tiles.
        let side = width.div_ceil(ROWS) + 1;
        Self { heights, first, side, index: vec![0; side * side], tiles: vec![], driven: vec![] }
    }

    /// The place of a cell's tile in the index, its row, and its bit there.
    #[inline]
    fn locate(&self, cell: Cell) -> (usize, usize, u64) {
        let (column, row) = ((cell.x >> 6) - self.first.0, (cell.y >> 6) - self.first.1);
        (row as usize * self.side + column as usize, (cell.y & 63) as usize, 1 << (cell.x & 63))
    }

    /// Adds a mark of a cell of the window, as [`Mark::joined`] does; where the robot drove is marked last.
    #[inline]
    pub(super) fn mark(&mut self, cell: Cell, mark: Mark) {
        let (place, row, bit) = self.locate(cell);
        if self.index[place] == 0 {
            self.open(place, (cell.x >> 6, cell.y >> 6));
        }
        let tile = &mut self.tiles[self.index[place] as usize - 1];
        match mark {
            Mark::Unseen | Mark::Over(_) => {}
            Mark::Free(_) => tile.free[row] |= bit,
            Mark::Hit(_) => tile.hit[row] |= bit,
            Mark::Driven(heights) => {
                tile.free[row] &= !bit;
                tile.hit[row] &= !bit;
                self.driven.push((cell, heights));
            }
        }
    }

    #[cold]
    fn open(&mut self, place: usize, key: (i32, i32)) {
        self.tiles.push(PlanarTile { key, free: [0; ROWS], hit: [0; ROWS] });
        self.index[place] = self.tiles.len() as u32;
    }

    /// What a cell of the window is marked as.
    pub(super) fn at(&self, cell: Cell) -> Mark {
        if let Some((_, heights)) = self.driven.iter().find(|(c, _)| *c == cell) {
            return Mark::Driven(*heights);
        }
        let (place, row, bit) = self.locate(cell);
        match (self.index[place] as usize).checked_sub(1).map(|i| &self.tiles[i]) {
            Some(tile) if tile.hit[row] & bit != 0 => Mark::Hit(self.heights),
            Some(tile) if tile.free[row] & bit != 0 => Mark::Free(self.heights),
            _ => Mark::Unseen,
        }
    }
}

impl PlanarTile {
    /// Shows the marked cells of a row, those that were hit after those that are free.
    pub(super) fn visit_row(&self, row: usize, heights: Heights, mut visit: impl FnMut(usize, Mark)) {
        let (hit, mut free) = (self.hit[row], self.free[row] & !self.hit[row]);
        while free != 0 {
            visit(free.trailing_zeros() as usize, Mark::Free(heights));
            free &= free - 1;
        }
        let mut hit = hit;
        while hit != 0 {
            visit(hit.trailing_zeros() as usize, Mark::Hit(heights));
            hit &= hit - 1;
        }
    }

    /// The first and the last marked column of a row.
    pub(super) fn columns(&self, row: usize) -> Option<(i32, i32)> {
        let any = self.free[row] | self.hit[row];
        (any != 0).then(|| (any.trailing_zeros() as i32, 63 - any.leading_zeros() as i32))
    }
}
