//! Marks of a planar scan: its beams are all about one height, so that two bits a cell say all of it.

use super::mark::{Heights, Mark};
use super::read::TILE;
use percept_geometry::Cell;

/// Rows of a tile, and columns: a word a row.
pub(super) const ROWS: usize = TILE as usize;
/// Words behind the last row, so that eight rows from any on can be taken at once.
const BEHIND: usize = 8;

/// Marks on the cells of a rectangle of whole tiles.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct PlanarMarks {
    /// What free and hit cells are about.
    pub(super) heights: Heights,
    /// Column and row of the first tile.
    first: (i32, i32),
    /// Tiles along x and y.
    size: (usize, usize),
    /// A bit a cell, 64 columns a word; the words of all rows of one column of tiles, then those of the next. Cells that were hit are
    /// not free as well.
    pub(super) free: Vec<u64>,
    pub(super) hit: Vec<u64>,
    /// Cells that the robot's body came through. They are neither free nor hit.
    pub(super) driven: Vec<(Cell, Heights)>,
}

/// The marks of one tile, a word a row.
pub(super) struct PlanarTile<'a> {
    pub(super) key: (i32, i32),
    pub(super) free: &'a [u64],
    pub(super) hit: &'a [u64],
}

impl PlanarMarks {
    /// No marks, of the tiles that hold cells from `low` to `high`, both included.
    pub(super) fn new(heights: Heights, low: Cell, high: Cell) -> Self {
        let tiles = |low: i32, high: i32| ((high >> 6) - (low >> 6)).max(0) as usize + 1;
        let size = (tiles(low.x, high.x), tiles(low.y, high.y));
        let none = || vec![0; size.0 * size.1 * ROWS + BEHIND];
        Self { heights, first: (low.x >> 6, low.y >> 6), size, free: none(), hit: none(), driven: vec![] }
    }

    /// The first cell of the rectangle.
    pub(super) fn first(&self) -> Cell {
        Cell::new(self.first.0 * TILE, self.first.1 * TILE)
    }

    /// Rows of the rectangle: how far words lie apart whose cells are 64 columns apart.
    pub(super) fn height(&self) -> usize {
        self.size.1 * ROWS
    }

    /// The word of a cell, and its bit there; none outside of the rectangle.
    #[inline]
    fn locate(&self, cell: Cell) -> Option<(usize, u64)> {
        let column = usize::try_from((cell.x >> 6) - self.first.0).ok()?;
        let row = usize::try_from(i64::from(cell.y) - i64::from(self.first.1) * i64::from(TILE)).ok()?;
        (column < self.size.0 && row < self.height()).then(|| (column * self.height() + row, 1 << (cell.x & 63)))
    }

    /// Adds a mark, as [`Mark::joined`] does; where the robot drove is marked last.
    #[inline]
    pub(super) fn mark(&mut self, cell: Cell, mark: Mark) {
        let at = self.locate(cell);
        if let Mark::Driven(heights) = mark {
            self.driven.push((cell, heights));
        }
        let Some((word, bit)) = at else { return };
        let (free, hit) = (&mut self.free[word], &mut self.hit[word]);
        match mark {
            Mark::Unseen | Mark::Over(_) => {}
            Mark::Free(_) => *free |= bit & !*hit,
            Mark::Hit(_) => {
                *hit |= bit;
                *free &= !bit;
            }
            Mark::Driven(_) => {
                *free &= !bit;
                *hit &= !bit;
            }
        }
    }

    /// What a cell is marked as.
    pub(super) fn at(&self, cell: Cell) -> Mark {
        if let Some((_, heights)) = self.driven.iter().find(|(c, _)| *c == cell) {
            return Mark::Driven(*heights);
        }
        match self.locate(cell) {
            Some((word, bit)) if self.hit[word] & bit != 0 => Mark::Hit(self.heights),
            Some((word, bit)) if self.free[word] & bit != 0 => Mark::Free(self.heights),
            _ => Mark::Unseen,
        }
    }

    /// The tiles in which cells are free or hit.
    pub(super) fn tiles(&self) -> impl Iterator<Item = PlanarTile<'_>> {
        let places = (0..self.size.0).flat_map(|x| (0..self.size.1).map(move |y| (x, y)));
        let tile = move |(x, y): (usize, usize)| {
            let words = (x * self.size.1 + y) * ROWS..(x * self.size.1 + y + 1) * ROWS;
            let key = (self.first.0 + x as i32, self.first.1 + y as i32);
            PlanarTile { key, free: &self.free[words.clone()], hit: &self.hit[words] }
        };
        places.map(tile).filter(|tile| tile.free.iter().chain(tile.hit).fold(0, |any, word| any | word) != 0)
    }
}

impl PlanarTile<'_> {
    /// Shows the marked cells of a row.
    pub(super) fn visit_row(&self, row: usize, heights: Heights, mut visit: impl FnMut(usize, Mark)) {
        ones(self.free[row], |x| visit(x, Mark::Free(heights)));
        ones(self.hit[row], |x| visit(x, Mark::Hit(heights)));
    }

    /// The smallest and the largest column and row with a mark, both included.
    pub(super) fn bounds(&self) -> Option<(Cell, Cell)> {
        let any = |row: &usize| self.free[*row] | self.hit[*row];
        let marked = |row: &usize| any(row) != 0;
        let (first, last) = ((0..ROWS).find(marked)?, (0..ROWS).rfind(marked)?);
        let columns = (first..=last).fold(0, |all, row| all | any(&row));
        let cell = |x: u32, y: usize| Cell::new(self.key.0 * TILE + x as i32, self.key.1 * TILE + y as i32);
        Some((cell(columns.trailing_zeros(), first), cell(63 - columns.leading_zeros(), last)))
    }
}

/// The places of bits that are set, the lowest first.
#[inline]
pub(super) fn ones(mut bits: u64, mut visit: impl FnMut(usize)) {
    while bits != 0 {
        visit(bits.trailing_zeros() as usize);
        bits &= bits - 1;
    }
}
