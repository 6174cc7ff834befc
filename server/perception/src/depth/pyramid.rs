//! Smaller depth images that keep edges sharp.

use super::{check_size, size};
use percept_geometry::{CameraIntrinsics, DepthImage, GeometryError};

/// Depths that differ by more than this part of the depth belong to two surfaces.
const JUMP: f32 = 0.03;

/// The image at half size: each pixel is the mean of those of its 2 x 2 pixels that lie on the surface of
/// their lower median; the rest, and pixels without return, do not count. An odd last row or column falls
/// away. No return where none of the four has one.
///
/// Source: Newcombe et al., "KinectFusion", 2011, section 3.2 (block averaging that leaves out depths far
/// from the centre's); the median in place of one corner pixel keeps a single hole from shifting the choice.
pub fn halve(depth: &DepthImage) -> DepthImage {
    let (width, height) = (depth.width() / 2, depth.height() / 2);
    let source = depth.data();
    let mut data = Vec::with_capacity(width * height);
    for v in 0..height {
        let top = &source[2 * v * depth.width()..][..depth.width()];
        let bottom = &source[(2 * v + 1) * depth.width()..][..depth.width()];
        for (a, b) in top.chunks_exact(2).zip(bottom.chunks_exact(2)) {
            data.push(mean_of_one_surface([a[0], a[1], b[0], b[1]]));
        }
    }
    DepthImage::new(width, height, data).unwrap_or_else(|_| depth.clone())
}

fn mean_of_one_surface(mut four: [f32; 4]) -> f32 {
    four.sort_unstable_by(f32::total_cmp);
    let holes = four.iter().filter(|d| **d == 0.0).count();
    if holes == 4 {
        return 0.0;
    }
    let valid = &four[holes..];
    let median = valid[(valid.len() - 1) / 2];
    let (mut sum, mut count) = (0.0, 0.0);
    for d in valid {
        if (d - median).abs() <= JUMP * median {
            sum += d;
            count += 1.0;
        }
    }
    sum / count
}

/// One level: an image and the intrinsics that belong to it.
#[derive(Debug, Clone, PartialEq)]
pub struct PyramidLevel {
    /// Depth, metres.
    pub depth: DepthImage,
    /// Intrinsics at this size.
    pub intrinsics: CameraIntrinsics,
}

/// Levels from the full size (index 0) down, each half of the one before.
#[derive(Debug, Clone, PartialEq)]
pub struct DepthPyramid {
    /// Level 0 is the image as given.
    pub levels: Vec<PyramidLevel>,
}

impl DepthPyramid {
    /// Builds up to `num_levels` levels, the image itself included; fewer if a side would fall under 2
    /// pixels. Copies the image.
    ///
    /// # Errors
    /// `ShapeMismatch` if the image is not of the intrinsics' size.
    pub fn build(depth: &DepthImage, intrinsics: &CameraIntrinsics, num_levels: usize) -> Result<Self, GeometryError> {
        check_size("depth", (intrinsics.width, intrinsics.height), size(depth))?;
        let mut levels = vec![PyramidLevel { depth: depth.clone(), intrinsics: *intrinsics }];
        while levels.len() < num_levels {
            let last = &levels[levels.len() - 1];
            if last.depth.width() < 4 || last.depth.height() < 4 {
                break;
            }
            let next = PyramidLevel { depth: halve(&last.depth), intrinsics: last.intrinsics.shrunk(2, true) };
            levels.push(next);
        }
        Ok(Self { levels })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn surfaces_are_not_mixed_across_an_edge_and_holes_do_not_count() {
        let depth = DepthImage::new(
            6,
            2,
            vec![
                1.0, 3.0, 1.0, 0.0, 0.0, 0.0, //
                1.02, 3.0, 1.01, 1.02, 0.0, 0.0,
            ],
        )
        .unwrap();
        let half = halve(&depth);
        assert!((half.data()[0] - 1.01).abs() < 1e-6);
        assert!((half.data()[1] - 1.01).abs() < 1e-6);
        assert_eq!(half.data()[2], 0.0);
    }

    #[test]
    fn a_slanted_plane_stays_the_same_plane_at_every_level() {
        // Inverse depth of a plane is linear over the image; its values must agree with each level's camera.
        let camera = CameraIntrinsics::pinhole(64, 48, 60.0, 60.0, 31.5, 23.5);
        let at = |k: &CameraIntrinsics, u: usize, v: usize| {
            let ray = k.ray(u as f64, v as f64);
            2.0 / (1.0 + 0.2 * ray.x - 0.1 * ray.y)
        };
        let data = (0..64 * 48).map(|i| at(&camera, i % 64, i / 64) as f32).collect();
        let pyramid = DepthPyramid::build(&DepthImage::new(64, 48, data).unwrap(), &camera, 3).unwrap();
        assert_eq!(pyramid.levels.len(), 3);
        for level in &pyramid.levels {
            for (u, v) in [(0, 0), (5, 7), (15, 11)] {
                let expected = at(&level.intrinsics, u, v);
                assert!((f64::from(level.depth.at(u, v)) - expected).abs() < 1e-3);
            }
        }
    }

    #[test]
    fn tiny_images_end_the_pyramid() {
        let camera = CameraIntrinsics::pinhole(5, 3, 4.0, 4.0, 2.0, 1.0);
        let depth = DepthImage::new(5, 3, vec![1.0; 15]).unwrap();
        assert_eq!(DepthPyramid::build(&depth, &camera, 4).unwrap().levels.len(), 1);
        assert_eq!(halve(&DepthImage::new(1, 1, vec![1.0]).unwrap()).data().len(), 0);
    }
}
