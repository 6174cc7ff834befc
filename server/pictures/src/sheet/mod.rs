//! What surrounds a drawing: title, ticks, scale bar, axes, legend, colour bar, notes, each in a place of its own.
//!
//! ```text
//! title
//! size, resolution
//!  4 ┌──────────────────┐  colour bar
//!    │     drawing      │  legend
//!  0 └──────────────────┘  notes
//!    0        2        4
//!    ├── 1 m ──┤   ↑→ x y
//! ```

mod color_bar;
mod legend;
mod marks;
mod round;

pub(crate) use color_bar::ColorBar;
pub(crate) use legend::{Entry, Swatch, cross, hatch, marker};
pub(crate) use marks::{axes, scale_bar, ticks};
pub(crate) use round::{in_metres, round_below, ticks_within};

use crate::canvas::{Canvas, PixelBox};
use crate::colors::{INK, PAPER, SOFT_INK};
use crate::text::{Align, Font, shortened, wrapped, write};
use nalgebra::{Point2, Vector2};

/// A drawing's longer edge has at least this many pixels.
pub(crate) const MIN_PLOT: usize = 900;
/// And at most this many: with all that surrounds it, a picture stays within [`crate::MAX_EDGE`].
pub(crate) const MAX_PLOT: usize = 3300;

/// Characters of a line in the side column.
const SIDE_CHARS: usize = 26;

/// What stands around the drawing.
#[derive(Debug, Clone, Default)]
pub(crate) struct Sheet {
    pub(crate) title: String,
    pub(crate) detail: String,
    pub(crate) bar: Option<ColorBar>,
    pub(crate) legend: Vec<Entry>,
    pub(crate) notes: Vec<String>,
    /// Characters of the longest number at the left border; 0 where there are no ticks.
    pub(crate) tick_chars: usize,
}

/// A sheet with its surroundings written and the place of the drawing still empty.
pub(crate) struct Opened {
    pub(crate) canvas: Canvas,
    pub(crate) plot: PixelBox,
    /// How many times as large as in a small picture everything is drawn.
    pub(crate) enlarge: i32,
}

/// Size of text and lines for a drawing of this longer edge, pixels.
pub(crate) fn enlargement(edge: usize) -> i32 {
    ((edge + 700) / 1500).max(1) as i32
}

impl Sheet {
    /// Writes all but what belongs to the drawing, which has `width x height` pixels.
    pub(crate) fn open(&self, width: usize, height: usize) -> Opened {
        let e = enlargement(width.max(height));
        let (width, height) = (width as i32, height as i32);
        let margin = 16 * e;
        let left = margin + if self.tick_chars == 0 { 0 } else { 7 * e * self.tick_chars as i32 + 10 * e };
        let top = margin + (20 + 6 + 15 + 28) * e;
        let notes = self.lines();
        let side = self.side_width(&notes, e);
        let below = 20 * e + 76 * e + margin;
        let full_width = left + width + if side > 0 { 20 * e + side } else { 0 } + margin;
        let full_height = top + (height + below).max(self.side_height(&notes, e) + margin);
        let mut canvas = Canvas::new(full_width as usize, full_height as usize, PAPER);
        let plot = PixelBox::new(left, top, width, height);

        let fitting = |font: Font| ((full_width - 2 * margin) / font.width("x", e)).max(3) as usize;
        let title = shortened(&self.title, fitting(Font::Title));
        write(&mut canvas, &title, (margin, margin), (Font::Title, Align::Left, e), INK);
        let detail = shortened(&self.detail, fitting(Font::Normal));
        write(&mut canvas, &detail, (margin, margin + 26 * e), (Font::Normal, Align::Left, e), SOFT_INK);

        let x = plot.x1 + 20 * e;
        let mut y = top;
        if let Some(bar) = &self.bar {
            y = bar.draw(&mut canvas, (x, y), e) + 20 * e;
        }
        for entry in &self.legend {
            y = entry.draw(&mut canvas, (x, y), e);
        }
        if !self.legend.is_empty() {
            y += 10 * e;
        }
        for line in &notes {
            write(&mut canvas, line, (x, y), (Font::Normal, Align::Left, e), INK);
            y += 18 * e;
        }
        Opened { canvas, plot, enlarge: e }
    }

    fn lines(&self) -> Vec<String> {
        self.notes.iter().flat_map(|note| wrapped(note, SIDE_CHARS, 12)).collect()
    }

    fn side_width(&self, notes: &[String], e: i32) -> i32 {
        let notes = notes.iter().map(|line| Font::Normal.width(line, e)).max().unwrap_or(0);
        let legend = self.legend.iter().map(|entry| entry.width(e)).max().unwrap_or(0);
        let bar = self.bar.as_ref().map_or(0, |bar| bar.width(e));
        notes.max(legend).max(bar)
    }

    fn side_height(&self, notes: &[String], e: i32) -> i32 {
        let bar = self.bar.as_ref().map_or(0, |bar| bar.height(e) + 20 * e);
        let legend = if self.legend.is_empty() { 0 } else { self.legend.len() as i32 * legend::LINE * e + 10 * e };
        bar + legend + 18 * e * notes.len() as i32
    }
}

/// Where a rectangle of the map lies in a picture: x to the right, y up, one metre as long along both.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Window {
    /// Pixels of the drawing.
    pub(crate) plot: PixelBox,
    /// The map at its lower left corner, metres.
    pub(crate) low: Point2<f64>,
    /// Pixels of a metre.
    pub(crate) per_metre: f64,
}

impl Window {
    /// The pixel at a place of the map.
    pub(crate) fn pixel(&self, p: Point2<f64>) -> Point2<f64> {
        let from_low = (p - self.low) * self.per_metre;
        Point2::new(f64::from(self.plot.x0) + from_low.x, f64::from(self.plot.y1) - from_low.y)
    }

    /// The place of the map in the middle of a pixel.
    pub(crate) fn place(&self, x: i32, y: i32) -> Point2<f64> {
        let from_low = Vector2::new(f64::from(x - self.plot.x0) + 0.5, f64::from(self.plot.y1 - y) - 0.5);
        self.low + from_low / self.per_metre
    }

    /// Characters of the longest number at its border.
    pub(crate) fn tick_chars(low: Point2<f64>, size_px: (usize, usize), per_metre: f64) -> usize {
        let e = f64::from(enlargement(size_px.0.max(size_px.1)));
        let ticks = ticks_within(low.y, low.y + size_px.1 as f64 / per_metre, 80.0 * e / per_metre);
        ticks.iter().map(|(_, label)| label.chars().count()).max().unwrap_or(1)
    }
}

impl Opened {
    /// Border, ticks, scale bar and axes of a drawing that shows the map from above.
    pub(crate) fn finish(&mut self, window: &Window) {
        ticks(&mut self.canvas, window, self.enlarge);
        self.border();
        scale_bar(&mut self.canvas, self.plot, window.per_metre, "", self.enlarge);
        let directions = [("x", Vector2::new(1.0, 0.0)), ("y", Vector2::new(0.0, 1.0))];
        axes(&mut self.canvas, self.plot, &directions, self.enlarge);
    }

    /// Writes a short remark below the right corner of the drawing.
    pub(crate) fn write_below(&mut self, words: &str) {
        let (at, e) = ((self.plot.x1, self.plot.y1 + 72 * self.enlarge), self.enlarge);
        write(&mut self.canvas, words, at, (Font::Small, Align::Right, e), SOFT_INK);
    }

    pub(crate) fn border(&mut self) {
        let (plot, e) = (self.plot, self.enlarge);
        let around = PixelBox { x0: plot.x0 - e, y0: plot.y0 - e, x1: plot.x1 + e, y1: plot.y1 + e };
        self.canvas.outline(around, e, SOFT_INK);
    }
}
