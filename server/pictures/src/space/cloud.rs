//! A cloud of points.

use super::View;
use super::picture::Frame;
use super::raster::Tile;
use crate::PictureError;
use crate::canvas::PixelBox;
use crate::colors::Scale;
use crate::sheet::{ColorBar, Sheet};
use percept_geometry::{PointCloud, RgbImage};
use rayon::prelude::*;

/// Largest edge of a point's square, pixels, at 1100 pixels.
const MAX_SPLAT: f64 = 9.0;
/// Edge of the squares in which points are counted to tell how dense they are, pixels.
const COUNTED: usize = 8;

/// A cloud with its own colours, or by height (viridis, with a colour bar); points are as large as their density asks for, and edges
/// are darkened, so that shapes are told from each other. What is not finite or above the cut is left out.
///
/// # Errors
/// `OutOfRange` for a view that cannot be; `ShapeMismatch` for colours that are too few or too many; `TooMuchOverdraw`.
pub fn cloud_view(cloud: &PointCloud, view: &View, title: &str) -> Result<RgbImage, PictureError> {
    if let Some(actual) = cloud.colors.as_ref().map(Vec::len).filter(|n| *n != cloud.len()) {
        return Err(PictureError::ShapeMismatch { field: "colors", expected: cloud.len(), actual });
    }
    let frame = Frame::around(view, &cloud.positions, 0.0)?;
    let heights = cloud.positions.iter().filter(|p| frame.camera.shows(p)).map(|p| f64::from(p.z));
    let bar = ColorBar::over("height [m]", Scale::Viridis, heights);
    let colors = cloud.colors.as_ref();
    let pixels: Vec<[f32; 3]> = cloud.positions.par_iter().map(|p| frame.pixel(p)).collect();
    let shown: Vec<bool> = cloud.positions.par_iter().map(|p| frame.camera.shows(p)).collect();
    let size = splat_size(&frame, &pixels, &shown, MAX_SPLAT * view.edge_px as f64 / 1100.0);
    let square = |i: usize| {
        let corner = |v: f32| (v - 0.5 * size as f32).round() as i32;
        PixelBox::new(corner(pixels[i][0]), corner(pixels[i][1]), size, size)
    };
    let mut raster = frame.raster();
    let draw = |i: usize, tile: &mut Tile| {
        let part = tile.part(&square(i));
        let color = colors.map_or_else(|| bar.color(f64::from(cloud.positions[i].z)), |colors| colors[i]);
        for y in part.y0..part.y1 {
            for x in part.x0..part.x1 {
                tile.set(x, y, pixels[i][2], || color);
            }
        }
    };
    raster.draw(cloud.len(), |i| shown[i].then(|| square(i)), draw)?;
    (0..3).for_each(|_| raster.fill_holes(frame.per_metre));
    let sheet = Sheet { title: title.to_owned(), bar: colors.is_none().then(|| bar.clone()), ..Sheet::default() };
    frame.finish(sheet, &format!("{} points", cloud.len()), &raster, 0.8)
}

/// Edge of a point's square: about as far as points of the picture are apart in its thinner places. With points strewn at random, squares of
/// 2.3 times that leave one pixel of 200 open.
fn splat_size(frame: &Frame, pixels: &[[f32; 3]], shown: &[bool], largest: f64) -> i32 {
    let (columns, rows) = (frame.width.div_ceil(COUNTED), frame.height.div_ceil(COUNTED));
    let mut counts = vec![0u32; columns * rows];
    for (p, _) in pixels.iter().zip(shown).filter(|(_, shown)| **shown) {
        let cell = |v: f32, n: usize| (v.max(0.0) as usize / COUNTED).min(n.saturating_sub(1));
        counts[cell(p[1], rows) * columns + cell(p[0], columns)] += 1;
    }
    counts.retain(|count| *count > 0);
    counts.sort_unstable();
    let typical = counts.get(counts.len() / 4).copied().unwrap_or(1);
    let apart = COUNTED as f64 / f64::from(typical).sqrt();
    (2.3 * apart).round().clamp(2.0, largest.max(2.0)) as i32
}
