//! Pixels that lines, areas and text are drawn into, with soft edges and a clip rectangle.

use crate::PictureError;
use crate::colors::Color;
use embedded_graphics::pixelcolor::Rgb888;
use embedded_graphics::prelude::{DrawTarget, OriginDimensions, Pixel, Point, RgbColor, Size};
use nalgebra::{Point2, Vector2};
use percept_geometry::RgbImage;
use std::convert::Infallible;

/// A rectangle of pixels; `x1` and `y1` are outside.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct PixelBox {
    pub(crate) x0: i32,
    pub(crate) y0: i32,
    pub(crate) x1: i32,
    pub(crate) y1: i32,
}

impl PixelBox {
    pub(crate) fn new(x0: i32, y0: i32, width: i32, height: i32) -> Self {
        Self { x0, y0, x1: x0 + width, y1: y0 + height }
    }

    pub(crate) fn width(&self) -> i32 {
        self.x1 - self.x0
    }

    pub(crate) fn height(&self) -> i32 {
        self.y1 - self.y0
    }

    pub(crate) fn overlaps(&self, other: &Self) -> bool {
        self.x0 < other.x1 && other.x0 < self.x1 && self.y0 < other.y1 && other.y0 < self.y1
    }

    pub(crate) fn within(&self, other: &Self) -> bool {
        self.x0 >= other.x0 && self.y0 >= other.y0 && self.x1 <= other.x1 && self.y1 <= other.y1
    }
}

/// A picture under construction, row 0 on top. Positions are pixels; the centre of the first one is (0.5, 0.5).
pub(crate) struct Canvas {
    width: usize,
    height: usize,
    pixels: Vec<u8>,
    clip: PixelBox,
}

impl Canvas {
    pub(crate) fn new(width: usize, height: usize, color: Color) -> Self {
        let clip = PixelBox::new(0, 0, width as i32, height as i32);
        Self { width, height, pixels: color.repeat(width * height), clip }
    }

    /// Draws inside of `clip` alone, or anywhere again.
    pub(crate) fn clip(&mut self, clip: Option<PixelBox>) {
        let all = PixelBox::new(0, 0, self.width as i32, self.height as i32);
        let clip = clip.unwrap_or(all);
        self.clip = PixelBox {
            x0: clip.x0.clamp(0, all.x1),
            y0: clip.y0.clamp(0, all.y1),
            x1: clip.x1.clamp(0, all.x1),
            y1: clip.y1.clamp(0, all.y1),
        };
    }

    /// Rows of `region`, from the top, each as its bytes, for whole areas that are drawn at once.
    pub(crate) fn rows(&mut self, region: PixelBox) -> impl Iterator<Item = &mut [u8]> {
        let (x0, x1) = (3 * region.x0 as usize, 3 * region.x1 as usize);
        let rows = self.pixels.chunks_exact_mut(3 * self.width.max(1));
        rows.skip(region.y0 as usize).take(region.height().max(0) as usize).map(move |row| &mut row[x0..x1])
    }

    /// Lays a colour over a pixel; `cover` from 0 to 1.
    pub(crate) fn blend(&mut self, x: i32, y: i32, color: Color, cover: f64) {
        let c = self.clip;
        if x < c.x0 || x >= c.x1 || y < c.y0 || y >= c.y1 || cover <= 0.0 {
            return;
        }
        let i = 3 * (y as usize * self.width + x as usize);
        for (old, new) in self.pixels[i..i + 3].iter_mut().zip(color) {
            let mixed = f64::from(*old) + (f64::from(new) - f64::from(*old)) * cover.min(1.0);
            *old = mixed.round() as u8;
        }
    }

    pub(crate) fn fill(&mut self, area: PixelBox, color: Color) {
        for y in area.y0.max(self.clip.y0)..area.y1.min(self.clip.y1) {
            for x in area.x0.max(self.clip.x0)..area.x1.min(self.clip.x1) {
                self.blend(x, y, color, 1.0);
            }
        }
    }

    /// The outline of a rectangle, inside of it.
    pub(crate) fn outline(&mut self, area: PixelBox, width: i32, color: Color) {
        let (w, h) = (area.width(), area.height());
        self.fill(PixelBox::new(area.x0, area.y0, w, width), color);
        self.fill(PixelBox::new(area.x0, area.y1 - width, w, width), color);
        self.fill(PixelBox::new(area.x0, area.y0, width, h), color);
        self.fill(PixelBox::new(area.x1 - width, area.y0, width, h), color);
    }

    /// A line with round ends; nothing if an end is not finite.
    pub(crate) fn line(&mut self, a: Point2<f64>, b: Point2<f64>, width: f64, color: Color) {
        let reach = 0.5 * width + 1.0;
        let Some((a, b)) = self.clipped(a, b, reach) else { return };
        let along = b - a;
        let squared = along.norm_squared();
        let (top, bottom) = (a.y.min(b.y) - reach, a.y.max(b.y) + reach);
        let (left, right) = (a.x.min(b.x) - reach, a.x.max(b.x) + reach);
        for y in (top.floor() as i32).max(self.clip.y0)..=(bottom.ceil() as i32).min(self.clip.y1 - 1) {
            let center_y = f64::from(y) + 0.5;
            // Where the row comes near the line: all of it for flat ones, a short stretch for steep ones.
            let (from, to) = if along.y.abs() < 1e-9 {
                (left, right)
            } else {
                let at = |y: f64| a.x + along.x * ((y - a.y) / along.y).clamp(0.0, 1.0);
                let slack = reach * (1.0 + (along.x / along.y).abs()) + 1.0;
                let (p, q) = (at(center_y - 0.5), at(center_y + 0.5));
                ((p.min(q) - slack).max(left), (p.max(q) + slack).min(right))
            };
            for x in (from.floor() as i32).max(self.clip.x0)..=(to.ceil() as i32).min(self.clip.x1 - 1) {
                let p = Point2::new(f64::from(x) + 0.5, center_y);
                let share = if squared > 0.0 { ((p - a).dot(&along) / squared).clamp(0.0, 1.0) } else { 0.0 };
                self.blend(x, y, color, 0.5 * width + 0.5 - (p - (a + along * share)).norm());
            }
        }
    }

    /// The part of a line that can be seen, with some room around the clip.
    fn clipped(&self, a: Point2<f64>, b: Point2<f64>, room: f64) -> Option<(Point2<f64>, Point2<f64>)> {
        if ![a.x, a.y, b.x, b.y].iter().all(|v| v.abs() < 1e9) {
            return None;
        }
        let c = self.clip;
        let (mut from, mut to) = (0.0f64, 1.0f64);
        let d = b - a;
        for (p, d, low, high) in [(a.x, d.x, c.x0, c.x1), (a.y, d.y, c.y0, c.y1)] {
            let (low, high) = (f64::from(low) - room, f64::from(high) + room);
            if d == 0.0 {
                if p < low || p > high {
                    return None;
                }
                continue;
            }
            let (s, e) = ((low - p) / d, (high - p) / d);
            from = from.max(s.min(e));
            to = to.min(s.max(e));
        }
        (from <= to).then(|| (a + d * from, a + d * to))
    }

    pub(crate) fn polyline(&mut self, points: &[Point2<f64>], width: f64, color: Color) {
        points.windows(2).for_each(|p| self.line(p[0], p[1], width, color));
    }

    pub(crate) fn closed(&mut self, points: &[Point2<f64>], width: f64, color: Color) {
        self.polyline(points, width, color);
        if let (Some(first), Some(last)) = (points.first(), points.last()) {
            self.line(*last, *first, width, color);
        }
    }

    pub(crate) fn disc(&mut self, center: Point2<f64>, radius: f64, color: Color) {
        self.line(center, center, 2.0 * radius, color);
    }

    /// A line with a head at `b`.
    pub(crate) fn arrow(&mut self, a: Point2<f64>, b: Point2<f64>, width: f64, color: Color) {
        let Some(ahead) = (b - a).try_normalize(1e-9) else { return };
        let side = Vector2::new(-ahead.y, ahead.x);
        let head = 4.0 * width;
        self.line(a, b - ahead * (0.6 * head), width, color);
        let corners = [b, b - ahead * head + side * (0.45 * head), b - ahead * head - side * (0.45 * head)];
        self.polygon(&corners, |_, _| Some((color, 1.0)));
        self.closed(&corners, 0.7, color);
    }

    /// Fills a polygon (even-odd); `paint` tells colour and cover of a pixel, or none.
    pub(crate) fn polygon(&mut self, corners: &[Point2<f64>], paint: impl Fn(i32, i32) -> Option<(Color, f64)>) {
        if corners.len() < 3 || !corners.iter().all(|p| p.x.abs() < 1e9 && p.y.abs() < 1e9) {
            return;
        }
        let (low, high) = corners.iter().fold((f64::MAX, f64::MIN), |(l, h), p| (l.min(p.y), h.max(p.y)));
        let mut crossings = Vec::with_capacity(corners.len());
        for y in (low.floor() as i32).max(self.clip.y0)..=(high.ceil() as i32).min(self.clip.y1 - 1) {
            let middle = f64::from(y) + 0.5;
            crossings.clear();
            for (i, a) in corners.iter().enumerate() {
                let b = corners[(i + 1) % corners.len()];
                if (a.y <= middle) != (b.y <= middle) {
                    crossings.push(a.x + (b.x - a.x) * (middle - a.y) / (b.y - a.y));
                }
            }
            crossings.sort_by(f64::total_cmp);
            for pair in crossings.chunks_exact(2) {
                let (from, to) = ((pair[0] - 0.5).ceil() as i32, (pair[1] - 0.5).ceil() as i32);
                for x in from.max(self.clip.x0)..to.min(self.clip.x1) {
                    if let Some((color, cover)) = paint(x, y) {
                        self.blend(x, y, color, cover);
                    }
                }
            }
        }
    }

    pub(crate) fn into_image(self) -> Result<RgbImage, PictureError> {
        RgbImage::new(self.width, self.height, self.pixels).map_err(|e| PictureError::Encode(e.to_string()))
    }
}

impl OriginDimensions for Canvas {
    fn size(&self) -> Size {
        Size::new(self.width as u32, self.height as u32)
    }
}

impl DrawTarget for Canvas {
    type Color = Rgb888;
    type Error = Infallible;

    fn draw_iter<I: IntoIterator<Item = Pixel<Rgb888>>>(&mut self, pixels: I) -> Result<(), Infallible> {
        for Pixel(Point { x, y }, color) in pixels {
            self.blend(x, y, [color.r(), color.g(), color.b()], 1.0);
        }
        Ok(())
    }
}
