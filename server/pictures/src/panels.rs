//! Several pictures in one, each with its caption.

use crate::MAX_EDGE;
use crate::PictureError;
use crate::canvas::{Canvas, PixelBox};
use crate::colors::{INK, PAPER};
use crate::text::{Align, Font, shortened, write};
use percept_geometry::RgbImage;

/// The most pictures of a sheet.
const MAX_PANELS: usize = 64;
const GAP: usize = 18;
const CAPTION: usize = 34;

/// Pictures beside each other in `columns` columns, row by row, each with its caption above it. All are shrunk alike if they would be
/// larger than [`MAX_EDGE`] together.
///
/// # Errors
/// `OutOfRange` for no column, and for no picture or more than 64.
pub fn side_by_side(panels: &[(&RgbImage, &str)], columns: usize) -> Result<RgbImage, PictureError> {
    let out_of_range =
        |field, value: usize, requirement| Err(PictureError::OutOfRange { field, value: value as f64, requirement });
    if panels.is_empty() || panels.len() > MAX_PANELS {
        return out_of_range("panels", panels.len(), "between 1 and 64");
    }
    if columns == 0 {
        return out_of_range("columns", columns, "positive");
    }
    let columns = columns.min(panels.len());
    let rows = panels.len().div_ceil(columns);
    let mut widths = vec![1usize; columns];
    let mut heights = vec![1usize; rows];
    for (i, (image, _)) in panels.iter().enumerate() {
        widths[i % columns] = widths[i % columns].max(image.width());
        heights[i / columns] = heights[i / columns].max(image.height());
    }
    let (around_x, around_y) = (GAP * (columns + 1), (GAP + CAPTION) * rows + GAP);
    let fits =
        |sizes: &[usize], around: usize| (MAX_EDGE - around) as f64 / sizes.iter().map(|s| *s as f64).sum::<f64>();
    let share = fits(&widths, around_x).min(fits(&heights, around_y)).min(1.0);
    let scaled = |size: &usize| ((*size as f64 * share).floor() as usize).max(1);
    let (widths, heights): (Vec<_>, Vec<_>) =
        (widths.iter().map(scaled).collect(), heights.iter().map(scaled).collect());
    let size = (widths.iter().sum::<usize>() + around_x, heights.iter().sum::<usize>() + around_y);
    let mut canvas = Canvas::new(size.0, size.1, PAPER);
    for (i, (image, caption)) in panels.iter().enumerate() {
        let (column, row) = (i % columns, i / columns);
        let x = GAP * (column + 1) + widths[..column].iter().sum::<usize>();
        let y = (GAP + CAPTION) * row + GAP + heights[..row].iter().sum::<usize>();
        let caption = shortened(caption, (widths[column] / 10).max(4));
        write(&mut canvas, &caption, (x as i32, y as i32 + 4), (Font::Title, Align::Left, 1), INK);
        let target = (scaled(&image.width()).min(widths[column]), scaled(&image.height()).min(heights[row]));
        let place = PixelBox::new(x as i32, (y + CAPTION) as i32, target.0 as i32, target.1 as i32);
        paste(&mut canvas, place, image);
    }
    canvas.into_image()
}

/// Copies a picture, or the mean of the pixels that fall into one.
fn paste(canvas: &mut Canvas, place: PixelBox, image: &RgbImage) {
    let (width, height) = (place.width() as usize, place.height() as usize);
    if image.width() == 0 || image.height() == 0 {
        return;
    }
    let range = |i: usize, to: usize, from: usize| {
        let low = i * from / to;
        low..((i + 1) * from / to).max(low + 1).min(from)
    };
    for (y, pixels) in canvas.rows(place).enumerate() {
        let rows = range(y, height, image.height());
        for (x, pixel) in pixels.chunks_exact_mut(3).enumerate() {
            let columns = range(x, width, image.width());
            let (mut sum, mut count) = ([0u32; 3], 0u32);
            for v in rows.clone() {
                for u in columns.clone() {
                    let color = image.at(u, v);
                    (0..3).for_each(|i| sum[i] += u32::from(color[i]));
                    count += 1;
                }
            }
            (0..3).for_each(|i| pixel[i] = (sum[i] / count.max(1)) as u8);
        }
    }
}
