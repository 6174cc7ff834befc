//! The local map on grids: a likelihood field to search in and line elements to refine on.

use nalgebra::{Isometry2, Point2, Vector2};
use percept_geometry::{Cell, GridGeometry};

/// A hit in base's plane; the normal is zero where neighbours make no line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Hit {
    pub(crate) p: Point2<f64>,
    pub(crate) n: Vector2<f64>,
    /// Whether it lies where a wall that is met by few beams would be met: elsewhere by the next scan.
    pub(crate) is_sparse: bool,
}

/// Fine cells along the edge of a coarse one.
pub(crate) const BLOCK: i32 = 4;
/// Reach of a hit's likelihood, fine cells. Where a hit is worth a tenth of what it is at its place.
const REACH: i32 = 3;
/// Standard deviation of a hit, fine cells. Halved 50.5 mm on the log with a short range, as loops are missed, doubled
/// 24.1, of 26.2 (see [`crate::odometry::lidar2d`]).
const SIGMA: f64 = 1.4;
/// Fine cells along the edge of a line element's cell.
const ELEMENT: i32 = 2;

/// Mean position and normal of the hits in a cell.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Element {
    p: Vector2<f32>,
    n: Vector2<f32>,
    num: f32,
}

/// Square grids around `center`. They are zero but near hits, and only what hits have touched is emptied again: pages
/// that none came near are never written, and take no memory.
#[derive(Debug)]
pub(crate) struct Field {
    geometry: GridGeometry,
    center: Point2<f64>,
    width: i32,
    fine: Vec<u8>,
    coarse: Vec<u8>,
    /// Cells that hits fell into.
    hit: Vec<Cell>,
    /// By the cell of a line element: its place among `elements` and one, or 0 if there is none.
    places: Vec<u32>,
    elements: Vec<Element>,
    kernel: Vec<u8>,
    /// The rows that hits have ever touched, from and up to: what was written once stays in memory.
    touched: (i32, i32),
}

impl Field {
    /// Empty, covering `half` metres to each side of `center`.
    pub(crate) fn new(resolution: f64, half: f64, center: Point2<f64>) -> Self {
        let width = (2.0 * half / resolution).ceil() as i32 / BLOCK * BLOCK + BLOCK;
        let origin = center - Vector2::repeat(0.5 * f64::from(width) * resolution);
        let side = 2 * REACH + 1;
        let kernel = (0..side * side)
            .map(|i| {
                let (x, y) = (f64::from(i % side - REACH), f64::from(i / side - REACH));
                (255.0 * (-(x * x + y * y) / (2.0 * SIGMA * SIGMA)).exp()) as u8
            })
            .collect();
        let cells = |block: i32| (width / block * (width / block)) as usize;
        Self {
            geometry: GridGeometry::new(resolution, origin),
            center,
            width,
            fine: vec![0; cells(1)],
            coarse: vec![0; cells(BLOCK)],
            hit: vec![],
            places: vec![0; cells(ELEMENT)],
            elements: vec![],
            kernel,
            touched: (i32::MAX, i32::MIN),
        }
    }

    /// Bytes that have been written, about.
    pub(crate) fn memory_bytes(&self) -> usize {
        let rows = self.touched.1.saturating_sub(self.touched.0).max(0) as usize;
        let (block, element) = (BLOCK as usize, ELEMENT as usize);
        let grids =
            rows * self.width as usize * (element * element * block * block + element * element + 4 * block * block)
                / (element * element * block * block);
        grids + self.hit.capacity() * size_of::<Cell>() + self.elements.capacity() * size_of::<Element>()
    }

    pub(crate) fn center(&self) -> Point2<f64> {
        self.center
    }

    pub(crate) fn resolution(&self) -> f64 {
        self.geometry.resolution_m
    }

    /// Empties the grids and moves them to `center`.
    pub(crate) fn reset(&mut self, center: Point2<f64>) {
        self.center = center;
        let half = 0.5 * f64::from(self.width) * self.resolution();
        self.geometry.origin = center - Vector2::repeat(half);
        for c in std::mem::take(&mut self.hit) {
            let (x, y) = (c.x - REACH, c.y - REACH);
            clear(&mut self.fine, self.width, (x, c.x + REACH), (y, c.y + REACH));
            let bounds = |low: i32, high: i32| (low / BLOCK - 1, high / BLOCK);
            clear(&mut self.coarse, self.width / BLOCK, bounds(x, c.x + REACH), bounds(y, c.y + REACH));
            let place = self.place(c);
            self.places[place] = 0;
        }
        self.elements.clear();
    }

    /// Where the place of the line element around a cell is kept.
    fn place(&self, c: Cell) -> usize {
        (c.y / ELEMENT * (self.width / ELEMENT) + c.x / ELEMENT) as usize
    }

    /// Adds the hits of a scan taken at `t`.
    pub(crate) fn add(&mut self, hits: &[Hit], t: &Isometry2<f64>) {
        for hit in hits {
            let p = t * hit.p;
            let Some(c) = self.geometry.cell(&p) else { continue };
            if c.x < REACH + BLOCK || c.y < REACH + BLOCK || c.x + REACH >= self.width || c.y + REACH >= self.width {
                continue;
            }
            self.smear(c);
            let place = self.place(c);
            if self.places[place] == 0 {
                self.elements.push(Element::default());
                self.places[place] = self.elements.len() as u32;
            }
            let e = &mut self.elements[self.places[place] as usize - 1];
            e.num += 1.0;
            let relative = (p - self.center).cast::<f32>();
            e.p += (relative - e.p) / e.num;
            e.n += (t.rotation * hit.n).cast::<f32>();
        }
    }

    fn smear(&mut self, c: Cell) {
        // Full likelihood is that of a hit in the cell itself, and another there adds nothing.
        if self.fine[(c.y * self.width + c.x) as usize] == u8::MAX {
            return;
        }
        self.hit.push(c);
        self.touched = (self.touched.0.min(c.y - REACH), self.touched.1.max(c.y + REACH + 1));
        let side = 2 * REACH + 1;
        let blocks = self.width / BLOCK;
        for dy in -REACH..=REACH {
            for dx in -REACH..=REACH {
                let value = self.kernel[((dy + REACH) * side + dx + REACH) as usize];
                let (x, y) = (c.x + dx, c.y + dy);
                let cell = &mut self.fine[(y * self.width + x) as usize];
                if value <= *cell {
                    continue;
                }
                *cell = value;
                // A coarse cell bounds all fine cells that its points reach within one block's shift.
                let (bx, by) = (x / BLOCK, y / BLOCK);
                for k in [by * blocks + bx, by * blocks + bx - 1, (by - 1) * blocks + bx, (by - 1) * blocks + bx - 1] {
                    let bound = &mut self.coarse[k as usize];
                    *bound = value.max(*bound);
                }
            }
        }
    }

    /// Fine cell of a point; may lie outside.
    #[inline]
    pub(crate) fn cell(&self, p: &Point2<f64>) -> (i32, i32) {
        let q = (p - self.geometry.origin) / self.geometry.resolution_m;
        (q.x.floor() as i32, q.y.floor() as i32)
    }

    /// Likelihood, 0..255; 0 outside.
    #[inline]
    pub(crate) fn fine(&self, x: i32, y: i32) -> u32 {
        if x < 0 || y < 0 || x >= self.width || y >= self.width {
            return 0;
        }
        u32::from(self.fine[(y * self.width + x) as usize])
    }

    /// Upper bound of the likelihoods at `x..x + BLOCK`, `y..y + BLOCK`; 0 outside.
    #[inline]
    pub(crate) fn bound(&self, x: i32, y: i32) -> u32 {
        if x < 0 || y < 0 || x >= self.width || y >= self.width {
            return 0;
        }
        u32::from(self.coarse[(y / BLOCK * (self.width / BLOCK) + x / BLOCK) as usize])
    }

    /// The nearest line element around `p` whose surface faces like `n` (or anywhere if that is zero):
    /// its point and unit normal (zero if it has none).
    pub(crate) fn element(&self, p: &Point2<f64>, n: &Vector2<f64>) -> Option<(Point2<f64>, Vector2<f64>)> {
        let (x, y) = self.cell(p);
        let (x, y, cells) = (x.div_euclid(ELEMENT), y.div_euclid(ELEMENT), self.width / ELEMENT);
        let mut best: Option<(f64, &Element)> = None;
        for cy in (y - 1).max(0)..=(y + 1).min(cells - 1) {
            for cx in (x - 1).max(0)..=(x + 1).min(cells - 1) {
                let place = self.places[(cy * cells + cx) as usize];
                let Some(e) = place.checked_sub(1).map(|i| &self.elements[i as usize]) else { continue };
                if e.n.cast::<f64>().dot(n) < 0.0 {
                    continue;
                }
                let d = (self.center + e.p.cast::<f64>() - p).norm_squared();
                if best.is_none_or(|b| d < b.0) {
                    best = Some((d, e));
                }
            }
        }
        best.map(|(_, e)| {
            let n = e.n.cast::<f64>();
            // Hits of surfaces that face apart, or without normals, make no line.
            let line = n.norm() > 0.6 * f64::from(e.num);
            (self.center + e.p.cast::<f64>(), if line { n.normalize() } else { Vector2::zeros() })
        })
    }
}

/// Zeroes a rectangle, both ends included, of a grid with rows of `width`.
fn clear(grid: &mut [u8], width: i32, (x0, x1): (i32, i32), (y0, y1): (i32, i32)) {
    for y in y0..=y1 {
        grid[(y * width + x0) as usize..=(y * width + x1) as usize].fill(0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_field_that_was_reset_is_like_a_new_one() {
        let hit = |x: f64, y: f64| Hit { p: Point2::new(x, y), n: Vector2::x(), is_sparse: false };
        let hits: Vec<Hit> =
            (0..400).map(f64::from).map(|i| hit((i * 0.7).sin() * 6.1, (i * 1.3).cos() * 6.1)).collect();
        let (mut field, new) = (Field::new(0.05, 5.0, Point2::origin()), Field::new(0.05, 5.0, Point2::new(1.0, 2.0)));
        field.add(&hits, &Isometry2::new(Vector2::new(0.3, 0.2), 0.4));
        assert!(field.fine.contains(&u8::MAX) && !field.elements.is_empty());
        field.reset(Point2::new(1.0, 2.0));
        assert_eq!((&field.fine, &field.coarse, &field.places), (&new.fine, &new.coarse, &new.places));
        assert_eq!((field.geometry, field.elements.len()), (new.geometry, 0));
    }
}
