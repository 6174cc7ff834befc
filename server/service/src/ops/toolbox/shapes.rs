//! Neighbours, what lies about a point, boxes, hulls.

use crate::{Error, Limits, Result};
use nalgebra::{Point3, Vector3};
use percept_geometry::{Aabb3, GeometryError, OrientedBox3, PointCloud, Pose};
use percept_perception::cloud::{self, Hull3};
use percept_perception::search::{KdTree, Neighbors};

/// Which neighbours are wanted: the nearest, those within a radius, or both.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NeighborhoodParams {
    /// Nearest, at most.
    pub k: Option<usize>,
    /// Metres.
    pub radius_m: Option<f64>,
}

/// Neighbours of the queries, or of every point.
///
/// # Errors
/// `FIELD_MISSING` without both, `OUT_OF_RANGE`; `NEIGHBOURS_TOO_MANY` if the answer would be too large.
pub fn find_neighbors(
    cloud: &PointCloud,
    queries: Option<&[Point3<f32>]>,
    params: &NeighborhoodParams,
    limits: &Limits,
) -> Result<Neighbors> {
    // Eight bytes each in the answer, which may be twice as large as a request.
    let most = limits.max_message_bytes / 5;
    let too_many = |field: &str| {
        let words = format!("there are more than {most} neighbours in all, the limit; lower {field}, or ask for fewer");
        Error::exhausted("NEIGHBOURS_TOO_MANY", field, words)
    };
    if let Some(value) = params.radius_m.filter(|r| !(r.is_finite() && *r > 0.0)) {
        return Err(GeometryError::OutOfRange { field: "radius_m", value, requirement: "positive and finite" }.into());
    }
    let count = queries.map_or(cloud.len(), <[_]>::len);
    if let Some(k) = params.k {
        if k == 0 {
            return Err(GeometryError::OutOfRange { field: "k", value: 0.0, requirement: "at least 1" }.into());
        }
        if k.min(cloud.len()).saturating_mul(count) > most {
            return Err(too_many("k"));
        }
    }
    let tree = KdTree::build(&cloud.positions);
    let all = |r: f64| match queries {
        Some(q) => tree.radius_of(q, r as f32, most),
        None => tree.radius_all(r as f32, most),
    };
    match (params.k.map(|k| k.min(cloud.len().max(1))), params.radius_m, queries) {
        (None, None, _) => Err(Error::invalid("FIELD_MISSING", "k", "k and radius_m are missing; set one or both")),
        (None, Some(r), _) => all(r).map_err(|_| too_many("radius_m")),
        (Some(k), None, Some(q)) => Ok(tree.knn_of(q, k)),
        (Some(k), None, None) => Ok(tree.knn_all(k)),
        (Some(k), Some(r), Some(q)) => Ok(tree.hybrid_of(q, r as f32, k)),
        (Some(k), Some(r), None) => Ok(tree.hybrid_all(r as f32, k)),
    }
}

/// Boxes around a cloud.
#[derive(Debug, Clone, PartialEq)]
pub struct Boxes {
    /// Along the axes.
    pub axis_aligned: OrientedBox3,
    /// Upright along z, of least area.
    pub upright: OrientedBox3,
    /// Of least volume.
    pub minimal: OrientedBox3,
}

fn cloud_empty(num_points: usize) -> Error {
    let words = format!("cloud has {num_points} points and none is finite; send at least one");
    Error::invalid("CLOUD_EMPTY", "cloud", words)
}

/// Boxes around the finite points.
///
/// # Errors
/// `CLOUD_EMPTY` without a finite point.
pub fn fit_boxes(points: &[Point3<f32>]) -> Result<Boxes> {
    let aligned = || {
        let bounds = Aabb3::of(points);
        let center = Vector3::from_iterator(bounds.min.iter().zip(bounds.max.iter()).map(|(a, b)| 0.5 * (a + b)));
        OrientedBox3 { t_frame_box: Pose::translation(center.x, center.y, center.z), size: bounds.size() }
    };
    let (upright, minimal) =
        cloud::upright_box(points).zip(cloud::minimal_box(points)).ok_or_else(|| cloud_empty(points.len()))?;
    Ok(Boxes { axis_aligned: aligned(), upright, minimal })
}

/// The convex hull of the finite points.
///
/// # Errors
/// `CLOUD_EMPTY` without a finite point.
pub fn convex_hull(points: &[Point3<f32>]) -> Result<Hull3> {
    cloud::convex_hull_3d(points).ok_or_else(|| cloud_empty(points.len()))
}
