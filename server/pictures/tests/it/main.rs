//! What people see in pictures: scale, place, legend, and that the same comes out again.

// Helpers of tests may fail like tests.
#![allow(clippy::unwrap_used)]

mod anything;
mod flat;
mod space;

use nalgebra::Point2;
use percept_geometry::{GridGeometry, RgbImage};
use percept_mapping::DenseGrid;

pub(crate) const INK: [u8; 3] = [28, 30, 34];
pub(crate) const OCCUPIED: [u8; 3] = [20, 20, 22];

/// A free grid of 100 x 60 cells of 10 cm with its origin at (-2, 1).
pub(crate) fn grid() -> DenseGrid {
    let geometry = GridGeometry::new(0.1, Point2::new(-2.0, 1.0));
    DenseGrid { geometry, width: 100, height: 60, cells: vec![0; 6000] }
}

pub(crate) fn count(image: &RgbImage, color: [u8; 3]) -> usize {
    image.data().chunks_exact(3).filter(|p| *p == color).count()
}

/// Columns and rows in which a colour is found: first and last of each.
pub(crate) fn extent(image: &RgbImage, color: [u8; 3]) -> Option<([usize; 2], [usize; 2])> {
    let mut found: Option<([usize; 2], [usize; 2])> = None;
    for y in 0..image.height() {
        for x in (0..image.width()).filter(|x| image.at(*x, y) == color) {
            let (columns, rows) = found.get_or_insert(([x, x], [y, y]));
            *columns = [columns[0].min(x), columns[1].max(x)];
            *rows = [rows[0].min(y), rows[1].max(y)];
        }
    }
    found
}

/// Pixels of the scale bar: the longest run of ink in the lowest rows.
pub(crate) fn scale_bar(image: &RgbImage) -> usize {
    let run = |y: usize| {
        let (mut longest, mut length) = (0, 0);
        for x in 0..image.width() {
            length = if image.at(x, y) == INK { length + 1 } else { 0 };
            longest = longest.max(length);
        }
        longest
    };
    (image.height().saturating_sub(70)..image.height()).map(run).max().unwrap_or(0)
}

/// The same picture on one thread and on four.
pub(crate) fn same_on_any_threads(draw: impl Fn() -> RgbImage + Sync) {
    let on = |threads| rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(&draw);
    assert!(on(1) == on(4));
}
