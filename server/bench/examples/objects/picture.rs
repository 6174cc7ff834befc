//! A scan from above with labels and what was found, to look at what is missed.

use crate::Failure;
use crate::truth::Frame;
use nalgebra::Point2;
use percept_geometry::{ObjectClass, OrientedBox3, RgbImage};
use percept_perception::detection::Detection;
use std::path::Path;

/// Pixels along an edge, and a metre.
const EDGE: usize = 1200;
const SCALE: f64 = 12.0;

/// Points are dark the higher they are; labels green (grey with few points); what was found: vehicles blue, people and
/// cyclists red, unknown light brown; a stroke of confidence leads from its middle ahead. What the camera sees is
/// white.
pub(crate) fn draw(frame: &Frame, found: &[Detection], out: &Path) -> Result<(), Failure> {
    let mut canvas = Canvas { pixels: vec![[255; 3]; EDGE * EDGE] };
    for v in 0..EDGE {
        for u in 0..EDGE {
            let p = canvas.place(u, v);
            if frame.camera.pixel(&nalgebra::Point3::new(p.x, p.y, -1.0)).is_none() {
                canvas.pixels[v * EDGE + u] = [244, 244, 240];
            }
        }
    }
    for p in &frame.scan.positions {
        let shade = (200.0 - 60.0 * (f64::from(p.z) + 1.6).clamp(0.0, 3.0)) as u8;
        canvas.dot(&Point2::new(f64::from(p.x), f64::from(p.y)), [shade; 3]);
    }
    for object in &frame.objects {
        canvas.outline(&object.bbox, if object.num_points >= 10 { [0, 170, 60] } else { [170, 190, 170] }, 2.0);
    }
    for d in found {
        let color = match d.class {
            ObjectClass::Unknown => [225, 190, 140],
            ObjectClass::Person | ObjectClass::Cyclist | ObjectClass::Motorcycle => [220, 20, 30],
            _ => [20, 60, 230],
        };
        canvas.outline(&d.bbox, color, 0.0);
        let ahead = d.bbox.t_frame_box * nalgebra::Point3::new(0.5 * d.bbox.size.x * d.confidence, 0.0, 0.0);
        canvas.line(&d.bbox.center().xy(), &ahead.xy(), color, 0.0);
    }
    let image = RgbImage::new(EDGE, EDGE, canvas.pixels.concat())?;
    Ok(std::fs::write(out, percept_formats::images::encode_rgb_png(&image)?)?)
}

struct Canvas {
    pixels: Vec<[u8; 3]>,
}

impl Canvas {
    /// Ahead is up, the sensor a third from below.
    fn place(&self, u: usize, v: usize) -> Point2<f64> {
        let (du, dv) = (u as f64 - 0.5 * EDGE as f64, 0.6 * EDGE as f64 - v as f64);
        Point2::new(dv / SCALE, -du / SCALE)
    }

    fn dot(&mut self, p: &Point2<f64>, color: [u8; 3]) {
        let (u, v) = (0.5 * EDGE as f64 - p.y * SCALE, 0.6 * EDGE as f64 - p.x * SCALE);
        if (0.0..EDGE as f64).contains(&u) && (0.0..EDGE as f64).contains(&v) {
            self.pixels[v as usize * EDGE + u as usize] = color;
        }
    }

    fn line(&mut self, a: &Point2<f64>, b: &Point2<f64>, color: [u8; 3], wide: f64) {
        let steps = ((b - a).norm() * SCALE * 2.0).ceil().max(1.0);
        let across = nalgebra::Vector2::new(-(b - a).y, (b - a).x).try_normalize(1e-9).unwrap_or_default() / SCALE;
        for i in 0..=steps as usize {
            let p = a + (b - a) * (i as f64 / steps);
            for side in [0.0, wide] {
                self.dot(&(p + across * side), color);
            }
        }
    }

    fn outline(&mut self, bbox: &OrientedBox3, color: [u8; 3], wide: f64) {
        let corners = bbox.footprint();
        for i in 0..4 {
            self.line(&corners[i], &corners[(i + 1) % 4], color, wide);
        }
    }
}
