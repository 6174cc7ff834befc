//! Labels that stand beside what they name and do not cover each other.

use crate::canvas::{Canvas, PixelBox};
use crate::colors::Color;
use crate::text::{Align, Font, shortened, text_box, write_plated};
use nalgebra::Point2;

/// Labels that are tried; what comes later has none.
const MAX_LABELS: usize = 2000;

/// Places that are taken.
pub(super) struct Labels {
    within: PixelBox,
    taken: Vec<PixelBox>,
    enlarge: i32,
    tried: usize,
    /// Labels for which there was no room.
    pub(super) left_out: usize,
}

impl Labels {
    pub(super) fn new(within: PixelBox, enlarge: i32) -> Self {
        Self { within, taken: vec![], enlarge, tried: 0, left_out: 0 }
    }

    /// Nothing is written where this is.
    pub(super) fn keep_free(&mut self, place: PixelBox) {
        self.taken.push(place);
    }

    /// Writes beside a thing that reaches `reach` pixels from `at`: above it, below, right, left or over it, where there is room.
    pub(super) fn write(&mut self, canvas: &mut Canvas, at: Point2<f64>, reach: f64, text: &str, color: Color) {
        if !(at.x.abs() < 1e6 && at.y.abs() < 1e6 && reach.is_finite()) {
            return;
        }
        self.tried += 1;
        let e = self.enlarge;
        let text = shortened(text, 24);
        let (x, y) = (at.x.round() as i32, at.y.round() as i32);
        let (reach, high) = (reach.min(1e5) as i32, Font::Small.height(e));
        let gap = 4 * e;
        let places = [
            (x, y - reach - gap - high, Align::Center),
            (x, y + reach + gap, Align::Center),
            (x + reach + 2 * gap, y - high / 2, Align::Left),
            (x - reach - 2 * gap, y - high / 2, Align::Right),
            (x, y - high / 2, Align::Center),
        ];
        let free = places.into_iter().find(|(x, y, align)| {
            let place = grown(text_box(&text, *x, *y, Font::Small, *align, e), 3 * e);
            place.within(&self.within) && !self.taken.iter().any(|taken| taken.overlaps(&place))
        });
        match free.filter(|_| self.tried <= MAX_LABELS) {
            Some((x, y, align)) => {
                self.taken.push(grown(text_box(&text, x, y, Font::Small, align, e), 2 * e));
                write_plated(canvas, &text, (x, y), (Font::Small, align, e), color);
            }
            None => self.left_out += 1,
        }
    }
}

fn grown(place: PixelBox, by: i32) -> PixelBox {
    PixelBox { x0: place.x0 - by, y0: place.y0 - by, x1: place.x1 + by, y1: place.y1 + by }
}
