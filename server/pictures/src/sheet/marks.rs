//! Ticks along the border, the scale bar and the axes of the map frame, which stand below the drawing.

use super::{Window, in_metres, round_below, ticks_within};
use crate::canvas::{Canvas, PixelBox};
use crate::colors::{INK, PAPER, SOFT_INK};
use crate::text::{Align, Font, write};
use nalgebra::{Point2, Vector2};

/// Numbers in metres along the lower and the left border.
pub(crate) fn ticks(canvas: &mut Canvas, window: &Window, e: i32) {
    let (plot, pm) = (window.plot, window.per_metre);
    let apart = 80.0 * f64::from(e) / pm;
    let far = |length: i32, low: f64| low + f64::from(length) / pm;
    for (x, label) in ticks_within(window.low.x, far(plot.width(), window.low.x), apart) {
        let at = window.pixel(Point2::new(x, window.low.y)).x.round() as i32;
        canvas.fill(PixelBox::new(at, plot.y1, e, 6 * e), SOFT_INK);
        let half = Font::Small.width(&label, e) / 2;
        let at = at.clamp(half + 2 * e, (plot.x1 + 14 * e - half).max(half + 2 * e));
        write(canvas, &label, (at, plot.y1 + 8 * e), (Font::Small, Align::Center, e), INK);
    }
    write(canvas, "x [m]", (plot.x1, plot.y1 + 25 * e), (Font::Small, Align::Right, e), SOFT_INK);
    write(canvas, "y [m]", (plot.x0, plot.y0 - 18 * e), (Font::Small, Align::Left, e), SOFT_INK);
    for (y, label) in ticks_within(window.low.y, far(plot.height(), window.low.y), apart) {
        let at = window.pixel(Point2::new(window.low.x, y)).y.round() as i32;
        canvas.fill(PixelBox::new(plot.x0 - 6 * e, at, 6 * e, e), SOFT_INK);
        write(canvas, &label, (plot.x0 - 9 * e, at - 6 * e), (Font::Small, Align::Right, e), INK);
    }
}

/// A bar as long as the metres that it says, below the left corner of the drawing: its outline is that long.
pub(crate) fn scale_bar(canvas: &mut Canvas, plot: PixelBox, per_metre: f64, words: &str, e: i32) {
    let longest = (0.4 * f64::from(plot.width())).min(f64::from(280 * e));
    let metres = round_below(longest / per_metre);
    let length = (metres * per_metre).round() as i32;
    let bar = PixelBox::new(plot.x0, plot.y1 + 56 * e, length.max(2), 9 * e);
    canvas.fill(bar, INK);
    let half = PixelBox { x0: bar.x0 + bar.width() / 2, y0: bar.y0 + e, x1: bar.x1 - e, y1: bar.y1 - e };
    canvas.fill(half, PAPER);
    let label = format!("{}{words}", in_metres(metres));
    write(canvas, &label, (bar.x0, bar.y1 + 5 * e), (Font::Normal, Align::Left, e), INK);
}

/// Arrows along axes of the map frame as they lie in the picture (up positive, at most 1 long), right of the scale bar.
pub(crate) fn axes(canvas: &mut Canvas, plot: PixelBox, directions: &[(&str, Vector2<f64>)], e: i32) {
    let size = f64::from(e);
    let length = 40.0 * size;
    let lowest = directions.iter().map(|(_, d)| d.y).fold(0.0, f64::min);
    let leftmost = directions.iter().map(|(_, d)| d.x).fold(0.0, f64::min);
    let rightmost = directions.iter().map(|(_, d)| d.x).fold(0.0, f64::max);
    let right = f64::from(plot.x1) - 20.0 * size - length * rightmost;
    let left = f64::from(plot.x0) + 0.4 * f64::from(plot.width()).min(700.0 * size) + 40.0 * size - length * leftmost;
    let origin = Point2::new(right.min(left.max(0.0)), f64::from(plot.y1) + 84.0 * size + length * lowest);
    for (label, direction) in directions {
        let direction = Vector2::new(direction.x, -direction.y);
        let end = origin + direction * length;
        canvas.arrow(origin, end, 2.2 * size, INK);
        // Something seen along its axis has no direction; its letter stands at the origin.
        let ahead = direction.try_normalize(1e-6).unwrap_or_default() * (9.0 * size);
        let at = end + ahead - Vector2::new(3.0, 7.0) * size;
        write(canvas, label, (at.x as i32, at.y as i32), (Font::Small, Align::Left, e), INK);
    }
    canvas.disc(origin, 2.6 * size, INK);
}
