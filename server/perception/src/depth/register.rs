//! Colours of one camera for the depths of another.

use super::{RayTable, check_size, positive, size};
use nalgebra::Point3;
use percept_geometry::{CameraIntrinsics, DepthImage, GeometryError, Pose, RgbImage};

/// A colour for every depth pixel, as the depth camera would see it; what the colour camera cannot see has none.
#[derive(Debug, Clone, PartialEq)]
pub struct RegisteredColor {
    /// `H x W` of the depth image; black where unseen.
    pub color: RgbImage,
    /// `H x W`: whether the colour camera sees the pixel's point.
    pub seen: Vec<bool>,
}

/// Brings the colours of another camera to the pixels of a depth image. `t_color_depth` takes points of the depth
/// camera's optical frame to the colour camera's. A point that lies more than `max_jump_fraction` of its depth behind
/// another one at the same colour pixel is hidden. Colours are interpolated bilinearly.
///
/// # Errors
/// `OutOfRange` for intrinsics or the fraction; `ShapeMismatch` naming the image that is not of its camera's size.
pub fn register_color(
    depth: &DepthImage,
    depth_camera: &CameraIntrinsics,
    color: &RgbImage,
    color_camera: &CameraIntrinsics,
    t_color_depth: &Pose,
    max_jump_fraction: f64,
) -> Result<RegisteredColor, GeometryError> {
    positive("max_jump_fraction", max_jump_fraction)?;
    color_camera.validate()?;
    check_size("depth", (depth_camera.width, depth_camera.height), size(depth))?;
    check_size("colour", (color_camera.width, color_camera.height), (color.width(), color.height()))?;
    let hits = project(depth, &RayTable::new(depth_camera)?, color_camera, t_color_depth);
    let nearest = nearest_depths(&hits, depth, depth_camera, color_camera);
    let mut pixels = vec![0; hits.len() * 3];
    let mut seen = vec![false; hits.len()];
    for (i, hit) in hits.iter().enumerate() {
        let Some([u, v, z]) = *hit else { continue };
        let at = v.round() as usize * color_camera.width + u.round() as usize;
        if z <= nearest[at] * (1.0 + max_jump_fraction as f32) {
            seen[i] = true;
            pixels[i * 3..i * 3 + 3].copy_from_slice(&bilinear(color, u, v));
        }
    }
    Ok(RegisteredColor { color: RgbImage::new(depth.width(), depth.height(), pixels)?, seen })
}

/// Column, row and depth in the colour camera of every depth pixel that falls into its image.
fn project(
    depth: &DepthImage,
    rays: &RayTable,
    camera: &CameraIntrinsics,
    t_color_depth: &Pose,
) -> Vec<Option<[f32; 3]>> {
    let (w, h) = size(depth);
    let rotation = t_color_depth.rotation.to_rotation_matrix();
    let hit = |i: usize| {
        let d = f64::from(depth.data()[i]);
        let (x, y) = rays.ray(i % w, i / w);
        if d == 0.0 || !(x + y).is_finite() {
            return None;
        }
        let p = Point3::new(f64::from(x) * d, f64::from(y) * d, d);
        let p = rotation * p + t_color_depth.translation.vector;
        let q = camera.project(&p)?;
        let inside = q.x > -0.5 && q.y > -0.5 && q.x < camera.width as f64 - 0.5 && q.y < camera.height as f64 - 0.5;
        inside.then_some([q.x as f32, q.y as f32, p.z as f32])
    };
    (0..w * h).map(hit).collect()
}

/// The z-buffer of the colour camera. A depth pixel covers as many colour pixels as their focal lengths tell, so that
/// a surface in front has no gaps through which one behind would be seen.
fn nearest_depths(
    hits: &[Option<[f32; 3]>],
    depth: &DepthImage,
    depth_camera: &CameraIntrinsics,
    color_camera: &CameraIntrinsics,
) -> Vec<f32> {
    let (w, h) = (color_camera.width, color_camera.height);
    let mut nearest = vec![f32::INFINITY; w * h];
    let ratio = (color_camera.fx / depth_camera.fx).max(color_camera.fy / depth_camera.fy) as f32;
    for (hit, d) in hits.iter().zip(depth.data()) {
        let Some([u, v, z]) = *hit else { continue };
        let reach = (0.5 * ratio * d / z).clamp(0.5, 8.0);
        let span = |x: f32, n: usize| ((x - reach).ceil().max(0.0) as usize, ((x + reach).floor() as usize).min(n - 1));
        let ((u0, u1), (v0, v1)) = (span(u, w), span(v, h));
        for y in v0..=v1 {
            for cell in &mut nearest[y * w + u0..=y * w + u1] {
                *cell = cell.min(z);
            }
        }
    }
    nearest
}

fn bilinear(image: &RgbImage, u: f32, v: f32) -> [u8; 3] {
    let (u, v) = (u.clamp(0.0, image.width() as f32 - 1.0), v.clamp(0.0, image.height() as f32 - 1.0));
    let (u0, v0) = (u as usize, v as usize);
    let (u1, v1) = ((u0 + 1).min(image.width() - 1), (v0 + 1).min(image.height() - 1));
    let (a, b) = (u - u0 as f32, v - v0 as f32);
    let [p, q, r, s] = [image.at(u0, v0), image.at(u1, v0), image.at(u0, v1), image.at(u1, v1)];
    let mix = |k: usize| {
        let [p, q, r, s] = [p[k], q[k], r[k], s[k]].map(f32::from);
        ((p + (q - p) * a) * (1.0 - b) + (r + (s - r) * a) * b).round() as u8
    };
    [mix(0), mix(1), mix(2)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_arrive_by_parallax_and_hidden_points_have_none() {
        // The colour camera stands 0.1 m to the right; a near plate hides part of the wall from it.
        let camera = CameraIntrinsics::pinhole(100, 20, 100.0, 100.0, 49.5, 9.5);
        let data = (0..2000).map(|i| if (40..60).contains(&(i % 100)) { 1.0 } else { 2.0 }).collect();
        let depth = DepthImage::new(100, 20, data).unwrap();
        let ramp = (0..2000).flat_map(|i| [(i % 100) as u8, 0, 255]).collect();
        let color = RgbImage::new(100, 20, ramp).unwrap();
        let t_color_depth = Pose::translation(-0.1, 0.0, 0.0);
        let out = register_color(&depth, &camera, &color, &camera, &t_color_depth, 0.05).unwrap();
        // Disparity: 10 px at 1 m, 5 px at 2 m.
        for u in 0..100usize {
            let i = 10 * 100 + u;
            let expected = if (40..60).contains(&u) { u.checked_sub(10) } else { u.checked_sub(5) };
            // The plate covers columns 30 to 49 of the colour camera: wall at 35 to 39 is hidden.
            let hidden = (35..40).contains(&u);
            assert_eq!(out.seen[i], expected.is_some() && !hidden, "column {u}");
            if let (true, Some(expected)) = (out.seen[i], expected) {
                assert_eq!(out.color.at(u, 10), [expected as u8, 0, 255]);
            }
        }
    }
}
