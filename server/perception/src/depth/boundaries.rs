//! Edges by kind: what hides, what is hidden, where a surface bends, where returns end.

use super::{NormalMap, NormalMapParams, RayTable, positive, size};
use percept_geometry::{CameraIntrinsics, DepthImage, GeometryError};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// What kind of edge a pixel lies on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum EdgeKind {
    /// None.
    #[default]
    None,
    /// The surface in front ends here.
    Occluding,
    /// The surface behind goes on, hidden, from here.
    Occluded,
    /// Returns end here: a hole, or out of range.
    NoReturn,
    /// One surface bends sharply, as where two walls meet.
    HighCurvature,
}

/// What makes an edge.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BoundaryParams {
    /// Part of the depth by which the surface behind has to lie behind.
    pub min_jump_fraction: f64,
    /// Holes up to this wide are looked across for the other surface, pixels, 1 to 64.
    pub max_search_px: usize,
    /// Angle between the normals on either side that makes a sharp bend, radians.
    pub min_bend_rad: f64,
    /// Distance of these normals from the pixel, pixels, 1 to 16.
    pub bend_step_px: usize,
}

impl Default for BoundaryParams {
    fn default() -> Self {
        Self { min_jump_fraction: 0.02, max_search_px: 50, min_bend_rad: 0.7, bend_step_px: 4 }
    }
}

impl BoundaryParams {
    /// Checks the bounds.
    ///
    /// # Errors
    /// `OutOfRange` naming the field.
    pub fn validate(&self) -> Result<(), GeometryError> {
        positive("min_jump_fraction", self.min_jump_fraction)?;
        positive("min_bend_rad", self.min_bend_rad)?;
        if !(1..=64).contains(&self.max_search_px) {
            let value = self.max_search_px as f64;
            return Err(GeometryError::OutOfRange { field: "max_search_px", value, requirement: "between 1 and 64" });
        }
        if !(1..=16).contains(&self.bend_step_px) {
            let value = self.bend_step_px as f64;
            return Err(GeometryError::OutOfRange { field: "bend_step_px", value, requirement: "between 1 and 16" });
        }
        Ok(())
    }
}

/// The kind of edge of each pixel, `H x W` row-major. Pixels without return, and beside the image's border, are none.
///
/// Source: Choi, Trevor and Christensen, "RGB-D edge detection and edge-based registration", 2013, section III (PCL's
/// `OrganizedEdgeFromNormals`). Bends are found from normals on either side in place of Canny's detector on normals.
///
/// # Errors
/// `OutOfRange` naming the parameter; `ShapeMismatch` if the image is not of the intrinsics' size.
pub fn boundaries(
    depth: &DepthImage,
    intrinsics: &CameraIntrinsics,
    params: &BoundaryParams,
) -> Result<Vec<EdgeKind>, GeometryError> {
    params.validate()?;
    let normals = NormalMap::of_depth(depth, &RayTable::new(intrinsics)?, &NormalMapParams::default())?;
    let (w, h) = size(depth);
    let mut out = vec![EdgeKind::None; w * h];
    out.par_chunks_mut(w.max(1)).enumerate().for_each(|(v, row)| {
        for (u, kind) in row.iter_mut().enumerate() {
            if u > 0 && v > 0 && u + 1 < w && v + 1 < h && depth.at(u, v) > 0.0 {
                *kind = jump(depth, u, v, params);
                if *kind == EdgeKind::None && bends(&normals, u, v, params) {
                    *kind = EdgeKind::HighCurvature;
                }
            }
        }
    });
    Ok(out)
}

fn jump(depth: &DepthImage, u: usize, v: usize, params: &BoundaryParams) -> EdgeKind {
    let d = depth.at(u, v);
    let (mut behind, mut before, mut hole) = (0.0f32, 0.0f32, false);
    for (du, dv) in [(-1, 0), (-1, -1), (0, -1), (1, -1), (1, 0), (1, 1), (0, 1), (-1, 1)] {
        let mut reached = 0.0;
        for k in 1..=params.max_search_px as isize {
            let (x, y) = (u as isize + du * k, v as isize + dv * k);
            if x < 0 || y < 0 || x >= depth.width() as isize || y >= depth.height() as isize {
                break;
            }
            reached = depth.at(x as usize, y as usize);
            if reached > 0.0 {
                break;
            }
            hole = true;
        }
        if reached > 0.0 {
            (behind, before) = (behind.max(reached - d), before.max(d - reached));
        }
    }
    let least = params.min_jump_fraction as f32 * d;
    match (behind > least, before > least) {
        (true, false) => EdgeKind::Occluding,
        (false, true) => EdgeKind::Occluded,
        // Between two steps the larger one speaks.
        (true, true) if behind >= before => EdgeKind::Occluding,
        (true, true) => EdgeKind::Occluded,
        (false, false) if hole => EdgeKind::NoReturn,
        (false, false) => EdgeKind::None,
    }
}

fn bends(normals: &NormalMap, u: usize, v: usize, params: &BoundaryParams) -> bool {
    let (s, cos) = (params.bend_step_px, params.min_bend_rad.cos() as f32);
    let bend = |a: (usize, usize), b: (usize, usize)| match (normals.at(a.0, a.1), normals.at(b.0, b.1)) {
        (Some(a), Some(b)) => a.dot(&b) < cos,
        _ => false,
    };
    (u >= s && u + s < normals.width && bend((u - s, v), (u + s, v)))
        || (v >= s && v + s < normals.height && bend((u, v - s), (u, v + s)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn kinds(depth: impl Fn(usize, usize) -> f32) -> Vec<EdgeKind> {
        let camera = CameraIntrinsics::pinhole(60, 40, 60.0, 60.0, 29.5, 19.5);
        let data = (0..60 * 40).map(|i| depth(i % 60, i / 60)).collect();
        boundaries(&DepthImage::new(60, 40, data).unwrap(), &camera, &BoundaryParams::default()).unwrap()
    }

    #[test]
    fn a_step_has_an_occluding_and_an_occluded_side_across_a_gap_too() {
        for gap in [0, 4] {
            let found = kinds(|u, _| {
                if u < 30 {
                    1.0
                } else if u < 30 + gap {
                    0.0
                } else {
                    2.0
                }
            });
            for v in 1..39 {
                assert_eq!(found[v * 60 + 29], EdgeKind::Occluding);
                assert_eq!(found[v * 60 + 30 + gap], EdgeKind::Occluded);
                assert_eq!(found[v * 60 + 20], EdgeKind::None);
            }
        }
    }

    #[test]
    fn a_hole_is_rimmed() {
        let found = kinds(|u, v| if (20..23).contains(&u) && (20..23).contains(&v) { 0.0 } else { 1.5 });
        assert_eq!(found.iter().filter(|k| **k == EdgeKind::NoReturn).count(), 16);
        assert!(found.iter().all(|k| matches!(k, EdgeKind::None | EdgeKind::NoReturn)));
    }

    #[test]
    fn a_corner_of_two_walls_is_a_bend() {
        // Walls at right angles, 2 m away where they meet, on the line of sight.
        let found = kinds(|u, _| 2.0 / (1.0 + ((u as f32 - 29.5) / 60.0).abs()));
        for v in 5..35 {
            assert_eq!(found[v * 60 + 29], EdgeKind::HighCurvature);
            assert_eq!(found[v * 60 + 10], EdgeKind::None);
        }
    }
}
