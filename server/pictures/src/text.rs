//! Words in pictures: fixed-width fonts of Latin-1, enlarged with the picture.

use crate::canvas::{Canvas, PixelBox};
use crate::colors::Color;
use embedded_graphics::Drawable;
use embedded_graphics::mono_font::iso_8859_1::{FONT_7X13, FONT_9X15, FONT_10X20};
use embedded_graphics::mono_font::{MonoFont, MonoTextStyle};
use embedded_graphics::pixelcolor::Rgb888;
use embedded_graphics::prelude::{DrawTarget, OriginDimensions, Pixel, Point, Size};
use embedded_graphics::text::{Baseline, Text};
use std::convert::Infallible;

/// How large words are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Font {
    /// Numbers at ticks.
    Small,
    /// Legends and labels.
    Normal,
    /// Titles.
    Title,
}

/// On which side of its position a text stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Align {
    Left,
    Center,
    Right,
}

impl Font {
    fn mono(self) -> &'static MonoFont<'static> {
        match self {
            Self::Small => &FONT_7X13,
            Self::Normal => &FONT_9X15,
            Self::Title => &FONT_10X20,
        }
    }

    /// Height of a line, pixels.
    pub(crate) fn height(self, enlarge: i32) -> i32 {
        self.mono().character_size.height as i32 * enlarge
    }

    /// Width of a text, pixels.
    pub(crate) fn width(self, text: &str, enlarge: i32) -> i32 {
        self.mono().character_size.width as i32 * enlarge * text.chars().count() as i32
    }
}

/// At most `num_chars` characters, the last three of them dots if something was cut off; no line breaks.
pub(crate) fn shortened(text: &str, num_chars: usize) -> String {
    let plain = |c: char| if c.is_control() { ' ' } else { c };
    // A text of megabytes is not walked through to the end.
    if text.chars().nth(num_chars).is_none() {
        return text.chars().map(plain).collect();
    }
    text.chars().take(num_chars.saturating_sub(3)).map(plain).chain("...".chars()).take(num_chars).collect()
}

/// A text in lines of at most `num_chars` characters, broken between words, at most `max_lines` of them.
pub(crate) fn wrapped(text: &str, num_chars: usize, max_lines: usize) -> Vec<String> {
    let mut lines: Vec<String> = vec![];
    for word in shortened(text, 2000).split_whitespace() {
        let word = shortened(word, num_chars);
        match lines.last_mut() {
            Some(line) if line.chars().count() + 1 + word.chars().count() <= num_chars => {
                line.push(' ');
                line.push_str(&word);
            }
            _ => lines.push(word),
        }
    }
    if lines.len() > max_lines {
        lines.truncate(max_lines);
        if let Some(last) = lines.last_mut() {
            *last = shortened(&format!("{last} ......"), num_chars.min(last.chars().count() + 4));
        }
    }
    lines
}

/// Where a text would be: its upper edge at `y`.
pub(crate) fn text_box(text: &str, x: i32, y: i32, font: Font, align: Align, enlarge: i32) -> PixelBox {
    let width = font.width(text, enlarge);
    let left = match align {
        Align::Left => x,
        Align::Center => x - width / 2,
        Align::Right => x - width,
    };
    PixelBox::new(left, y, width, font.height(enlarge))
}

/// Writes a text with its upper edge at `y`; the box it takes.
pub(crate) fn write(
    canvas: &mut Canvas,
    text: &str,
    (x, y): (i32, i32),
    (font, align, enlarge): (Font, Align, i32),
    color: Color,
) -> PixelBox {
    let place = text_box(text, x, y, font, align, enlarge);
    let style = MonoTextStyle::new(font.mono(), Rgb888::new(color[0], color[1], color[2]));
    let mut target = Enlarged { canvas, corner: Point::new(place.x0, place.y0), enlarge };
    // Nothing can fail that writes into memory.
    let Ok(_) = Text::with_baseline(text, Point::zero(), style, Baseline::Top).draw(&mut target);
    place
}

/// Writes a text on a light plate, so that it is read on any ground.
pub(crate) fn write_plated(
    canvas: &mut Canvas,
    text: &str,
    (x, y): (i32, i32),
    (font, align, enlarge): (Font, Align, i32),
    color: Color,
) {
    let place = text_box(text, x, y, font, align, enlarge);
    for py in place.y0..place.y1 {
        for px in place.x0 - 2 * enlarge..place.x1 + 2 * enlarge {
            canvas.blend(px, py, [255; 3], 0.82);
        }
    }
    write(canvas, text, (x, y), (font, align, enlarge), color);
}

/// Draws each pixel as a square.
struct Enlarged<'a> {
    canvas: &'a mut Canvas,
    corner: Point,
    enlarge: i32,
}

impl OriginDimensions for Enlarged<'_> {
    fn size(&self) -> Size {
        self.canvas.size()
    }
}

impl DrawTarget for Enlarged<'_> {
    type Color = Rgb888;
    type Error = Infallible;

    fn draw_iter<I: IntoIterator<Item = Pixel<Rgb888>>>(&mut self, pixels: I) -> Result<(), Infallible> {
        let (k, corner) = (self.enlarge, self.corner);
        let squares = pixels.into_iter().flat_map(|Pixel(at, color)| {
            (0..k * k).map(move |i| Pixel(corner + at * k + Point::new(i % k, i / k), color))
        });
        self.canvas.draw_iter(squares)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_texts_are_cut_or_broken_between_words() {
        assert_eq!(shortened("abc", 3), "abc");
        assert_eq!(shortened("abcdefgh", 6), "abc...");
        assert_eq!(shortened("a\nb", 6), "a b");
        assert_eq!(wrapped("the goal lies in an obstacle", 12, 9), ["the goal", "lies in an", "obstacle"]);
        assert_eq!(wrapped("a b c d e f", 3, 2), ["a b", "..."]);
        assert!(wrapped("", 5, 2).is_empty());
    }

    #[test]
    fn enlarged_text_has_squares_for_pixels() {
        let mut canvas = Canvas::new(60, 60, [255; 3]);
        let place = write(&mut canvas, "x", (10, 10), (Font::Small, Align::Left, 3), [0; 3]);
        assert_eq!((place.width(), place.height()), (21, 39));
        let image = canvas.into_image().unwrap();
        let dark = image.data().chunks_exact(3).filter(|p| p[0] == 0).count();
        assert!(dark > 0 && dark % 9 == 0, "{dark}");
    }
}
