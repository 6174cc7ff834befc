//! Distinct places of a colour image with their points in space.

use crate::color_camera::ColorCamera;
use crate::scan::DepthScan;
use nalgebra::{Point2, Point3};
use percept_geometry::{CameraIntrinsics, FeatureMethod, GrayImage, KeyframeFeature, KeyframeFeatures};
use percept_perception::features2d::{Descriptors, Keypoint, Orb, OrbParams, Sift, SiftParams, binary_sift};

/// Every so many rows and columns of the depth image are looked up, and cells of the colour image are as large.
const CELL: usize = 2;

/// Features of the colour image; none without colour of the depth's size. `color` tells where the colour camera is, none:
/// as the depth camera.
pub(super) fn of(method: FeatureMethod, scan: &DepthScan, color: Option<ColorCamera>) -> Option<KeyframeFeatures> {
    let image = scan.color.as_ref()?;
    if (image.width(), image.height()) != (scan.depth.width(), scan.depth.height()) {
        return None;
    }
    let (keypoints, descriptors) = extract(method, &image.to_gray())?;
    let nearest = Nearest::of(scan, color);
    let features = keypoints.iter().zip(descriptors).map(|(k, descriptor)| KeyframeFeature {
        descriptor,
        p_base: nearest
            .at(k.u, k.v)
            .map_or(Point3::new(f32::NAN, f32::NAN, f32::NAN), |p| (scan.t_base_sensor * p.cast::<f64>()).cast()),
        pixel: Point2::new(k.u, k.v),
    });
    let i = &scan.intrinsics;
    let camera = CameraIntrinsics::pinhole(i.width, i.height, i.fx, i.fy, i.cx, i.cy);
    Some(KeyframeFeatures { method, camera, features: features.collect() })
}

/// Keypoints, and 256 bits of each.
fn extract(method: FeatureMethod, image: &GrayImage) -> Option<(Vec<Keypoint>, Vec<[u64; 4]>)> {
    let max_features = KeyframeFeatures::LIMIT;
    let found = match method {
        FeatureMethod::Orb => Orb::new(OrbParams { max_features, ..OrbParams::default() }).ok()?.extract(image).ok()?,
        FeatureMethod::Sift => {
            Sift::new(SiftParams { max_features, ..SiftParams::default() }).ok()?.extract(image).ok()?
        }
    };
    let bits = match found.descriptors {
        Descriptors::Binary(bits) => bits,
        Descriptors::Bytes(numbers) => numbers.iter().map(binary_sift).collect(),
    };
    Some((found.keypoints, bits))
}

/// The nearest surface behind every cell of the colour image, as points of the depth camera.
struct Nearest {
    width: usize,
    height: usize,
    points: Vec<Point3<f32>>,
}

impl Nearest {
    fn of(scan: &DepthScan, color: Option<ColorCamera>) -> Self {
        let (width, height) = (scan.depth.width().div_ceil(CELL), scan.depth.height().div_ceil(CELL));
        let mut out = Self { width, height, points: vec![Point3::new(0.0, 0.0, f32::INFINITY); width * height] };
        for v in (0..scan.depth.height()).step_by(CELL) {
            for u in (0..scan.depth.width()).step_by(CELL) {
                let z = scan.depth.at(u, v);
                if z <= 0.1 {
                    continue;
                }
                let p: Point3<f32> = (scan.intrinsics.ray(u as f64, v as f64) * f64::from(z)).cast();
                let (x, y) = color.map_or((u as f32, v as f32), |c| c.project(&p.coords));
                if let Some(cell) = out.cell(x, y).filter(|&cell| out.points[cell].z > z) {
                    out.points[cell] = p;
                }
            }
        }
        out
    }

    fn cell(&self, u: f32, v: f32) -> Option<usize> {
        let (x, y) = (u / CELL as f32, v / CELL as f32);
        let inside = x >= 0.0 && y >= 0.0 && x < self.width as f32 && y < self.height as f32;
        inside.then(|| y as usize * self.width + x as usize)
    }

    /// A corner at the edge of something belongs to what is in front.
    fn at(&self, u: f32, v: f32) -> Option<Point3<f32>> {
        let step = CELL as f32;
        (-1..=1)
            .flat_map(|dy| (-1..=1).map(move |dx| (dx as f32 * step, dy as f32 * step)))
            .filter_map(|(dx, dy)| self.cell(u + dx, v + dy))
            .map(|cell| self.points[cell])
            .min_by(|a, b| a.z.total_cmp(&b.z))
            .filter(|p| p.z.is_finite())
    }
}
