//! Brightness made comparable between frames: the logarithm of luma without its slow part.
//!
//! Exposure and gain multiply luma, so they add to its logarithm, and taking the mean of the
//! surroundings away removes them; so do lamps that light one side of a room.

use percept_geometry::RgbImage;
use rayon::prelude::*;

/// Added to luma (0..255) before the logarithm: below it, noise outweighs light. ATE of `evaluate rgbd rgbd-7scenes-a
/// 2`: halved 21.9, doubled 22.7 mm (22.3).
const DARK: f32 = 32.0;
/// Half width of the surroundings whose mean is taken away, pixels. ATE of `evaluate rgbd rgbd-7scenes-a 2` halved and
/// doubled 22.7 mm (22.3).
const SURROUNDINGS: usize = 12;
/// Rows a task: fixed, so that the number of threads changes nothing.
const ROWS: usize = 16;

/// Relative brightness (1 is a factor of e) on the grid of the frame, row-major; empty without colour.
#[derive(Debug, Clone, Default)]
pub(crate) struct Intensity {
    pub(crate) width: usize,
    pub(crate) height: usize,
    pub(crate) data: Vec<f32>,
    log: Vec<f32>,
    scratch: Vec<f32>,
}

/// Value and gradient (a pixel) between pixels.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Sampled {
    pub(crate) value: f32,
    pub(crate) du: f32,
    pub(crate) dv: f32,
}

impl Intensity {
    pub(crate) fn is_empty(&self) -> bool {
        self.data.is_empty()
    }

    pub(crate) fn clear(&mut self) {
        self.data.clear();
    }

    /// From an image shrunk by `factor` to `width x height`; `undistort` gives for each pixel of the grid
    /// where in the shrunk image it is looked up.
    pub(crate) fn fill(
        &mut self,
        image: &RgbImage,
        factor: usize,
        (width, height): (usize, usize),
        undistort: Option<&[[f32; 2]]>,
    ) {
        self.data.clear();
        if image.width() < width * factor || image.height() < height * factor || width < 8 || height < 8 {
            return;
        }
        (self.width, self.height) = (width, height);
        shrink(image, factor, width, height, &mut self.log);
        if let Some(table) = undistort {
            let source = std::mem::take(&mut self.log);
            let look_up = |&[u, v]: &[f32; 2]| sample(&source, width, height, u, v).map_or(f32::NAN, |s| s.value);
            self.log = table.iter().map(look_up).collect();
            // Outside the image is as its nearest seen neighbour in the row: flat, no texture.
            fill_gaps(&mut self.log, width);
        }
        smooth(&self.log, width, height, &mut self.scratch, &mut self.data);
        std::mem::swap(&mut self.log, &mut self.data);
        without_surroundings(&self.log, width, height, &mut self.scratch, &mut self.data);
    }

    /// Bilinear value and its gradient; none outside.
    #[inline]
    pub(crate) fn sample(&self, u: f32, v: f32) -> Option<Sampled> {
        sample(&self.data, self.width, self.height, u, v)
    }
}

#[inline]
fn sample(data: &[f32], width: usize, height: usize, u: f32, v: f32) -> Option<Sampled> {
    if !(u >= 0.0 && v >= 0.0 && u < (width - 1) as f32 && v < (height - 1) as f32) {
        return None;
    }
    let (x, y) = (u as usize, v as usize);
    let (a, b) = (u - x as f32, v - y as f32);
    let (top, low) = (&data[y * width + x..], &data[(y + 1) * width + x..]);
    let (left, right) = (top[0] + b * (low[0] - top[0]), top[1] + b * (low[1] - top[1]));
    let value = left + a * (right - left);
    let dv = (low[0] - top[0]) * (1.0 - a) + (low[1] - top[1]) * a;
    Some(Sampled { value, du: right - left, dv })
}

/// Logarithm of the mean luma of each block.
fn shrink(image: &RgbImage, f: usize, width: usize, height: usize, out: &mut Vec<f32>) {
    out.clear();
    out.resize(width * height, 0.0);
    let (data, stride) = (image.data(), 3 * image.width());
    let scale = 1.0 / (1000 * f * f) as f32;
    out.par_chunks_mut(width * ROWS).enumerate().for_each(|(c, rows)| {
        for (k, out) in rows.iter_mut().enumerate() {
            let (u, v) = (k % width * f, (c * ROWS + k / width) * f);
            let mut sum = 0u32;
            for y in v..v + f {
                for rgb in data[y * stride + 3 * u..y * stride + 3 * (u + f)].chunks_exact(3) {
                    sum += 299 * u32::from(rgb[0]) + 587 * u32::from(rgb[1]) + 114 * u32::from(rgb[2]);
                }
            }
            *out = (sum as f32 * scale + DARK).ln();
        }
    });
}

fn fill_gaps(log: &mut [f32], width: usize) {
    for row in log.chunks_exact_mut(width) {
        let mut last = row.iter().copied().find(|x| x.is_finite()).unwrap_or(0.0);
        for x in row {
            if x.is_finite() { last = *x } else { *x = last }
        }
    }
}

/// Binomial 3x3.
fn smooth(from: &[f32], width: usize, height: usize, scratch: &mut Vec<f32>, out: &mut Vec<f32>) {
    scratch.clear();
    scratch.resize(from.len(), 0.0);
    out.clear();
    out.resize(from.len(), 0.0);
    scratch.par_chunks_mut(width).zip(from.par_chunks(width)).for_each(|(out, row)| {
        out[0] = row[0];
        out[width - 1] = row[width - 1];
        for (o, w) in out[1..].iter_mut().zip(row.windows(3)) {
            *o = 0.25 * (w[0] + w[2]) + 0.5 * w[1];
        }
    });
    let rows = &*scratch;
    out.par_chunks_mut(width).enumerate().for_each(|(v, out)| {
        let row = |y: usize| &rows[y * width..(y + 1) * width];
        let (above, here, below) = (row(v.saturating_sub(1)), row(v), row((v + 1).min(height - 1)));
        for (u, o) in out.iter_mut().enumerate() {
            *o = 0.25 * (above[u] + below[u]) + 0.5 * here[u];
        }
    });
}

/// Takes the mean of a square around each pixel away, cut at the image's border.
fn without_surroundings(from: &[f32], width: usize, height: usize, scratch: &mut Vec<f32>, out: &mut Vec<f32>) {
    const R: usize = SURROUNDINGS;
    scratch.clear();
    scratch.resize(from.len(), 0.0);
    scratch.par_chunks_mut(width).zip(from.par_chunks(width)).for_each(|(out, row)| {
        let mut sum: f32 = row[..R.min(width)].iter().sum();
        for (u, o) in out.iter_mut().enumerate() {
            sum += row.get(u + R).copied().unwrap_or(0.0) - u.checked_sub(R + 1).map_or(0.0, |i| row[i]);
            *o = sum / ((u + R).min(width - 1) + 1 - u.saturating_sub(R)) as f32;
        }
    });
    out.clear();
    out.resize(from.len(), 0.0);
    let means = &*scratch;
    out.par_chunks_mut(width * ROWS).enumerate().for_each(|(c, rows)| {
        let first = c * ROWS;
        let mut sums = vec![0f32; width];
        for v in first.saturating_sub(R)..(first + R).min(height) {
            sums.iter_mut().zip(&means[v * width..]).for_each(|(s, m)| *s += m);
        }
        for (k, out) in rows.chunks_exact_mut(width).enumerate() {
            let v = first + k;
            if v + R < height {
                sums.iter_mut().zip(&means[(v + R) * width..]).for_each(|(s, m)| *s += m);
            }
            if let Some(gone) = v.checked_sub(R + 1).filter(|_| k > 0) {
                sums.iter_mut().zip(&means[gone * width..]).for_each(|(s, m)| *s -= m);
            }
            let n = ((v + R).min(height - 1) + 1 - v.saturating_sub(R)) as f32;
            for (u, o) in out.iter_mut().enumerate() {
                *o = from[v * width + u] - sums[u] / n;
            }
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(light: impl Fn(usize, usize) -> f32) -> RgbImage {
        let data = (0..80 * 60).flat_map(|i| [light(i % 80, i / 80).clamp(0.0, 255.0) as u8; 3]).collect();
        RgbImage::new(80, 60, data).unwrap()
    }

    #[test]
    fn the_surroundings_of_every_pixel_are_taken_away_as_by_definition() {
        let from: Vec<f32> = (0..80 * 60).map(|i| ((i * i) as f32 * 0.37).sin()).collect();
        let (mut scratch, mut out) = (vec![], vec![]);
        without_surroundings(&from, 80, 60, &mut scratch, &mut out);
        for (u, v) in [(0, 0), (79, 59), (40, 30), (5, 16), (70, 33), (12, 29)] {
            let (mut sum, mut n) = (0.0, 0.0);
            for y in v - v.min(12)..=(v + 12).min(59) {
                for x in u - u.min(12)..=(u + 12).min(79) {
                    sum += from[y * 80 + x];
                    n += 1.0;
                }
            }
            let expected = from[v * 80 + u] - sum / n;
            assert!((out[v * 80 + u] - expected).abs() < 1e-4, "{u} {v}");
        }
    }

    #[test]
    fn exposure_hardly_changes_it() {
        let scene = |u: usize, v: usize| if (u / 7 + v / 9).is_multiple_of(2) { 60.0 } else { 180.0 };
        let (mut a, mut b) = (Intensity::default(), Intensity::default());
        a.fill(&image(scene), 1, (80, 60), None);
        b.fill(&image(|u, v| 0.7 * scene(u, v)), 1, (80, 60), None);
        let contrast = a.data.iter().map(|x| x.abs()).sum::<f32>();
        let change = a.data.iter().zip(&b.data).map(|(x, y)| (x - y).abs()).sum::<f32>();
        assert!(change < 0.15 * contrast, "{change} of {contrast}");
        let s = a.sample(40.25, 30.5).unwrap();
        let t = a.sample(40.26, 30.5).unwrap();
        assert!(((t.value - s.value) / 0.01 - s.du).abs() < 1e-2);
    }
}
