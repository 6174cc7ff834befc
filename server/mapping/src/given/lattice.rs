//! Places all over a map from which it is looked at.

use percept_geometry::Cell;
use std::collections::BTreeMap;

/// The best place of each square of a lattice: the one of the largest clearance, of several the first; in an order in which
/// squares near each other follow on each other. `places` are cells with their clearance, `edge` cells make a square.
pub(super) fn best_of_squares(places: impl Iterator<Item = (Cell, f32)>, edge: i32) -> Vec<Cell> {
    let mut best: BTreeMap<(i32, i32), (Cell, f32)> = BTreeMap::new();
    for (cell, clearance) in places {
        let square = (cell.y.div_euclid(edge), cell.x.div_euclid(edge));
        let held = best.entry(square).or_insert((cell, clearance));
        if clearance > held.1 {
            *held = (cell, clearance);
        }
    }
    let mut cells: Vec<Cell> = best.into_values().map(|(cell, _)| cell).collect();
    sort_by_blocks(&mut cells, edge);
    cells
}

/// Squares of a block of so many are visited before the next block, to and fro: a submap is as large as that.
const BLOCK: i32 = 3;

/// Puts cells in the order of blocks of squares, row by row.
pub(super) fn sort_by_blocks(cells: &mut [Cell], edge: i32) {
    let key = |c: &Cell| {
        let (x, y) = (c.x.div_euclid(edge), c.y.div_euclid(edge));
        let (block_x, block_y) = (x.div_euclid(BLOCK), y.div_euclid(BLOCK));
        let to_and_fro = |v: i32, row: i32| if row % 2 == 0 { v } else { -v };
        (block_y, to_and_fro(block_x, block_y), y, to_and_fro(x, y), c.y, c.x)
    };
    cells.sort_by_key(key);
}
