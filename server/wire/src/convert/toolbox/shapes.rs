//! Neighbours, local features, boxes, hulls: parameters of requests, and answers.

use super::count;
use crate::convert::geometry;
use crate::v1;
use bytes::Bytes;
use nalgebra::Point3;
use percept_geometry::GeometryError;
use percept_perception::cloud::{Hull3, LocalFeatures};
use percept_perception::search::Neighbors;
use percept_service::Result;
use percept_service::toolbox::{Boxes, NeighborhoodParams};

fn floats(values: impl Iterator<Item = f32>) -> Bytes {
    values.flat_map(f32::to_le_bytes).collect::<Vec<u8>>().into()
}

fn uint32s(values: impl Iterator<Item = u32>) -> Bytes {
    values.flat_map(u32::to_le_bytes).collect::<Vec<u8>>().into()
}

/// Which neighbours are wanted.
pub fn neighborhood(r: &v1::FindNeighboursRequest) -> NeighborhoodParams {
    NeighborhoodParams { k: count(r.k), radius_m: r.radius_m }
}

/// Queries of a request.
///
/// # Errors
/// `SIZE_MISMATCH`.
pub fn queries(r: &v1::FindNeighboursRequest) -> Result<Option<Vec<Point3<f32>>>> {
    let Some(data) = &r.queries else { return Ok(None) };
    let (rows, rest) = data.as_chunks::<12>();
    if !rest.is_empty() {
        let (expected, actual) = (3 * (rows.len() + 1), data.len() / 4);
        return Err(GeometryError::ShapeMismatch { field: "queries", expected, actual }.into());
    }
    let number = |b: &[u8], i: usize| f32::from_le_bytes([b[i], b[i + 1], b[i + 2], b[i + 3]]);
    Ok(Some(rows.iter().map(|b| Point3::new(number(b, 0), number(b, 4), number(b, 8))).collect()))
}

/// Neighbours as a message.
pub fn neighbors_to(n: &Neighbors) -> v1::FindNeighboursResponse {
    v1::FindNeighboursResponse {
        offsets: uint32s(n.offsets.iter().map(|&o| o as u32)),
        indices: uint32s(n.indices.iter().copied()),
        distances_m: floats(n.distances2.iter().map(|d| d.sqrt())),
    }
}

/// Local features as a message.
pub fn local_features_to(all: &[Option<LocalFeatures>]) -> v1::ComputeLocalFeaturesResponse {
    let each = |of: fn(&LocalFeatures) -> f32| floats(all.iter().map(move |f| f.as_ref().map_or(f32::NAN, of)));
    v1::ComputeLocalFeaturesResponse {
        linearity: each(|f| f.linearity),
        planarity: each(|f| f.planarity),
        scattering: each(|f| f.scattering),
        verticality: each(|f| f.verticality),
        curvature: each(|f| f.curvature),
    }
}

/// Boxes as a message.
pub fn boxes_to(b: &Boxes) -> v1::FitBoxesResponse {
    v1::FitBoxesResponse {
        axis_aligned: Some(geometry::box_to(&b.axis_aligned)),
        upright: Some(geometry::box_to(&b.upright)),
        minimal: Some(geometry::box_to(&b.minimal)),
    }
}

/// A hull as a message.
pub fn hull_to(h: &Hull3) -> v1::ComputeConvexHullResponse {
    let vertices: Vec<u8> = h.vertices.iter().flat_map(|p| [p.x, p.y, p.z]).flat_map(f64::to_le_bytes).collect();
    v1::ComputeConvexHullResponse {
        vertices: vertices.into(),
        triangles: uint32s(h.triangles.iter().flatten().copied()),
        volume_m3: h.volume_m3,
        area_m2: h.area_m2,
    }
}
