//! One line of the legend: what it looks like, and what it is.

use crate::canvas::{Canvas, PixelBox};
use crate::colors::{Color, INK, PAPER, SOFT_INK};
use crate::text::{Align, Font, shortened, write};
use nalgebra::Point2;

/// Height of a line, pixels.
pub(crate) const LINE: i32 = 24;
/// From the left edge to the words, pixels.
const WORDS: i32 = 38;
const MAX_CHARS: usize = 22;

/// How something is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Swatch {
    /// An area, or cells.
    Fill(Color),
    /// A hatched area.
    Hatch(Color),
    /// A line.
    Line(Color),
    /// The outline of a box.
    Outline(Color),
    /// A disc with a white rim.
    Disc(Color),
    /// A cross.
    Cross(Color),
}

/// A line of the legend.
#[derive(Debug, Clone)]
pub(crate) struct Entry {
    pub(crate) swatch: Swatch,
    pub(crate) words: String,
}

impl Entry {
    pub(crate) fn new(swatch: Swatch, words: impl Into<String>) -> Self {
        Self { swatch, words: shortened(&words.into(), MAX_CHARS) }
    }

    pub(crate) fn width(&self, e: i32) -> i32 {
        WORDS * e + Font::Normal.width(&self.words, e)
    }

    /// Draws it with its upper left corner there; where the next one begins.
    pub(crate) fn draw(&self, canvas: &mut Canvas, (x, y): (i32, i32), e: i32) -> i32 {
        let area = PixelBox::new(x, y + 2 * e, 28 * e, 15 * e);
        let middle = Point2::new(f64::from(area.x0 + area.x1) / 2.0, f64::from(area.y0 + area.y1) / 2.0);
        let (half, size) = (nalgebra::Vector2::new(f64::from(13 * e), 0.0), f64::from(e));
        match self.swatch {
            Swatch::Fill(color) => {
                canvas.fill(area, color);
                canvas.outline(area, e, SOFT_INK);
            }
            Swatch::Hatch(color) => {
                for py in area.y0..area.y1 {
                    for px in area.x0..area.x1 {
                        canvas.blend(px, py, color, hatch(px, py, e));
                    }
                }
                canvas.outline(area, 2 * e, color);
            }
            Swatch::Line(color) => canvas.line(middle - half, middle + half, 3.0 * size, color),
            Swatch::Outline(color) => canvas.outline(area, 2 * e, color),
            Swatch::Disc(color) => marker(canvas, middle, 6.5 * size, color),
            Swatch::Cross(color) => cross(canvas, middle, 6.0 * size, color),
        }
        write(canvas, &self.words, (x + WORDS * e, y + 2 * e), (Font::Normal, Align::Left, e), INK);
        y + LINE * e
    }
}

/// How much of a pixel a hatched area covers.
pub(crate) fn hatch(x: i32, y: i32, e: i32) -> f64 {
    if (x + y).rem_euclid(9 * e) < 2 * e { 0.85 } else { 0.16 }
}

/// A disc with a white rim and a thin dark one around it.
pub(crate) fn marker(canvas: &mut Canvas, at: Point2<f64>, radius: f64, color: Color) {
    canvas.disc(at, radius + 0.12 * radius, INK);
    canvas.disc(at, radius, PAPER);
    canvas.disc(at, 0.74 * radius, color);
}

/// A cross with a white rim.
pub(crate) fn cross(canvas: &mut Canvas, at: Point2<f64>, reach: f64, color: Color) {
    for (width, color) in [(0.85 * reach, PAPER), (0.42 * reach, color)] {
        for side in [-1.0, 1.0] {
            let d = nalgebra::Vector2::new(reach, side * reach);
            canvas.line(at - d, at + d, width, color);
        }
    }
}
