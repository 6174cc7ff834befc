//! Planes, clusters, shapes, objects: decode, call, encode.

use percept_service::Result;
use percept_service::toolbox::{self as ops, Toolbox};
use percept_wire::convert::toolbox as convert;
use percept_wire::convert::toolbox::segmentation;
use percept_wire::v1;

pub(super) fn segment_planes(t: &Toolbox, r: v1::SegmentPlanesRequest) -> Result<v1::SegmentPlanesResponse> {
    let cloud = convert::cloud(t, "cloud", r.cloud.as_ref(), r.cloud_handle.as_deref())?;
    let planes = ops::segment_planes(&cloud, &segmentation::planes_params(&r))?;
    Ok(v1::SegmentPlanesResponse { planes: segmentation::planes_to(&planes) })
}

pub(super) fn cluster_points(t: &Toolbox, r: v1::ClusterPointsRequest) -> Result<v1::ClusterPointsResponse> {
    let cloud = convert::cloud(t, "cloud", r.cloud.as_ref(), r.cloud_handle.as_deref())?;
    let clusters = ops::cluster_points(&cloud, &segmentation::clustering(&r)?)?;
    Ok(segmentation::clusters_to(&clusters))
}

pub(super) fn compute_shape_features(
    t: &Toolbox,
    r: v1::ComputeShapeFeaturesRequest,
) -> Result<v1::ComputeShapeFeaturesResponse> {
    let cloud = convert::cloud(t, "cloud", r.cloud.as_ref(), r.cloud_handle.as_deref())?;
    Ok(segmentation::shape_to(&ops::shape_features(&cloud.positions)?))
}

pub(super) fn detect_objects(t: &Toolbox, r: v1::DetectObjectsRequest) -> Result<v1::DetectObjectsResponse> {
    let cloud = convert::cloud(t, "cloud", r.cloud.as_ref(), r.cloud_handle.as_deref())?;
    Ok(segmentation::detections_to(&ops::detect_objects(&cloud, t.detector())?))
}
