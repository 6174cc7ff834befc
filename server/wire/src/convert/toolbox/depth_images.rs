//! Depth images cleaned up and taken apart: parameters of requests, and answers.

use super::bytes_of_labels;
use crate::convert::{geometry, required};
use crate::v1;
use bytes::Bytes;
use percept_perception::depth::{
    BilateralParams, BoundaryParams, DepthOutlierParams, DepthPlaneParams, DepthPlanes, EdgeKind, FillParams,
    MedianHoles, MedianParams, NormalMap, NormalMapParams, RegisteredColor,
};
use percept_service::Result;
use percept_service::toolbox::DepthFilter;

/// Filters of a request.
///
/// # Errors
/// `FIELD_MISSING` naming `filters[i]`.
pub fn filters(r: &v1::FilterDepthRequest) -> Result<Vec<DepthFilter>> {
    let named = |(i, f)| filter(f).map_err(|e| e.within(&format!("filters[{i}]")));
    r.filters.iter().enumerate().map(named).collect()
}

fn filter(f: &v1::DepthFilter) -> Result<DepthFilter> {
    use v1::depth_filter::Filter as F;
    Ok(match required("filter", f.filter.as_ref())? {
        F::Median(r) => {
            let mut params = MedianParams::default();
            lay_over!(params, r: size_px);
            params.holes = if r.ignore_holes { MedianHoles::Ignored } else { MedianHoles::AsZero };
            DepthFilter::Median(params)
        }
        F::Bilateral(r) => {
            let mut params = BilateralParams::default();
            lay_over!(params, r: radius_px, sigma_px, sigma_depth_m);
            DepthFilter::Bilateral(params)
        }
        F::RemoveOutliers(r) => {
            let mut params = DepthOutlierParams::default();
            lay_over!(params, r: size_px, ratio, min_deviation_fraction, min_neighbours);
            DepthFilter::RemoveOutliers(params)
        }
        F::FillHoles(r) => {
            let mut params = FillParams::default();
            lay_over!(params, r: iterations, min_neighbours, max_jump_fraction);
            DepthFilter::FillHoles(params)
        }
    })
}

/// How normals are taken.
pub fn normal_params(r: &v1::ComputeDepthNormalsRequest) -> NormalMapParams {
    let mut params = NormalMapParams::default();
    lay_over!(params, r: step_px, max_jump_fraction, max_incidence_rad);
    params
}

/// How planes grow.
pub fn plane_params(r: &v1::SegmentDepthPlanesRequest) -> DepthPlaneParams {
    let mut params = DepthPlaneParams::default();
    lay_over!(params, r: cell_px, noise_at_1m_m, max_angle_rad, max_distance_m, min_pixels);
    params
}

/// What makes an edge.
pub fn edge_params(r: &v1::FindDepthEdgesRequest) -> BoundaryParams {
    let mut params = BoundaryParams::default();
    lay_over!(params, r: min_jump_fraction, max_search_px, min_bend_rad, bend_step_px);
    params
}

/// Normals as a message.
pub fn normals_to(map: &NormalMap) -> v1::ComputeDepthNormalsResponse {
    v1::ComputeDepthNormalsResponse { normals: geometry::triple_bytes(&map.normals, |n| [n.x, n.y, n.z]) }
}

/// Planes as a message.
pub fn planes_to(found: &DepthPlanes) -> v1::SegmentDepthPlanesResponse {
    let planes = found.planes.iter().map(|p| v1::DepthPlane {
        plane: Some(geometry::plane_to(&p.plane)),
        centre: Some(geometry::vector_to(&p.center.coords)),
        num_pixels: p.num_pixels as u32,
        rms_m: p.rms_m,
    });
    let labels: Vec<Option<u32>> = found.labels.iter().map(|l| l.map(u32::from)).collect();
    v1::SegmentDepthPlanesResponse { planes: planes.collect(), labels: bytes_of_labels(&labels) }
}

/// Edges as a message.
pub fn edges_to(edges: &[EdgeKind]) -> v1::FindDepthEdgesResponse {
    let number = |kind: &EdgeKind| match kind {
        EdgeKind::None => 0,
        EdgeKind::Occluding => 1,
        EdgeKind::Occluded => 2,
        EdgeKind::NoReturn => 3,
        EdgeKind::HighCurvature => 4,
    };
    v1::FindDepthEdgesResponse { edges: edges.iter().map(number).collect::<Vec<u8>>().into() }
}

/// Registered colours as a message.
pub fn registered_to(r: &RegisteredColor) -> v1::RegisterColourResponse {
    let seen: Bytes = r.seen.iter().map(|&s| u8::from(s)).collect::<Vec<u8>>().into();
    v1::RegisterColourResponse { colour: Some(super::depth::color_to(&r.color)), seen }
}
