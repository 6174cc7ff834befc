//! Where a robot can drive.

use super::{Block, CellLayout, check_shape};
use crate::PictureError;
use crate::colors::{MAGENTA, Scale, UNKNOWN};
use crate::sheet::{ColorBar, Entry, Sheet, Swatch};
use percept_geometry::RgbImage;
use percept_mapping::Traversability;

/// Bluish green is flat, dark red not passable, magenta a drop, bluish grey unknown. Of cells that share a pixel, the worst is seen.
///
/// # Errors
/// `GridTooLarge`, `ShapeMismatch`, `OutOfRange`.
pub fn traversability(map: &Traversability, title: &str) -> Result<RgbImage, PictureError> {
    let buffers = [("traversability", map.traversability.len()), ("is_drop", map.is_drop.len())];
    check_shape(&map.geometry, map.width, map.height, &buffers)?;
    let layout = CellLayout::new(map.geometry, map.width, map.height);
    let bar = ColorBar { name: "traversability".to_owned(), scale: Scale::Traversability, low: 0.0, high: 1.0 };
    let mut legend = vec![];
    if map.is_drop.contains(&true) {
        legend.push(Entry::new(Swatch::Fill(MAGENTA), "drop"));
    }
    if map.traversability.iter().zip(&map.is_drop).any(|(t, drop)| !t.is_finite() && !drop) {
        legend.push(Entry::new(Swatch::Fill(UNKNOWN), "unknown"));
    }
    legend.push(Entry::new(Swatch::Fill(bar.color(1.0)), "1: flat, free"));
    legend.push(Entry::new(Swatch::Fill(bar.color(0.0)), "0: not passable"));
    let sheet =
        Sheet { title: title.to_owned(), detail: layout.detail(), bar: Some(bar.clone()), legend, ..Sheet::default() };
    let (mut opened, window) = layout.open(sheet, |block| color(map, &bar, block));
    opened.canvas.clip(None);
    opened.finish(&window);
    opened.canvas.into_image()
}

fn color(map: &Traversability, bar: &ColorBar, block: &Block) -> [u8; 3] {
    if block.cells(map.width).any(|i| map.is_drop[i]) {
        return MAGENTA;
    }
    let worst = block.cells(map.width).map(|i| map.traversability[i]).filter(|t| t.is_finite()).reduce(f32::min);
    worst.map_or(UNKNOWN, |worst| bar.color(f64::from(worst)))
}
