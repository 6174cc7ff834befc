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

/// A cloud with its own colours, or by height (viridis, with a colour bar); points are as large as their density around them asks for, and edges
/// are darkened, so that shapes are told from each other. What is not finite or above the cut is left out.
///
/// # Errors
/// `OutOfRange` for a view that cannot be; `ShapeMismatch` for colours that are too few or too many; `TooMuchOverdraw`.
pub fn cloud_view(cloud: &PointCloud, view: &View, title: &str) -> Result<RgbImage, PictureError> {
    if let Some(actual) = cloud.colors.as_ref().map(Vec::len).filter(|n| *n != cloud.len()) {
        return Err(PictureError::ShapeMismatch { field: "colors", expected: cloud.len(), actual });
    }
    let frame = Frame::around(view, &cloud.positions, 0.0)?;
    let bar = ColorBar::over("height [m]", Scale::Viridis, frame.heights.into_iter());
    let colors = cloud.colors.as_ref();
    let pixels: Vec<[f32; 3]> = cloud.positions.par_iter().map(|p| frame.pixel(p)).collect();
    let shown: Vec<bool> = cloud.positions.par_iter().map(|p| frame.camera.shows(p)).collect();
    let density = Density::of(&frame, &pixels, &shown);
    let enlarged = view.edge_px as f64 / 1100.0;
    let sizes: Vec<u8> = pixels.par_iter().map(|p| splat_size(density.apart(p), enlarged)).collect();
    let square = |i: usize| {
        let size = i32::from(sizes[i]);
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

/// Edge of a point's square, by how far points are apart around it. With points strewn at random, squares of 2.3 times that leave one
/// pixel of 200 open, those of 3 times that do so where every other point lies hidden behind; where even the largest squares would not close the gaps, points become smaller the lonelier they are.
fn splat_size(apart: f64, enlarged: f64) -> u8 {
    let largest = (MAX_SPLAT * enlarged).max(3.0);
    let wanted = 3.0 * apart;
    let size = if wanted <= largest { wanted } else { (largest * largest / wanted).max(3.0 * enlarged) };
    size.round().clamp(2.0, largest) as u8
}

/// How many points lie in squares of the picture.
struct Density {
    columns: usize,
    rows: usize,
    counts: Vec<u32>,
}

impl Density {
    fn of(frame: &Frame, pixels: &[[f32; 3]], shown: &[bool]) -> Self {
        let (columns, rows) = (frame.width.div_ceil(COUNTED), frame.height.div_ceil(COUNTED));
        let mut out = Self { columns, rows, counts: vec![0; columns * rows] };
        for (p, _) in pixels.iter().zip(shown).filter(|(_, shown)| **shown) {
            let (column, row) = out.square(p);
            out.counts[row * columns + column] += 1;
        }
        out
    }

    fn square(&self, p: &[f32; 3]) -> (usize, usize) {
        let number = |v: f32, n: usize| (v.max(0.0) as usize / COUNTED).min(n.saturating_sub(1));
        (number(p[0], self.columns), number(p[1], self.rows))
    }

    /// How far points are apart around one, pixels: in the thinner ones of the three by three squares around it that hold any, so that
    /// a floor beside a wall, which from above has all of its points in a line, is as dense as elsewhere.
    fn apart(&self, p: &[f32; 3]) -> f64 {
        let (column, row) = self.square(p);
        let (mut counts, mut found) = ([0u32; 9], 0);
        for y in row.saturating_sub(1)..=(row + 1).min(self.rows - 1) {
            for x in column.saturating_sub(1)..=(column + 1).min(self.columns - 1) {
                let count = self.counts[y * self.columns + x];
                if count > 0 {
                    counts[found] = count;
                    found += 1;
                }
            }
        }
        counts[..found].sort_unstable();
        COUNTED as f64 / f64::from(counts[found / 3].max(1)).sqrt()
    }
}
