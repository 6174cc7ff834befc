//! Surfaces that go on smoothly.

use crate::cloud::{Clusters, DisjointSets, at_least, positive};
use crate::search::{KdTree, Neighbor};
use nalgebra::{Point3, Vector3};
use percept_geometry::{GeometryError, cloud::is_finite};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Points of one task, and points whose edges are held at once (a bound on memory).
const CHUNK: usize = 512;
const BLOCK: usize = 1 << 15;

/// How [`grow_regions`] joins points.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RegionGrowingParams {
    /// Points at most this far apart may be one surface, metres; two to three times their spacing.
    pub radius_m: f64,
    /// Most neighbours that a point is compared with.
    pub max_neighbours: usize,
    /// Normals of neighbours on one surface differ by at most this, radians.
    pub max_angle_rad: f64,
    /// Regions with fewer points are left out; at least 1.
    pub min_points: usize,
}

impl Default for RegionGrowingParams {
    fn default() -> Self {
        Self { radius_m: 0.05, max_neighbours: 30, max_angle_rad: 0.1, min_points: 50 }
    }
}

impl RegionGrowingParams {
    /// Checks the bounds.
    ///
    /// # Errors
    /// `OutOfRange` naming the field.
    pub fn validate(&self) -> Result<(), GeometryError> {
        positive("radius_m", self.radius_m)?;
        positive("max_angle_rad", self.max_angle_rad)?;
        at_least("max_neighbours", self.max_neighbours, 1, "at least 1")?;
        at_least("min_points", self.min_points, 1, "at least 1")
    }
}

/// Regions in which the normal (N x 3, either sign) turns little from neighbour to neighbour, numbered by their first
/// point; points without a normal (all zero) are in none.
///
/// Source: the smoothness constraint of Rabbani, van den Heuvel and Vosselman, "Segmentation of point clouds using
/// smoothness constraint", 2006, as connected components, so that the answer does not depend on where growing begins.
///
/// # Errors
/// `OutOfRange` naming the parameter, `ShapeMismatch` if there is not a normal for each point.
pub fn grow_regions(
    points: &[Point3<f32>],
    normals: &[Vector3<f32>],
    params: &RegionGrowingParams,
) -> Result<Clusters, GeometryError> {
    params.validate()?;
    if normals.len() != points.len() {
        let (expected, actual) = (points.len(), normals.len());
        return Err(GeometryError::ShapeMismatch { field: "normals", expected, actual });
    }
    let tree = KdTree::build(points);
    let least = params.max_angle_rad.min(std::f64::consts::FRAC_PI_2).cos() as f32;
    let has_normal = |i: usize| is_finite(&points[i]) && normals[i].norm_squared() > 0.5;
    let edges_of = |found: &mut Vec<Neighbor>, i: usize, edges: &mut Vec<(u32, u32)>| {
        if has_normal(i) {
            tree.hybrid_into(&points[i], params.radius_m as f32, params.max_neighbours.saturating_add(1), found);
            let smooth = found.iter().filter(|n| n.index != i && normals[n.index].dot(&normals[i]).abs() >= least);
            edges.extend(smooth.map(|n| (n.index as u32, i as u32)));
        }
    };
    let mut sets = DisjointSets::new(points.len());
    let all: Vec<usize> = (0..points.len()).collect();
    for block in all.chunks(BLOCK) {
        let chunks = block.par_chunks(CHUNK).map_init(Vec::new, |found, chunk| {
            let mut edges = Vec::new();
            chunk.iter().for_each(|&i| edges_of(found, i, &mut edges));
            edges
        });
        let edges: Vec<Vec<(u32, u32)>> = chunks.collect();
        edges.iter().flatten().for_each(|&(a, b)| sets.unite(a, b));
    }
    Ok(sets.clusters(params.min_points, has_normal))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_faces_are_two_regions_and_a_sphere_is_one() {
        let (mut points, mut normals) = (Vec::new(), Vec::new());
        for i in 0..400 {
            let (a, b) = ((i % 20) as f32 * 0.02, (i / 20) as f32 * 0.02);
            points.extend([Point3::new(a, b, 0.0), Point3::new(a, 0.0, 0.02 + b)]);
            normals.extend([Vector3::z(), -Vector3::y()]);
        }
        for i in 0..4000 {
            let z = 1.0 - 2.0 * (i as f32 + 0.5) / 4000.0;
            let (sin, cos) = (i as f32 * 2.399_963).sin_cos();
            let n = Vector3::new(cos * (1.0 - z * z).sqrt(), sin * (1.0 - z * z).sqrt(), z);
            points.push(Point3::new(3.0, 0.0, 0.0) + n * 0.5);
            normals.push(n);
        }
        points.push(Point3::from([f32::NAN; 3]));
        normals.push(Vector3::zeros());
        let found = grow_regions(&points, &normals, &RegionGrowingParams::default()).unwrap();
        let sizes: Vec<usize> = found.indices().iter().map(Vec::len).collect();
        assert_eq!(sizes, [400, 400, 4000]);
        assert!(grow_regions(&points, &[], &RegionGrowingParams::default()).is_err());
    }
}
