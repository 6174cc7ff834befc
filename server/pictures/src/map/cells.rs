//! Cells become pixels: small grids are enlarged with sharp edges, large ones shrunk by blocks.

use crate::canvas::{Canvas, PixelBox};
use crate::colors::Color;
use crate::sheet::{MAX_PLOT, MIN_PLOT, Opened, Sheet, Window, enlargement};
use crate::text::{Align, Font, write};
use nalgebra::{Point2, Vector2};
use percept_geometry::GridGeometry;
use rayon::prelude::*;
use std::ops::Range;

/// Drawings are at least this large, pixels of small pictures, so that scale bar and axes have room below.
const MIN_SIZE: (usize, usize) = (420, 120);

/// What lies beyond the grid: lighter than unknown cells, and not white, which is free.
const BEYOND: Color = [236, 239, 243];

/// Cells that share a pixel.
#[derive(Debug, Clone)]
pub(crate) struct Block {
    /// Columns.
    pub(crate) x: Range<usize>,
    /// Rows.
    pub(crate) y: Range<usize>,
}

impl Block {
    /// Numbers of its cells in a row-major grid.
    pub(crate) fn cells(&self, width: usize) -> impl Iterator<Item = usize> + '_ {
        self.y.clone().flat_map(move |y| self.x.clone().map(move |x| y * width + x))
    }
}

/// How a grid becomes pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct CellLayout {
    geometry: GridGeometry,
    cells: (usize, usize),
    /// Pixels along the edge of a cell.
    enlarged: usize,
    /// Cells along the edge of a pixel.
    shrunk: usize,
    /// Pixels that cells take.
    drawn: (usize, usize),
    /// Pixels of the drawing.
    size: (usize, usize),
}

impl CellLayout {
    pub(crate) fn new(geometry: GridGeometry, width: usize, height: usize) -> Self {
        let longest = width.max(height).max(1);
        // Where there is no cell, a few metres are shown.
        let longest = if width == 0 || height == 0 { MIN_PLOT / 4 } else { longest };
        let enlarged = MIN_PLOT.div_ceil(longest).max(1);
        let shrunk = longest.div_ceil(MAX_PLOT).max(1);
        let pixels = |cells: usize| (cells * enlarged).div_ceil(shrunk);
        let drawn = (pixels(width), pixels(height));
        let e = enlargement(drawn.0.max(drawn.1)) as usize;
        let size = if width == 0 || height == 0 {
            (MIN_PLOT, MIN_PLOT / 2)
        } else {
            (drawn.0.max(MIN_SIZE.0 * e), drawn.1.max(MIN_SIZE.1 * e))
        };
        Self { geometry, cells: (width, height), enlarged, shrunk, drawn, size }
    }

    /// Pixels of a metre.
    pub(crate) fn per_metre(&self) -> f64 {
        self.enlarged as f64 / (self.shrunk as f64 * self.geometry.resolution_m)
    }

    fn inset(&self) -> (usize, usize) {
        ((self.size.0 - self.drawn.0.min(self.size.0)) / 2, (self.size.1 - self.drawn.1.min(self.size.1)) / 2)
    }

    /// The map at the drawing's lower left corner.
    fn low(&self) -> Point2<f64> {
        let inset = self.inset();
        self.geometry.origin - Vector2::new(inset.0 as f64, inset.1 as f64) / self.per_metre()
    }

    /// The sheet with each pixel coloured by the block of cells below it, clipped to the drawing; what is beyond the grid is pale.
    pub(crate) fn open(&self, sheet: Sheet, color: impl Fn(&Block) -> Color + Sync) -> (Opened, Window) {
        let tick_chars = Window::tick_chars(self.low(), self.size, self.per_metre());
        let mut opened = Sheet { tick_chars, ..sheet }.open(self.size.0, self.size.1);
        let window = Window { plot: opened.plot, low: self.low(), per_metre: self.per_metre() };
        let plot = opened.plot;
        opened.canvas.fill(plot, BEYOND);
        if self.cells.0 == 0 || self.cells.1 == 0 {
            let middle = ((plot.x0 + plot.x1) / 2, (plot.y0 + plot.y1) / 2);
            write(&mut opened.canvas, "nothing is known yet", middle, (Font::Title, Align::Center, 1), [120; 3]);
        } else {
            self.paint(&mut opened.canvas, opened.plot, color);
        }
        opened.canvas.clip(Some(opened.plot));
        (opened, window)
    }

    fn paint(&self, canvas: &mut Canvas, plot: PixelBox, color: impl Fn(&Block) -> Color + Sync) {
        let inset = self.inset();
        let (width, height) = (self.drawn.0 as i32, self.drawn.1 as i32);
        let top = plot.y1 - inset.1 as i32 - height;
        let area = PixelBox::new(plot.x0 + inset.0 as i32, top, width, height);
        let block = |pixel: usize, cells: usize| {
            let first = pixel / self.enlarged * self.shrunk;
            first..(first + self.shrunk).min(cells)
        };
        let mut rows: Vec<&mut [u8]> = canvas.rows(area).collect();
        // Rows that show the same cells are painted once.
        rows.par_chunks_mut(self.enlarged).enumerate().for_each(|(i, rows)| {
            let y = block(self.drawn.1 - 1 - i * self.enlarged, self.cells.1);
            let Some((first, others)) = rows.split_first_mut() else { return };
            for (i, pixels) in first.chunks_mut(3 * self.enlarged).enumerate() {
                let block = Block { x: block(i * self.enlarged, self.cells.0), y: y.clone() };
                let color = if block.x.is_empty() || block.y.is_empty() { BEYOND } else { color(&block) };
                pixels.chunks_exact_mut(3).for_each(|pixel| pixel.copy_from_slice(&color));
            }
            others.iter_mut().for_each(|other| other.copy_from_slice(first));
        });
    }

    /// Size and resolution in words.
    pub(crate) fn detail(&self) -> String {
        if self.cells.0 == 0 || self.cells.1 == 0 {
            return "no cells".to_owned();
        }
        let size = |cells: usize| cells as f64 * self.geometry.resolution_m;
        let cell = crate::sheet::in_metres(self.geometry.resolution_m);
        let (width, height) = (size(self.cells.0), size(self.cells.1));
        let shrunk = match self.shrunk {
            1 => String::new(),
            k => format!(", a pixel shows {k} x {k}"),
        };
        let decimals = if width.max(height) < 1.0 { 2 } else { 1 };
        format!("{width:.decimals$} x {height:.decimals$} m, cells of {cell}{shrunk}")
    }
}
