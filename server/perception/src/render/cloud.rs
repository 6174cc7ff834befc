//! A cloud as a picture.

use super::colors;
use super::view::{Projection, View};
use percept_geometry::{GeometryError, PointCloud, RgbImage, cloud::is_finite};
use serde::{Deserialize, Serialize};

/// What gives a point its colour.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Coloring {
    /// Its own colour, else its label, else its intensity, else its height.
    #[default]
    Auto,
    /// The cloud's colours; grey without.
    Own,
    /// z, from the lowest (blue) to the highest (red).
    Height,
    /// The direction of its normal; grey without.
    Normal,
    /// Its label, e.g. number of a cluster; grey without.
    Label,
    /// Its intensity, from the lowest (blue) to the highest (red).
    Intensity,
}

/// How a cloud is drawn.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RenderParams {
    /// From where.
    pub view: View,
    /// In which colours.
    pub coloring: Coloring,
    /// Columns, 16 to 4096.
    pub width_px: usize,
    /// Rows, 16 to 4096.
    pub height_px: usize,
    /// Edge of a point, pixels, 1 to 20; 0 chooses by the number of points.
    pub point_size_px: usize,
    /// Colour where no point is.
    pub background: [u8; 3],
    /// Darkens points behind the edges of nearer ones, which shows depth.
    pub shade: bool,
}

impl Default for RenderParams {
    fn default() -> Self {
        Self {
            view: View::Top,
            coloring: Coloring::Auto,
            width_px: 1024,
            height_px: 768,
            point_size_px: 0,
            background: [255; 3],
            shade: true,
        }
    }
}

impl RenderParams {
    /// Checks every field.
    ///
    /// # Errors
    /// `OutOfRange` naming field, value and requirement.
    pub fn validate(&self) -> Result<(), GeometryError> {
        let within = |field, value: usize, low: usize, high: usize, requirement| {
            if (low..=high).contains(&value) {
                return Ok(());
            }
            Err(GeometryError::OutOfRange { field, value: value as f64, requirement })
        };
        within("width_px", self.width_px, 16, 4096, "16 to 4096")?;
        within("height_px", self.height_px, 16, 4096, "16 to 4096")?;
        within("point_size_px", self.point_size_px, 0, 20, "0 to 20")
    }
}

/// Draws a cloud. `labels`, one a point, are used by [`Coloring::Label`]. Points with a non-finite coordinate are left
/// out; an empty cloud is an empty picture.
///
/// # Errors
/// `OutOfRange` for parameters, `ShapeMismatch` for channels or labels that are not one a point.
pub fn render_cloud(
    cloud: &PointCloud,
    labels: Option<&[Option<u32>]>,
    params: &RenderParams,
) -> Result<RgbImage, GeometryError> {
    params.validate()?;
    cloud.validate()?;
    if let Some(actual) = labels.map(<[_]>::len).filter(|n| *n != cloud.len()) {
        return Err(GeometryError::ShapeMismatch { field: "labels", expected: cloud.len(), actual });
    }
    let drawn: Vec<usize> = (0..cloud.len()).filter(|&i| is_finite(&cloud.positions[i])).collect();
    let points: Vec<_> = drawn.iter().map(|&i| cloud.positions[i]).collect();
    let (width, height) = (params.width_px, params.height_px);
    let projection = Projection::fit(params.view, &points, width, height);
    let paint = Paint::new(cloud, labels, params.coloring, &drawn);
    let size = match params.point_size_px {
        0 => ((width * height) as f64 / (2.0 * points.len().max(1) as f64)).sqrt().round().clamp(1.0, 5.0) as i64,
        n => n as i64,
    };
    let mut pixels = vec![params.background; width * height];
    let mut nearest = vec![f32::INFINITY; width * height];
    for (&i, p) in drawn.iter().zip(&points) {
        let Some((u, v, away)) = projection.project(p) else { continue };
        let corner = |x: f64| (x - 0.5 * size as f64).round() as i64;
        let (x0, y0) = (corner(u), corner(v));
        let color = paint.color(i);
        for y in y0.max(0)..(y0 + size).min(height as i64) {
            for x in x0.max(0)..(x0 + size).min(width as i64) {
                let at = y as usize * width + x as usize;
                if away < nearest[at] {
                    nearest[at] = away;
                    pixels[at] = color;
                }
            }
        }
    }
    if params.shade && matches!(params.view, View::Perspective | View::Camera) {
        shade(&mut pixels, &nearest, width);
    }
    RgbImage::new(width, height, pixels.into_flattened())
}

/// Eye-dome lighting: darker the farther a pixel lies behind its neighbours (Boucheny 2009).
fn shade(pixels: &mut [[u8; 3]], nearest: &[f32], width: usize) {
    let height = nearest.len() / width;
    for y in 0..height {
        for x in 0..width {
            let here = nearest[y * width + x];
            if !here.is_finite() {
                continue;
            }
            let neighbours = [
                (x > 1).then(|| nearest[y * width + x - 2]),
                (x + 2 < width).then(|| nearest[y * width + x + 2]),
                (y > 1).then(|| nearest[(y - 2) * width + x]),
                (y + 2 < height).then(|| nearest[(y + 2) * width + x]),
            ];
            let behind: f32 = neighbours
                .into_iter()
                .flatten()
                .filter(|n| n.is_finite())
                .map(|n| (here / n).ln().clamp(0.0, 0.1))
                .sum();
            let light = (-12.0 * behind).exp().max(0.35);
            pixels[y * width + x] = pixels[y * width + x].map(|c| (f32::from(c) * light) as u8);
        }
    }
}

/// Colours of a cloud's points.
struct Paint<'a> {
    cloud: &'a PointCloud,
    labels: Option<&'a [Option<u32>]>,
    by: Coloring,
    /// Lowest and highest value that gets a colour of its own.
    range: (f32, f32),
}

impl<'a> Paint<'a> {
    fn new(cloud: &'a PointCloud, labels: Option<&'a [Option<u32>]>, by: Coloring, drawn: &[usize]) -> Self {
        let by = match by {
            Coloring::Auto if cloud.colors.is_some() => Coloring::Own,
            Coloring::Auto if labels.is_some() => Coloring::Label,
            Coloring::Auto if cloud.intensities.is_some() => Coloring::Intensity,
            Coloring::Auto => Coloring::Height,
            chosen => chosen,
        };
        let mut out = Self { cloud, labels, by, range: (0.0, 1.0) };
        let step = drawn.len().div_ceil(20_000).max(1);
        let mut values: Vec<f32> =
            drawn.iter().step_by(step).map(|&i| out.value(i)).filter(|v| v.is_finite()).collect();
        values.sort_by(f32::total_cmp);
        let at = |share: f64| values.get((share * values.len().saturating_sub(1) as f64) as usize).copied();
        if let (Some(low), Some(high)) = (at(0.01), at(0.99)) {
            out.range = (low, high.max(low + 1e-6));
        }
        out
    }

    fn value(&self, i: usize) -> f32 {
        match (self.by, &self.cloud.intensities) {
            (Coloring::Intensity, Some(intensities)) => intensities[i],
            _ => self.cloud.positions[i].z,
        }
    }

    fn color(&self, i: usize) -> [u8; 3] {
        match self.by {
            Coloring::Own => self.cloud.colors.as_ref().map_or([150; 3], |c| c[i]),
            Coloring::Normal => self.cloud.normals.as_ref().map_or([150; 3], |n| colors::direction(&n[i])),
            Coloring::Label => colors::label(self.labels.and_then(|l| l[i])),
            Coloring::Auto | Coloring::Height | Coloring::Intensity => {
                colors::ramp((self.value(i) - self.range.0) / (self.range.1 - self.range.0))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Point3, Vector3};

    fn small(view: View, coloring: Coloring) -> RenderParams {
        RenderParams { view, coloring, width_px: 64, height_px: 64, point_size_px: 1, ..RenderParams::default() }
    }

    fn pixel(image: &RgbImage, x: usize, y: usize) -> [u8; 3] {
        image.at(x, y)
    }

    #[test]
    fn from_above_the_highest_of_two_points_is_seen() {
        let corners = [[-1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 1.0]];
        for order in [[0, 1, 2, 3], [3, 2, 1, 0]] {
            let mut cloud = PointCloud::from_positions(order.map(|i| Point3::from(corners[i])).to_vec());
            cloud.colors = Some(order.map(|i| [[9, 9, 9], [9, 9, 9], [255, 0, 0], [0, 255, 0]][i]).to_vec());
            let image = render_cloud(&cloud, None, &small(View::Top, Coloring::Own)).unwrap();
            assert_eq!(pixel(&image, 32, 32), [0, 255, 0]);
        }
    }

    #[test]
    fn axes_lie_as_said() {
        // A long arm along x, a short one along y, a middle one along z.
        let arm = |d: Vector3<f32>| (0..400).map(move |i| Point3::from(d * (i as f32 / 400.0)));
        let points: Vec<_> = arm(Vector3::x() * 3.0).chain(arm(Vector3::y())).chain(arm(Vector3::z() * 2.0)).collect();
        let cloud = PointCloud::from_positions(points);
        let ink = |view| {
            let image = render_cloud(&cloud, None, &small(view, Coloring::Height)).unwrap();
            let dark = |x: usize, y: usize| pixel(&image, x, y) != [255; 3];
            let columns = (0..64).filter(|&x| (0..64).any(|y| dark(x, y))).count();
            let rows = (0..64).filter(|&y| (0..64).any(|x| dark(x, y))).count();
            columns as f64 / rows as f64
        };
        assert!((ink(View::Top) - 3.0).abs() < 0.5);
        assert!((ink(View::Side) - 1.5).abs() < 0.3);
        assert!((ink(View::Front) - 0.5).abs() < 0.2);
    }

    #[test]
    fn nothing_is_an_empty_picture_and_a_far_point_does_not_shrink_the_rest() {
        let params = small(View::Perspective, Coloring::Height);
        let nan = PointCloud::from_positions(vec![Point3::new(f32::NAN, 0.0, 0.0)]);
        assert!(render_cloud(&nan, None, &params).unwrap().data().iter().all(|v| *v == 255));
        let mut points: Vec<_> = (0..1000).map(|i| Point3::new((i % 32) as f32, (i / 32) as f32, 0.0)).collect();
        points.push(Point3::new(1e7, 0.0, 0.0));
        let image =
            render_cloud(&PointCloud::from_positions(points), None, &small(View::Top, Coloring::Height)).unwrap();
        let inked = image.data().chunks(3).filter(|p| *p != [255; 3]).count();
        assert!(inked > 800, "{inked}");
    }

    #[test]
    fn labels_must_be_one_a_point() {
        let cloud = PointCloud::from_positions(vec![Point3::origin(); 3]);
        let wrong = render_cloud(&cloud, Some(&[None]), &RenderParams::default());
        assert!(matches!(wrong, Err(GeometryError::ShapeMismatch { field: "labels", expected: 3, actual: 1 })));
    }
}
