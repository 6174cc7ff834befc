//! What was found in an image, drawn over it.

use crate::canvas::{Canvas, PixelBox};
use crate::colors::{AMBER, BLUE, Color, GREEN, MAGENTA, PURPLE, SKY, VERMILION};
use crate::text::{Align, Font, shortened, text_box, write_plated};
use crate::{MAX_EDGE, PictureError};
use nalgebra::{Point2, Point3};
use percept_geometry::{CameraIntrinsics, OrientedBox3, Pose, RgbImage};

/// Colours of things, in turn.
const COLORS: [Color; 7] = [VERMILION, BLUE, GREEN, AMBER, MAGENTA, SKY, PURPLE];
/// Images are enlarged by whole numbers until their longer edge has so many pixels.
const MIN_EDGE: usize = 900;
/// The nearest depth at which edges of boxes are drawn, metres.
const NEAR_M: f64 = 0.05;
/// Edges of a box, by the corners that [`OrientedBox3::corners`] counts.
const EDGES: [[usize; 2]; 12] =
    [[0, 1], [2, 3], [4, 5], [6, 7], [0, 2], [1, 3], [4, 6], [5, 7], [0, 4], [1, 5], [2, 6], [3, 7]];

/// A thing to be drawn over an image.
#[derive(Debug, Clone, PartialEq)]
pub struct ImageThing {
    /// Stands at its upper left corner; cut off after 40 characters.
    pub label: String,
    /// Left, top, right and bottom edge in the image, pixels.
    pub box_px: [f64; 4],
    /// Its box in space, in the camera's optical frame, if there is one.
    pub camera_box: Option<OrientedBox3>,
}

impl ImageThing {
    /// A thing with its box in the frame that the camera's pose is given in.
    pub fn new(label: String, box_px: [f64; 4], bbox: Option<OrientedBox3>, t_map_camera: &Pose) -> Self {
        Self { label, box_px, camera_box: bbox.map(|b| b.transformed(&t_map_camera.inverse())) }
    }
}

/// The image, enlarged if it is small, with a rectangle (thin) and the projected edges of the box in space (bold) for each
/// thing, in a colour of its own, and labels that do not hide each other as far as there is room.
///
/// # Errors
/// `OutOfRange` if the image is empty or larger than [`MAX_EDGE`], or the camera not usable.
pub fn things_in_image(
    image: &RgbImage,
    camera: &CameraIntrinsics,
    things: &[ImageThing],
) -> Result<RgbImage, PictureError> {
    let (w, h) = (image.width(), image.height());
    if w.min(h) == 0 || w.max(h) > MAX_EDGE {
        let requirement = "between 1 and 4096 pixels along each edge";
        return Err(PictureError::OutOfRange { field: "image", value: w.max(h) as f64, requirement });
    }
    camera.validate().map_err(|_| PictureError::OutOfRange {
        field: "camera",
        value: camera.fx,
        requirement: "usable intrinsics",
    })?;
    let enlarge = MIN_EDGE.div_ceil(w.max(h)).min(MAX_EDGE / w.max(h)).max(1);
    let mut canvas = enlarged(image, enlarge);
    let scale = enlarge as f64;
    let color = |i: usize| COLORS[i % COLORS.len()];
    for (i, thing) in things.iter().enumerate() {
        let [left, top, right, bottom] = thing.box_px.map(|px| px * scale);
        let corners = [(left, top), (right, top), (right, bottom), (left, bottom)].map(|(x, y)| Point2::new(x, y));
        canvas.closed(&corners, 1.5, color(i));
        let Some(bbox) = thing.camera_box else { continue };
        let corners = bbox.corners();
        for [a, b] in EDGES {
            let Some((a, b)) = before_camera(corners[a], corners[b]) else { continue };
            // Intrinsics count from pixels' centres.
            let place =
                |p: Point3<f64>| camera.project(&p).map(|p| Point2::new((p.x + 0.5) * scale, (p.y + 0.5) * scale));
            if let (Some(a), Some(b)) = (place(a), place(b)) {
                canvas.line(a, b, 3.0, color(i));
            }
        }
    }
    let mut taken: Vec<PixelBox> = vec![];
    for (i, thing) in things.iter().enumerate() {
        label(&mut canvas, &mut taken, thing, scale, (w * enlarge, h * enlarge), color(i));
    }
    canvas.into_image()
}

fn enlarged(image: &RgbImage, by: usize) -> Canvas {
    let (w, h) = (image.width() * by, image.height() * by);
    let mut canvas = Canvas::new(w, h, [0; 3]);
    let all = PixelBox::new(0, 0, w as i32, h as i32);
    for (y, row) in canvas.rows(all).enumerate() {
        for (x, pixel) in row.chunks_exact_mut(3).enumerate() {
            pixel.copy_from_slice(&image.at(x / by, y / by));
        }
    }
    canvas
}

/// The part of a line of the optical frame that lies before the camera.
fn before_camera(a: Point3<f64>, b: Point3<f64>) -> Option<(Point3<f64>, Point3<f64>)> {
    if a.z > b.z {
        return before_camera(b, a).map(|(b, a)| (a, b));
    }
    if b.z.is_nan() || b.z <= NEAR_M {
        return None;
    }
    let from = if a.z < NEAR_M { a + (b - a) * ((NEAR_M - a.z) / (b.z - a.z)) } else { a };
    Some((from, b))
}

/// At the upper left corner, inside of the picture, moved down line by line while another label is there.
fn label(
    canvas: &mut Canvas,
    taken: &mut Vec<PixelBox>,
    thing: &ImageThing,
    scale: f64,
    (width, height): (usize, usize),
    color: Color,
) {
    let text = shortened(&thing.label, 40);
    let (line, wide) = (Font::Small.height(1) + 1, Font::Small.width(&text, 1));
    let clamped = |px: f64, most: i32| (px * scale).clamp(0.0, f64::from(most.max(0))) as i32;
    let x = clamped(thing.box_px[0], width as i32 - wide - 4) + 2;
    let top = clamped(thing.box_px[1], height as i32 - line);
    let free = (0..8).map(|i| text_box(&text, x, top + i * line, Font::Small, Align::Left, 1));
    let place = free.clone().find(|b| !taken.iter().any(|t| t.overlaps(b))).or(free.clone().next());
    if let Some(place) = place {
        taken.push(place);
        write_plated(
            canvas,
            &text,
            (place.x0, place.y0),
            (Font::Small, Align::Left, 1),
            crate::colors::scaled(color, 0.7),
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    fn thing(bbox: Option<OrientedBox3>) -> ImageThing {
        ImageThing::new("cup 0.71".into(), [10.0, 10.0, 60.0, 50.0], bbox, &Pose::identity())
    }

    fn drawn(things: &[ImageThing]) -> RgbImage {
        let camera = CameraIntrinsics::pinhole(100, 80, 90.0, 90.0, 49.5, 39.5);
        things_in_image(&RgbImage::new(100, 80, vec![90; 24000]).unwrap(), &camera, things).unwrap()
    }

    #[test]
    fn edges_of_a_box_are_where_the_camera_sees_them() {
        let bbox = OrientedBox3::upright(Point3::new(0.0, 0.0, 2.5), Vector3::new(0.8, 0.6, 1.0), 0.0);
        let image = drawn(&[ImageThing { label: String::new(), ..thing(Some(bbox)) }]);
        assert_eq!((image.width(), image.height()), (900, 720));
        // The near side is at 2 m: its right edge at 49.5 + 90 * 0.4 / 2 pixels, and the half that is left of the first.
        assert_eq!(image.at(((49.5 + 18.0 + 0.5) * 9.0) as usize, 360), VERMILION);
        assert_eq!(image.at(450, 360), [90; 3]);
    }

    #[test]
    fn what_is_behind_the_camera_or_not_finite_is_left_out() {
        let plain = drawn(&[thing(None)]);
        let behind = OrientedBox3::upright(Point3::new(0.0, 0.0, -2.5), Vector3::new(0.8, 0.6, 1.0), 0.0);
        assert_eq!(drawn(&[thing(Some(behind))]), plain);
        let around = OrientedBox3::upright(Point3::origin(), Vector3::new(0.5, 0.4, 4.0), 0.3);
        assert_ne!(drawn(&[thing(Some(around))]), plain);
        drawn(&[ImageThing { box_px: [f64::NAN, f64::INFINITY, -1e300, 1e300], ..thing(None) }]);
        let lost = OrientedBox3::upright(Point3::new(f64::NAN, 0.0, 2.0), Vector3::new(0.8, 0.6, 1.0), 0.0);
        drawn(&[thing(Some(lost))]);
    }

    #[test]
    fn images_without_pixels_are_refused() {
        let camera = CameraIntrinsics::primesense();
        let error = things_in_image(&RgbImage::new(0, 4, vec![]).unwrap(), &camera, &[]).unwrap_err();
        assert!(error.to_string().starts_with("image: "), "{error}");
    }
}
