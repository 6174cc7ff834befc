//! A surface of triangles, lit from beside the viewer.

use super::View;
use super::camera::{Camera, is_somewhere};
use super::picture::Frame;
use super::raster::Tile;
use crate::PictureError;
use crate::canvas::PixelBox;
use crate::colors::{Color, INK, Scale, scaled};
use crate::sheet::{ColorBar, Entry, Sheet, Swatch, enlargement};
use nalgebra::{Point3, Vector2, Vector3};
use percept_geometry::RgbImage;
use percept_mapping::MeshData;
use rayon::prelude::*;

/// What the surface is given as where it has no colour.
const NO_COLOR: Color = [128; 3];

/// A surface with light and shade: its own colours, or by height (viridis) where it has none. Triangles that face away from the viewer
/// are not drawn, so that one looks over near walls into the rooms. Where the surface goes through the height of the cut, a dark line
/// shows the section: from above, these are the walls. Corners that are not finite, and triangles without area or vertices, are left
/// out.
///
/// # Errors
/// `OutOfRange` for a view that cannot be; `ShapeMismatch` for normals or colours that are neither none nor one a vertex;
/// `TooMuchOverdraw` for millions of triangles that each cover the picture.
pub fn mesh_view(mesh: &MeshData, view: &View, title: &str) -> Result<RgbImage, PictureError> {
    let expected = mesh.positions.len();
    for (field, actual) in [("normals", mesh.normals.len()), ("colors", mesh.colors.len())] {
        if actual != 0 && actual != expected {
            return Err(PictureError::ShapeMismatch { field, expected, actual });
        }
    }
    let frame = Frame::around(view, &mesh.positions, 0.0)?;
    let has_colors = mesh.colors.par_iter().any(|c| *c != NO_COLOR);
    let bar = ColorBar::over("height [m]", Scale::Viridis, frame.heights.into_iter());
    let surface = Surface {
        mesh,
        camera: &frame.camera,
        light: light(&frame.camera),
        bar: (!has_colors).then_some(&bar),
        frame: &frame,
        pixels: mesh.positions.par_iter().map(|p| frame.pixel(p)).collect(),
    };
    let mut raster = frame.raster();
    raster.draw(mesh.triangles.len(), |i| surface.bounds(i), |i, tile| surface.draw(i, tile))?;
    raster.draw(mesh.triangles.len(), |i| surface.section_bounds(i), |i, tile| surface.draw_section(i, tile))?;
    let has_section = (0..mesh.triangles.len()).into_par_iter().any(|i| surface.section(i).is_some());
    let section = has_section.then(|| Entry::new(Swatch::Line(INK), format!("section at {:.2} m", frame.camera.cut)));
    let sheet = Sheet {
        title: title.to_owned(),
        bar: (!has_colors).then(|| bar.clone()),
        legend: section.into_iter().collect(),
        ..Sheet::default()
    };
    frame.finish(sheet, &format!("{} triangles", mesh.triangles.len()), &raster, 0.8)
}

/// Towards the light: from the viewer's left, a bit above.
fn light(camera: &Camera) -> Vector3<f64> {
    let left = Vector3::new(camera.ahead.y, -camera.ahead.x, 0.0).try_normalize(1e-6).unwrap_or(-Vector3::x());
    (-camera.ahead - 0.55 * left + Vector3::new(0.0, 0.0, 0.6)).normalize()
}

struct Surface<'a> {
    mesh: &'a MeshData,
    camera: &'a Camera,
    light: Vector3<f64>,
    bar: Option<&'a ColorBar>,
    frame: &'a Frame,
    pixels: Vec<[f32; 3]>,
}

impl Surface<'_> {
    /// Numbers of a triangle's vertices, if all are somewhere and one is shown.
    fn corners(&self, triangle: usize) -> Option<[usize; 3]> {
        let corners = self.mesh.triangles[triangle].map(|i| i as usize);
        let is_there = |i: &usize| self.mesh.positions.get(*i).is_some_and(is_somewhere);
        let is_shown = |i: &usize| self.mesh.positions[*i].z <= self.camera.cut;
        (corners.iter().all(is_there) && corners.iter().any(is_shown)).then_some(corners)
    }

    fn bounds(&self, triangle: usize) -> Option<PixelBox> {
        let [a, b, c] = self.corners(triangle)?.map(|i| self.pixels[i]);
        // Rows go down: what is counter-clockwise to the viewer has a negative area here.
        if area(&a, &b, &c) >= 0.0 {
            return None;
        }
        let low = |i: usize| (a[i].min(b[i]).min(c[i]) - 0.5).floor() as i32;
        let high = |i: usize| (a[i].max(b[i]).max(c[i]) + 0.5).ceil() as i32;
        Some(PixelBox { x0: low(0), y0: low(1), x1: high(0), y1: high(1) })
    }

    fn draw(&self, triangle: usize, tile: &mut Tile) {
        let (Some(corners), Some(bounds)) = (self.corners(triangle), self.bounds(triangle)) else { return };
        let [a, b, c] = corners.map(|i| self.pixels[i]);
        let whole = f64::from(area(&a, &b, &c));
        let heights = corners.map(|i| f64::from(self.mesh.positions[i].z));
        let is_cut = heights.iter().any(|z| *z > f64::from(self.camera.cut));
        // Most triangles of large meshes cover no pixel's centre, and need no colour.
        let mut lit = None;
        let part = tile.part(&bounds);
        for y in part.y0..part.y1 {
            for x in part.x0..part.x1 {
                let p = [x as f32 + 0.5, y as f32 + 0.5, 0.0];
                let weights = [area(&b, &c, &p), area(&c, &a, &p), area(&a, &b, &p)].map(|w| f64::from(w) / whole);
                // A hair of grace, or single pixels between neighbours stay empty.
                if weights.iter().all(|w| *w >= -1e-4) {
                    let mixed = |values: [f64; 3]| (0..3).map(|i| weights[i] * values[i]).sum::<f64>();
                    if is_cut && mixed(heights) > f64::from(self.camera.cut) {
                        continue;
                    }
                    let depth = mixed([a[2], b[2], c[2]].map(f64::from));
                    tile.set(x, y, depth as f32, || {
                        let colors = lit.get_or_insert_with(|| self.colors(corners));
                        let channel = |i: usize| mixed([colors[0][i], colors[1][i], colors[2][i]]);
                        [channel(0), channel(1), channel(2)].map(|v| v.round().clamp(0.0, 255.0) as u8)
                    });
                }
            }
        }
    }

    /// Ends of the line along which a triangle goes through the cut, pixels and metres away.
    fn section(&self, triangle: usize) -> Option<[[f32; 3]; 2]> {
        let corners = self.corners(triangle)?.map(|i| self.mesh.positions[i]);
        let cut = self.camera.cut;
        let mut ends = (0..3).filter_map(|i| {
            let (a, b) = (corners[i], corners[(i + 1) % 3]);
            ((a.z > cut) != (b.z > cut)).then(|| self.frame.pixel(&(a + (b - a) * ((cut - a.z) / (b.z - a.z)))))
        });
        Some([ends.next()?, ends.next()?])
    }

    fn section_bounds(&self, triangle: usize) -> Option<PixelBox> {
        let [a, b] = self.section(triangle)?;
        let low = |i: usize| (a[i].min(b[i]) - 1.5 * self.line_width()).floor() as i32;
        let high = |i: usize| (a[i].max(b[i]) + 1.5 * self.line_width()).ceil() as i32;
        Some(PixelBox { x0: low(0), y0: low(1), x1: high(0), y1: high(1) })
    }

    fn draw_section(&self, triangle: usize, tile: &mut Tile) {
        let (Some([a, b]), Some(bounds)) = (self.section(triangle), self.section_bounds(triangle)) else { return };
        let along = Vector2::new(b[0] - a[0], b[1] - a[1]);
        // A bit nearer than the surface that ends there.
        let nearer = 3.0 / self.frame.per_metre as f32;
        let part = tile.part(&bounds);
        for y in part.y0..part.y1 {
            for x in part.x0..part.x1 {
                let p = Vector2::new(x as f32 + 0.5 - a[0], y as f32 + 0.5 - a[1]);
                let share = (p.dot(&along) / along.norm_squared().max(1e-12)).clamp(0.0, 1.0);
                if (p - along * share).norm() <= 0.5 * self.line_width() {
                    tile.set(x, y, a[2] + (b[2] - a[2]) * share - nearer, || INK);
                }
            }
        }
    }

    /// Of sections, pixels.
    fn line_width(&self) -> f32 {
        2.6 * enlargement(self.frame.width.max(self.frame.height)) as f32
    }

    /// Lit colours of a triangle's corners.
    fn colors(&self, corners: [usize; 3]) -> [[f64; 3]; 3] {
        let [a, b, c] = corners.map(|i| self.mesh.positions[i].cast::<f64>());
        let flat = (b - a).cross(&(c - a)).try_normalize(1e-30).unwrap_or(-self.camera.ahead);
        corners.map(|i| {
            let own = self.mesh.normals.get(i).map(|n| n.cast::<f64>());
            let normal = own.filter(|n| (0.5..2.0).contains(&n.norm())).map_or(flat, |n| n.normalize());
            let lit = normal.dot(&self.light);
            // Half of what faces away still has shape: it is not black.
            let shade = 0.42 + 0.62 * (0.5 * (lit + 1.0)).powf(1.4);
            scaled(self.base(i, &self.mesh.positions[i]), shade).map(f64::from)
        })
    }

    fn base(&self, vertex: usize, p: &Point3<f32>) -> Color {
        match self.bar {
            Some(bar) => bar.color(f64::from(p.z)),
            None => self.mesh.colors[vertex],
        }
    }
}

/// Twice the area of a triangle of pixels, positive if clockwise as one sees it.
fn area(a: &[f32; 3], b: &[f32; 3], c: &[f32; 3]) -> f32 {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}
