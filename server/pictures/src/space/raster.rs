//! A picture in tiles that are drawn side by side, each pixel showing what is nearest.

use crate::PictureError;
use crate::canvas::PixelBox;
use crate::colors::Color;
use rayon::prelude::*;

/// Edge of a tile, pixels.
const TILE: usize = 64;
/// Shapes in tiles that wait to be drawn: what the list of them may take.
const MAX_WAITING: usize = 1 << 22;
/// Pixels that may be drawn for a picture, each as often as something covers it: some ten seconds of one core.
const MAX_DRAWN: u64 = 6_000_000_000;

/// A square of the picture.
pub(super) struct Tile {
    /// Where it lies.
    pub(super) place: PixelBox,
    depth: Vec<f32>,
    color: Vec<Color>,
}

impl Tile {
    /// Shows a colour at a pixel of this tile if nothing nearer is there; of what is equally near, what came first.
    #[inline]
    pub(super) fn set(&mut self, x: i32, y: i32, depth: f32, color: impl FnOnce() -> Color) {
        let i = (y - self.place.y0) as usize * TILE + (x - self.place.x0) as usize;
        if depth < self.depth[i] {
            self.depth[i] = depth;
            self.color[i] = color();
        }
    }

    /// The part of a rectangle that lies in this tile.
    pub(super) fn part(&self, area: &PixelBox) -> PixelBox {
        let p = &self.place;
        PixelBox { x0: area.x0.max(p.x0), y0: area.y0.max(p.y0), x1: area.x1.min(p.x1), y1: area.y1.min(p.y1) }
    }
}

/// The whole picture.
pub(super) struct Raster {
    pub(super) width: usize,
    pub(super) height: usize,
    columns: usize,
    tiles: Vec<Tile>,
    drawn: u64,
}

impl Raster {
    pub(super) fn new(width: usize, height: usize) -> Self {
        let (columns, rows) = (width.div_ceil(TILE), height.div_ceil(TILE));
        let tile = |i: usize| {
            let (x, y) = (i % columns * TILE, i / columns * TILE);
            let size = (TILE.min(width - x) as i32, TILE.min(height - y) as i32);
            Tile {
                place: PixelBox::new(x as i32, y as i32, size.0, size.1),
                depth: vec![f32::INFINITY; TILE * TILE],
                color: vec![[255; 3]; TILE * TILE],
            }
        };
        Self { width, height, columns, tiles: (0..columns * rows).map(tile).collect(), drawn: 0 }
    }

    /// Draws `count` shapes: `bounds` tells the pixels that one may cover, or none; `draw` draws its part of a tile. The order counts
    /// where two are equally near, threads do not.
    ///
    /// # Errors
    /// `TooMuchOverdraw`.
    pub(super) fn draw(
        &mut self,
        count: usize,
        bounds: impl Fn(usize) -> Option<PixelBox> + Sync,
        draw: impl Fn(usize, &mut Tile) + Sync,
    ) -> Result<(), PictureError> {
        let mut waiting: Vec<(u32, u32)> = vec![];
        let all = PixelBox::new(0, 0, self.width as i32, self.height as i32);
        for from in (0..count).step_by(1 << 18) {
            let to = count.min(from + (1 << 18));
            let boxes: Vec<Option<PixelBox>> = (from..to)
                .into_par_iter()
                .map(|i| bounds(i).filter(|b| b.overlaps(&all)).map(|b| clipped(&b, &all)))
                .collect();
            for (i, area) in boxes.iter().enumerate().filter_map(|(i, b)| b.map(|b| (i, b))) {
                self.drawn += area.width() as u64 * area.height() as u64;
                if self.drawn > MAX_DRAWN {
                    return Err(PictureError::TooMuchOverdraw { pixels: self.drawn, limit: MAX_DRAWN });
                }
                let tile = |v: i32| v as usize / TILE;
                for row in tile(area.y0)..=tile(area.y1 - 1) {
                    for column in tile(area.x0)..=tile(area.x1 - 1) {
                        waiting.push(((row * self.columns + column) as u32, (from + i) as u32));
                    }
                }
                if waiting.len() >= MAX_WAITING {
                    self.flush(&mut waiting, &draw);
                }
            }
        }
        self.flush(&mut waiting, &draw);
        Ok(())
    }

    fn flush(&mut self, waiting: &mut Vec<(u32, u32)>, draw: &(impl Fn(usize, &mut Tile) + Sync)) {
        // By tile, and in it in the order of their numbers, by counting.
        let mut starts = vec![0usize; self.tiles.len() + 1];
        waiting.iter().for_each(|(tile, _)| starts[*tile as usize + 1] += 1);
        (0..self.tiles.len()).for_each(|i| starts[i + 1] += starts[i]);
        let mut sorted = vec![0u32; waiting.len()];
        let mut next = starts.clone();
        for (tile, shape) in waiting.drain(..) {
            sorted[next[tile as usize]] = shape;
            next[tile as usize] += 1;
        }
        self.tiles.par_iter_mut().enumerate().for_each(|(i, tile)| {
            sorted[starts[i]..starts[i + 1]].iter().for_each(|shape| draw(*shape as usize, tile));
        });
    }

    /// Closes gaps of a pixel or two between points: where most pixels around are nearer, what is behind does not show through.
    pub(super) fn fill_holes(&mut self, per_metre: f64) {
        let row = |y: usize| (0..self.width).map(|x| self.over_hole(x, y, per_metre)).collect();
        let rows: Vec<Vec<Option<(f32, Color)>>> = (0..self.height).into_par_iter().map(row).collect();
        for (y, row) in rows.into_iter().enumerate() {
            for (x, (depth, color)) in row.into_iter().enumerate().filter_map(|(x, new)| new.map(|new| (x, new))) {
                let tile = &mut self.tiles[y / TILE * self.columns + x / TILE];
                let i = y % TILE * TILE + x % TILE;
                (tile.depth[i], tile.color[i]) = (depth, color);
            }
        }
    }

    /// What covers a hole: the middle one by depth of the pixels around that are nearer, if most are.
    fn over_hole(&self, x: usize, y: usize, per_metre: f64) -> Option<(f32, Color)> {
        if x == 0 || y == 0 || x + 1 >= self.width || y + 1 >= self.height {
            return None;
        }
        let here = self.at(x, y).0;
        let around = [(0, 0), (1, 0), (2, 0), (0, 1), (2, 1), (0, 2), (1, 2), (2, 2)];
        let is_nearer = |depth: f32| f64::from(here - depth) * per_metre > 12.0;
        let mut nearer = [(0.0, [0; 3]); 8];
        let mut count = 0;
        for other in around.map(|(dx, dy)| self.at(x + dx - 1, y + dy - 1)) {
            if is_nearer(other.0) {
                nearer[count] = other;
                count += 1;
            }
        }
        if count < 5 {
            return None;
        }
        nearer[..count].sort_by(|a, b| a.0.total_cmp(&b.0));
        Some(nearer[count / 2])
    }

    fn at(&self, x: usize, y: usize) -> (f32, Color) {
        let tile = &self.tiles[y / TILE * self.columns + x / TILE];
        let i = y % TILE * TILE + x % TILE;
        (tile.depth[i], tile.color[i])
    }

    /// How far away what is seen at a pixel is; infinite where nothing is.
    pub(super) fn depth(&self, x: usize, y: usize) -> f32 {
        self.at(x, y).0
    }

    /// Rows of colours, with edges darkened where what is behind lies farther back; none where nothing is seen. `per_metre` are pixels,
    /// `strength` is 0 for no edges.
    ///
    /// Source: Boucheny, "Interactive scientific visualization of large datasets", 2009 (eye-dome lighting), in parallel projection.
    pub(super) fn shaded(&self, per_metre: f64, strength: f64) -> Vec<Vec<Option<Color>>> {
        let row = |y: usize| (0..self.width).map(|x| self.shaded_at(x, y, per_metre, strength)).collect();
        (0..self.height).into_par_iter().map(row).collect()
    }

    fn shaded_at(&self, x: usize, y: usize, per_metre: f64, strength: f64) -> Option<Color> {
        const REACH: i64 = 2;
        let (depth, color) = self.at(x, y);
        if !depth.is_finite() {
            return None;
        }
        let mut before = 0.0;
        for (dx, dy) in [(-REACH, 0), (REACH, 0), (0, -REACH), (0, REACH)] {
            let (nx, ny) = (x as i64 + dx, y as i64 + dy);
            if nx >= 0 && ny >= 0 && nx < self.width as i64 && ny < self.height as i64 {
                let other = self.depth(nx as usize, ny as usize);
                // Where nothing is, the rim is drawn faintly.
                let rise = if other.is_finite() { f64::from(depth - other) * per_metre } else { 0.0 };
                // A slope of a surface that is seen at an angle is no edge.
                before += (rise - 6.0).clamp(0.0, 40.0);
            }
        }
        Some(crate::colors::scaled(color, (-strength * before / 40.0).exp()))
    }
}

fn clipped(b: &PixelBox, all: &PixelBox) -> PixelBox {
    PixelBox { x0: b.x0.max(all.x0), y0: b.y0.max(all.y0), x1: b.x1.min(all.x1), y1: b.y1.min(all.y1) }
}
