//! The sheet of a view: where things are in it, the ground below them, what stands around.

use super::View;
use super::camera::Camera;
use super::raster::Raster;
use crate::PictureError;
use crate::colors::{GRID_LINE, PAPER};
use crate::sheet::{Sheet, Window, axes, in_metres, round_below, scale_bar, ticks_within};
use crate::text::{Align, Font, write};
use nalgebra::{Point2, Point3, Vector2};
use percept_geometry::{Aabb3, RgbImage};

/// Room around what is drawn, share of the drawing.
const ROOM: f64 = 0.03;

/// How metres of a view become pixels.
pub(super) struct Frame {
    pub(super) camera: Camera,
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) per_metre: f64,
    /// Metres right and up of the camera at the lower left corner.
    low: Vector2<f64>,
    /// What is shown, map frame.
    bounds: Aabb3,
    /// Heights below and above which half a per cent of the points lie: a few stray ones do not take the colours from all others.
    pub(super) heights: [f64; 2],
}

/// Every so many of the heights, never more than half a million.
#[derive(Default)]
struct Sample {
    kept: Vec<f32>,
    seen: usize,
    /// One of two to the power of this is kept.
    thinned: u32,
}

impl Sample {
    fn push(&mut self, z: f32) {
        if self.seen.is_multiple_of(1 << self.thinned) {
            self.kept.push(z);
        }
        self.seen += 1;
        if self.kept.len() >= 1 << 19 {
            let mut number = 0usize;
            self.kept.retain(|_| {
                number += 1;
                !number.is_multiple_of(2)
            });
            self.thinned += 1;
        }
    }

    fn spread(mut self) -> [f64; 2] {
        self.kept.sort_by(f32::total_cmp);
        [0.005, 0.995].map(|share| {
            let place = (share * self.kept.len().saturating_sub(1) as f64).round() as usize;
            self.kept.get(place).map_or(0.0, |z| f64::from(*z))
        })
    }
}

impl Frame {
    /// Around points that the camera shows; `reach` metres around each of them.
    pub(super) fn around<'a>(
        view: &View,
        points: impl IntoIterator<Item = &'a Point3<f32>>,
        reach: f64,
    ) -> Result<Self, PictureError> {
        let camera = view.camera()?;
        let mut bounds = Aabb3::empty();
        let (mut low, mut high) = (Vector2::repeat(f64::INFINITY), Vector2::repeat(f64::NEG_INFINITY));
        let mut sample = Sample::default();
        for p in points.into_iter().filter(|p| camera.shows(p)) {
            bounds.grow(&p.cast());
            sample.push(p.z);
            let at = camera.project(&p.cast()).xy();
            (low, high) = (low.inf(&at), high.sup(&at));
        }
        if bounds.is_empty() {
            (low, high) = (Vector2::zeros(), Vector2::new(2.0, 1.0));
        }
        (low, high) = (low - Vector2::repeat(reach), high + Vector2::repeat(reach));
        let size = (high - low).map(|s| s.max(1e-3));
        let room = ROOM * size.max();
        let (low, size) = (low - Vector2::repeat(room), size + Vector2::repeat(2.0 * room));
        let per_metre = view.edge_px as f64 / size.max();
        let pixels = |metres: f64, least: usize| ((metres * per_metre).ceil() as usize).clamp(least, view.edge_px);
        let (width, height) = (pixels(size.x, 380.min(view.edge_px)), pixels(size.y, 260.min(view.edge_px)));
        // What is narrow stands in the middle.
        let spare = Vector2::new(width as f64, height as f64) / per_metre - size;
        let low = low - 0.5 * spare.map(|s| s.max(0.0));
        Ok(Self { camera, width, height, per_metre, low, bounds, heights: sample.spread() })
    }

    /// Column, row (pixels; the centre of the first one is 0.5) and distance away (metres).
    pub(super) fn pixel(&self, p: &Point3<f32>) -> [f32; 3] {
        let at = self.camera.project(&p.cast());
        let x = (at.x - self.low.x) * self.per_metre;
        let y = self.height as f64 - (at.y - self.low.y) * self.per_metre;
        [x as f32, y as f32, at.z as f32]
    }

    pub(super) fn raster(&self) -> Raster {
        Raster::new(self.width, self.height)
    }

    /// Size of what is shown, and from where, in words.
    fn detail(&self, what: &str) -> String {
        let size = self.bounds.size();
        let cut =
            if self.camera.cut.is_finite() { format!(", cut at {:.2} m", self.camera.cut) } else { String::new() };
        format!("{what}, {:.1} x {:.1} x {:.1} m, {}{cut}", size.x, size.y, size.z, self.camera.words())
    }

    /// The picture: `what` is how many of what, edges are darkened by `strength`.
    pub(super) fn finish(
        &self,
        sheet: Sheet,
        what: &str,
        raster: &Raster,
        strength: f64,
    ) -> Result<RgbImage, PictureError> {
        let low = Point2::from(self.low);
        let is_above = self.camera.is_above;
        let size = (self.width, self.height);
        let tick_chars = if is_above { Window::tick_chars(low, size, self.per_metre) } else { 0 };
        // Where nothing is, no colour means anything.
        let bar = sheet.bar.filter(|_| !self.bounds.is_empty());
        let mut opened = Sheet { detail: self.detail(what), tick_chars, bar, ..sheet }.open(self.width, self.height);
        let (plot, e) = (opened.plot, opened.enlarge);
        opened.canvas.clip(Some(plot));
        let spacing = if self.bounds.is_empty() {
            let middle = ((plot.x0 + plot.x1) / 2, (plot.y0 + plot.y1) / 2);
            write(&mut opened.canvas, "nothing to show", middle, (Font::Title, Align::Center, e), [120; 3]);
            None
        } else if is_above {
            None
        } else {
            Some(self.ground(&mut opened))
        };
        let rows = raster.shaded(self.per_metre, strength);
        for (pixels, row) in opened.canvas.rows(plot).zip(rows) {
            for (pixel, color) in pixels.chunks_exact_mut(3).zip(row) {
                if let Some(color) = color {
                    pixel.copy_from_slice(&color);
                }
            }
        }
        opened.canvas.clip(None);
        if is_above {
            opened.finish(&Window { plot, low, per_metre: self.per_metre });
            return opened.canvas.into_image();
        }
        opened.border();
        let words = spacing.map(|s| format!(" on the ground (grid {})", in_metres(s))).unwrap_or_default();
        scale_bar(&mut opened.canvas, plot, self.per_metre, &words, e);
        axes(&mut opened.canvas, plot, &self.camera.axes(), e);
        opened.canvas.into_image()
    }

    /// A grid of lines on the ground below what is shown; how far apart they are, metres.
    fn ground(&self, opened: &mut crate::sheet::Opened) -> f64 {
        let (low, high) = (self.bounds.min, self.bounds.max);
        let longest = (high - low).xy().max().max(1e-3);
        let spacing = round_below(longest / 4.0).max(40.0 / self.per_metre);
        let spacing = round_below(spacing * 1.9);
        let pixel = |x: f64, y: f64| {
            let [x, y, _] = self.pixel(&Point3::new(x as f32, y as f32, self.heights[0] as f32));
            Point2::new(f64::from(opened.plot.x0) + f64::from(x), f64::from(opened.plot.y0) + f64::from(y))
        };
        let to = |v: f64, up: bool| if up { (v / spacing).ceil() * spacing } else { (v / spacing).floor() * spacing };
        let (x0, x1, y0, y1) = (to(low.x, false), to(high.x, true), to(low.y, false), to(high.y, true));
        let lines: Vec<_> = ticks_within(x0, x1, spacing)
            .into_iter()
            .map(|(x, _)| (pixel(x, y0), pixel(x, y1)))
            .chain(ticks_within(y0, y1, spacing).into_iter().map(|(y, _)| (pixel(x0, y), pixel(x1, y))))
            .collect();
        opened.canvas.fill(opened.plot, PAPER);
        lines.into_iter().for_each(|(a, b)| opened.canvas.line(a, b, 1.2 * f64::from(opened.enlarge), GRID_LINE));
        spacing
    }
}
