//! Why a picture could not be made.

use crate::MAX_CELLS;

/// Facts about refused input; nothing large was allocated when one of these is returned.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PictureError {
    /// A grid has more cells than are looked at.
    #[error("grid of {width} x {height} cells is larger than {MAX_CELLS} cells, read a region")]
    GridTooLarge {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
    },
    /// A buffer's length does not fit the declared shape.
    #[error("{field}: expected {expected} elements, got {actual}")]
    ShapeMismatch {
        /// Field name.
        field: &'static str,
        /// Elements that the declared shape needs.
        expected: usize,
        /// Elements that are there.
        actual: usize,
    },
    /// A number is NaN, infinite or outside its bounds.
    #[error("{field}: {value} is not {requirement}")]
    OutOfRange {
        /// Field name.
        field: &'static str,
        /// The value as given.
        value: f64,
        /// What it has to be.
        requirement: &'static str,
    },
    /// Triangles or splats cover each other so often that drawing them would take minutes.
    #[error("{pixels} pixels would be drawn for this picture, more than {limit}: draw a part of it, or smaller")]
    TooMuchOverdraw {
        /// Pixels that all of them cover together.
        pixels: u64,
        /// The most that are drawn.
        limit: u64,
    },
    /// The encoder's own words.
    #[error("the picture could not be encoded: {0}")]
    Encode(String),
}
