//! Neighbours, local features, shapes, boxes, hulls: decode, call, encode.

use percept_perception::cloud::local_features;
use percept_service::Result;
use percept_service::toolbox::{self as ops, Toolbox};
use percept_wire::convert::toolbox::{self as convert, segmentation, shapes};
use percept_wire::v1;

operations! {
    toolbox_shapes_service_server::ToolboxShapesService, "ToolboxShapesService/*",
    one {
        compute_shape_features(ComputeShapeFeaturesRequest) -> ComputeShapeFeaturesResponse,
        fit_boxes(FitBoxesRequest) -> FitBoxesResponse,
    }
    parts {
        find_neighbours(FindNeighboursRequest) -> FindNeighboursResponse as FindNeighboursStream,
        compute_local_features(ComputeLocalFeaturesRequest) -> ComputeLocalFeaturesResponse as ComputeLocalFeaturesStream,
        compute_convex_hull(ComputeConvexHullRequest) -> ComputeConvexHullResponse as ComputeConvexHullStream,
    }
}

fn find_neighbours(t: &Toolbox, r: v1::FindNeighboursRequest) -> Result<v1::FindNeighboursResponse> {
    let cloud = convert::cloud(t, "cloud", r.cloud.as_ref())?;
    let queries = shapes::queries(&r)?;
    let found = ops::find_neighbors(&cloud, queries.as_deref(), &shapes::neighborhood(&r), t.limits())?;
    Ok(shapes::neighbors_to(&found))
}

fn compute_local_features(t: &Toolbox, r: v1::ComputeLocalFeaturesRequest) -> Result<v1::ComputeLocalFeaturesResponse> {
    let cloud = convert::cloud(t, "cloud", r.cloud.as_ref())?;
    Ok(shapes::local_features_to(&local_features(&cloud.positions, r.k.unwrap_or(20) as usize)?))
}

fn compute_shape_features(t: &Toolbox, r: v1::ComputeShapeFeaturesRequest) -> Result<v1::ComputeShapeFeaturesResponse> {
    let cloud = convert::cloud(t, "cloud", r.cloud.as_ref())?;
    Ok(segmentation::shape_to(&ops::shape_features(&cloud.positions)?))
}

fn fit_boxes(t: &Toolbox, r: v1::FitBoxesRequest) -> Result<v1::FitBoxesResponse> {
    let cloud = convert::cloud(t, "cloud", r.cloud.as_ref())?;
    Ok(shapes::boxes_to(&ops::fit_boxes(&cloud.positions)?))
}

fn compute_convex_hull(t: &Toolbox, r: v1::ComputeConvexHullRequest) -> Result<v1::ComputeConvexHullResponse> {
    let cloud = convert::cloud(t, "cloud", r.cloud.as_ref())?;
    Ok(shapes::hull_to(&ops::convex_hull(&cloud.positions)?))
}
