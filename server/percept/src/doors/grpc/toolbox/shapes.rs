//! Neighbours, local features, boxes, hulls: decode, call, encode.

use percept_perception::cloud::local_features;
use percept_service::Result;
use percept_service::toolbox::{self as ops, Toolbox};
use percept_wire::convert::toolbox::{self as convert, shapes};
use percept_wire::v1;

pub(super) fn find_neighbors(t: &Toolbox, r: v1::FindNeighborsRequest) -> Result<v1::FindNeighborsResponse> {
    let cloud = convert::cloud(t, "cloud", r.cloud.as_ref(), r.cloud_handle.as_deref())?;
    let queries = shapes::queries(&r)?;
    let found = ops::find_neighbors(&cloud, queries.as_deref(), &shapes::neighborhood(&r), t.limits())?;
    Ok(shapes::neighbors_to(&found))
}

pub(super) fn compute_local_features(
    t: &Toolbox,
    r: v1::ComputeLocalFeaturesRequest,
) -> Result<v1::ComputeLocalFeaturesResponse> {
    let cloud = convert::cloud(t, "cloud", r.cloud.as_ref(), r.cloud_handle.as_deref())?;
    Ok(shapes::local_features_to(&local_features(&cloud.positions, r.k.unwrap_or(20) as usize)?))
}

pub(super) fn fit_boxes(t: &Toolbox, r: v1::FitBoxesRequest) -> Result<v1::FitBoxesResponse> {
    let cloud = convert::cloud(t, "cloud", r.cloud.as_ref(), r.cloud_handle.as_deref())?;
    Ok(shapes::boxes_to(&ops::fit_boxes(&cloud.positions)?))
}

pub(super) fn compute_convex_hull(
    t: &Toolbox,
    r: v1::ComputeConvexHullRequest,
) -> Result<v1::ComputeConvexHullResponse> {
    let cloud = convert::cloud(t, "cloud", r.cloud.as_ref(), r.cloud_handle.as_deref())?;
    Ok(shapes::hull_to(&ops::convex_hull(&cloud.positions)?))
}
