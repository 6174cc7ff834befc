//! Which colour means which number.

use super::ticks_within;
use crate::canvas::{Canvas, PixelBox};
use crate::colors::{INK, SOFT_INK, Scale};
use crate::text::{Align, Font, write};

const LENGTH: i32 = 260;
const WIDTH: i32 = 24;

/// A scale of colours between two numbers.
#[derive(Debug, Clone)]
pub(crate) struct ColorBar {
    /// Name and unit of what it shows.
    pub(crate) name: String,
    pub(crate) scale: Scale,
    /// What has the first colour.
    pub(crate) low: f64,
    /// What has the last one.
    pub(crate) high: f64,
}

impl ColorBar {
    /// Over finite `values`: from the smallest to the largest, or about the only one.
    pub(crate) fn over(name: &str, scale: Scale, values: impl Iterator<Item = f64>) -> Self {
        let (mut low, mut high) = values
            .filter(|v| v.is_finite())
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
        if low > high {
            (low, high) = (0.0, 1.0);
        }
        let room = 1e-3f64.max(1e-6 * low.abs().max(high.abs()));
        if high - low < room {
            (low, high) = (low - 0.5 * room, high + 0.5 * room);
        }
        Self { name: name.to_owned(), scale, low, high }
    }

    /// Where a number lies between the ends.
    pub(crate) fn share(&self, value: f64) -> f64 {
        (value - self.low) / (self.high - self.low)
    }

    /// Colour of a number.
    pub(crate) fn color(&self, value: f64) -> [u8; 3] {
        self.scale.at(self.share(value))
    }

    fn ticks(&self) -> Vec<(f64, String)> {
        ticks_within(self.low, self.high, (self.high - self.low) * 30.0 / f64::from(LENGTH))
    }

    pub(crate) fn width(&self, e: i32) -> i32 {
        let labels = self.ticks().iter().map(|(_, label)| Font::Small.width(label, e)).max().unwrap_or(0);
        Font::Normal.width(&self.name, e).max(WIDTH * e + 12 * e + labels)
    }

    pub(crate) fn height(&self, e: i32) -> i32 {
        (22 + LENGTH + 8) * e
    }

    /// Draws it with its upper left corner there; where it ends.
    pub(crate) fn draw(&self, canvas: &mut Canvas, (x, y): (i32, i32), e: i32) -> i32 {
        write(canvas, &self.name, (x, y), (Font::Normal, Align::Left, e), INK);
        let bar = PixelBox::new(x, y + 24 * e, WIDTH * e, LENGTH * e);
        for row in bar.y0..bar.y1 {
            let share = (f64::from(bar.y1 - row) - 0.5) / f64::from(bar.height());
            canvas.fill(PixelBox::new(bar.x0, row, bar.width(), 1), self.scale.at(share));
        }
        canvas.outline(bar, e, SOFT_INK);
        for (value, label) in self.ticks() {
            let row = bar.y1 - (self.share(value) * f64::from(bar.height())).round() as i32;
            let row = row.clamp(bar.y0, bar.y1 - 1);
            canvas.fill(PixelBox::new(bar.x1, row, 5 * e, e), INK);
            write(canvas, &label, (bar.x1 + 9 * e, row - 6 * e), (Font::Small, Align::Left, e), INK);
        }
        y + self.height(e)
    }
}
