//! An image in, the model's input out.

use crate::{ChannelOrder, Fit, InputSpec};
use percept_geometry::RgbImage;
use percept_perception::detection::ImageBox;

/// Grey that a letterbox is filled with, as models of that kind were trained.
const GROUND: u8 = 114;

/// Where the image lies in the input.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Placement {
    /// Pixels of the input for one of the image, along columns and rows.
    scale: [f64; 2],
    /// Pixels of the input before the image's first.
    offset: [usize; 2],
    /// Pixels of the input that the image takes.
    size: [usize; 2],
}

impl Placement {
    pub(crate) fn of(image: &RgbImage, input_px: [usize; 2], fit: Fit) -> Self {
        let of = [image.width(), image.height()];
        let ratio = |i: usize| input_px[i] as f64 / of[i] as f64;
        if fit == Fit::Stretch {
            return Self { scale: [ratio(0), ratio(1)], offset: [0; 2], size: input_px };
        }
        let scale = ratio(0).min(ratio(1));
        let size = [0, 1].map(|i| ((of[i] as f64 * scale).round() as usize).clamp(1, input_px[i]));
        Self { scale: [scale; 2], offset: [0, 1].map(|i| (input_px[i] - size[i]) / 2), size }
    }

    /// A box of the input in the image.
    pub(crate) fn to_image(self, b: &ImageBox) -> ImageBox {
        let back = |px: f64, i: usize| (px - self.offset[i] as f64) / self.scale[i];
        ImageBox {
            left_px: back(b.left_px, 0),
            top_px: back(b.top_px, 1),
            right_px: back(b.right_px, 0),
            bottom_px: back(b.bottom_px, 1),
        }
    }
}

/// The input, 3 x H x W row-major: the image, resized to its place, on a grey ground.
///
/// Pixels are interpolated linearly between the four nearest, to whole shades: not averaged where the image is shrunk. All as
/// OpenCV's `resize` does with 8 bits (INTER_LINEAR), by which detectors are trained and compared: weights have 11 bits, sums
/// along rows lose 4, products with the weights of columns 16. Half a shade's difference moves FastestDet's scores by 0.01.
pub(crate) fn prepare(image: &RgbImage, input_px: [usize; 2], placement: &Placement, spec: &InputSpec) -> Vec<f32> {
    let [width, height] = input_px;
    let plane = width * height;
    let channels: [Channel; 3] = std::array::from_fn(|channel| Channel::new(spec, channel));
    let mut out = vec![0.0; 3 * plane];
    for (channel, plane) in channels.iter().zip(out.chunks_exact_mut(plane.max(1))) {
        plane.fill(channel.values[usize::from(GROUND)]);
    }
    let [columns, rows] = [taps(image.width(), placement.size[0]), taps(image.height(), placement.size[1])];
    for (v, down) in rows.iter().enumerate() {
        let [upper, lower] = down.pixels.map(|row| &image.data()[3 * row * image.width()..]);
        let start = (placement.offset[1] + v) * width + placement.offset[0];
        for (u, across) in columns.iter().enumerate() {
            for (i, channel) in channels.iter().enumerate() {
                let [a, b] = across.pixels.map(|column| 3 * column + channel.of_pixel);
                let along = |row: &[u8]| u32::from(row[a]) * across.weights[0] + u32::from(row[b]) * across.weights[1];
                let share = |row: &[u8], weight: u32| ((along(row) >> 4) * weight) >> 16;
                let shade = (share(upper, down.weights[0]) + share(lower, down.weights[1]) + 2) >> 2;
                out[i * plane + start + u] = channel.values[shade.min(255) as usize];
            }
        }
    }
    out
}

/// A channel of the input.
struct Channel {
    /// Which of the pixel's it is.
    of_pixel: usize,
    /// What each shade becomes.
    values: Vec<f32>,
}

impl Channel {
    fn new(spec: &InputSpec, channel: usize) -> Self {
        let of_pixel = match spec.channel_order {
            ChannelOrder::Rgb => channel,
            ChannelOrder::Bgr => 2 - channel,
        };
        let value = |shade: u16| ((f64::from(shade) * spec.scale - spec.mean[channel]) / spec.std[channel]) as f32;
        Self { of_pixel, values: (0..256).map(value).collect() }
    }
}

/// The two pixels that a resized one lies between, and their weights, which add up to 2048.
struct Tap {
    pixels: [usize; 2],
    weights: [u32; 2],
}

/// Of each resized pixel. Centres of pixels are scaled about the image's edge; beyond the outer centres the outer ones go on.
fn taps(from: usize, to: usize) -> Vec<Tap> {
    let scale = from as f64 / to as f64;
    let last = from.saturating_sub(1);
    let tap = |i: usize| {
        let place = ((i as f64 + 0.5) * scale - 0.5).clamp(0.0, last as f64);
        let second = ((place - place.floor()) * 2048.0).round() as u32;
        Tap { pixels: [place as usize, (place as usize + 1).min(last)], weights: [2048 - second, second] }
    };
    (0..to).map(tap).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ramp(width: usize, height: usize) -> RgbImage {
        let pixel = |i: usize| [(i % width * 10) as u8, (i / width * 20) as u8, 77];
        RgbImage::new(width, height, (0..width * height).flat_map(pixel).collect()).unwrap()
    }

    fn prepared(image: &RgbImage, input_px: [usize; 2], spec: &InputSpec) -> (Placement, Vec<f32>) {
        let placement = Placement::of(image, input_px, spec.fit);
        (placement, prepare(image, input_px, &placement, spec))
    }

    #[test]
    fn an_image_of_the_inputs_size_is_taken_as_it_is() {
        let spec = InputSpec { scale: 1.0, channel_order: ChannelOrder::Bgr, ..InputSpec::default() };
        let (_, out) = prepared(&ramp(4, 3), [4, 3], &spec);
        assert_eq!(out[..12], [77.0; 12]);
        assert_eq!(out[12..24], [0.0, 0.0, 0.0, 0.0, 20.0, 20.0, 20.0, 20.0, 40.0, 40.0, 40.0, 40.0]);
        assert_eq!(out[24..28], [0.0, 10.0, 20.0, 30.0]);
    }

    #[test]
    fn halving_takes_the_mean_of_the_two_in_the_middle() {
        let spec = InputSpec { scale: 0.5, mean: [1.0, 2.0, 0.0], std: [2.0, 1.0, 0.5], ..InputSpec::default() };
        let (_, out) = prepared(&ramp(4, 4), [2, 2], &spec);
        let [red, green] = [[5.0f32, 25.0], [10.0, 50.0]].map(|r| r.map(|shade| shade * 0.5));
        assert_eq!(out[..4], [red[0], red[1], red[0], red[1]].map(|v| (v - 1.0) / 2.0));
        assert_eq!(out[4..8], [green[0], green[0], green[1], green[1]].map(|v| v - 2.0));
        assert_eq!(out[8..], [77.0; 4]);
    }

    #[test]
    fn a_letterbox_keeps_the_shape_and_boxes_come_back() {
        let spec = InputSpec { scale: 1.0, fit: Fit::Letterbox, ..InputSpec::default() };
        let (placement, out) = prepared(&ramp(8, 4), [4, 4], &spec);
        assert_eq!(out[..4], [114.0; 4]);
        assert_eq!(out[12..16], [114.0; 4]);
        assert_eq!(out[4..8], [5.0, 25.0, 45.0, 65.0]);
        let b = placement.to_image(&ImageBox { left_px: 1.0, top_px: 1.0, right_px: 4.0, bottom_px: 3.0 });
        assert_eq!(b, ImageBox { left_px: 2.0, top_px: 0.0, right_px: 8.0, bottom_px: 4.0 });
    }
}
