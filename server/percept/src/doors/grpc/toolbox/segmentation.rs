//! Planes, ground, clusters, regions, objects: decode, call, encode.

use percept_service::Result;
use percept_service::toolbox::{self as ops, Toolbox};
use percept_wire::convert::toolbox::{self as convert, regions, segmentation};
use percept_wire::v1;

operations! {
    toolbox_segmentation_service_server::ToolboxSegmentationService, "ToolboxSegmentationService/*",
    one {}
    parts {
        segment_planes(SegmentPlanesRequest) -> SegmentPlanesResponse as SegmentPlanesStream,
        segment_ground(SegmentGroundRequest) -> SegmentGroundResponse as SegmentGroundStream,
        cluster_points(ClusterPointsRequest) -> ClusterPointsResponse as ClusterPointsStream,
        grow_regions(GrowRegionsRequest) -> GrowRegionsResponse as GrowRegionsStream,
        compute_supervoxels(ComputeSupervoxelsRequest) -> ComputeSupervoxelsResponse as ComputeSupervoxelsStream,
        group_convex(GroupConvexRequest) -> GroupConvexResponse as GroupConvexStream,
        segment_objects(SegmentObjectsRequest) -> SegmentObjectsResponse as SegmentObjectsStream,
        detect_objects(DetectObjectsRequest) -> DetectObjectsResponse as DetectObjectsStream,
    }
}

fn segment_planes(t: &Toolbox, r: v1::SegmentPlanesRequest) -> Result<v1::SegmentPlanesResponse> {
    let cloud = convert::cloud(t, "cloud", r.cloud.as_ref())?;
    let planes = ops::segment_planes(&cloud, &segmentation::up(&r)?, &segmentation::planes_params(&r))?;
    Ok(segmentation::planes_to(&planes, cloud.len()))
}

fn segment_ground(t: &Toolbox, r: v1::SegmentGroundRequest) -> Result<v1::SegmentGroundResponse> {
    let cloud = convert::cloud(t, "cloud", r.cloud.as_ref())?;
    Ok(regions::ground_to(&ops::segment_ground(&cloud, &regions::ground_params(&r))?))
}

fn cluster_points(t: &Toolbox, r: v1::ClusterPointsRequest) -> Result<v1::ClusterPointsResponse> {
    let cloud = convert::cloud(t, "cloud", r.cloud.as_ref())?;
    let clusters = ops::cluster_points(&cloud, &segmentation::clustering(&r)?)?;
    Ok(segmentation::clusters_to(&clusters))
}

fn grow_regions(t: &Toolbox, r: v1::GrowRegionsRequest) -> Result<v1::GrowRegionsResponse> {
    let cloud = convert::cloud(t, "cloud", r.cloud.as_ref())?;
    Ok(regions::regions_to(&ops::grow_regions(&cloud, &regions::region_params(&r))?))
}

fn compute_supervoxels(t: &Toolbox, r: v1::ComputeSupervoxelsRequest) -> Result<v1::ComputeSupervoxelsResponse> {
    let cloud = convert::cloud(t, "cloud", r.cloud.as_ref())?;
    let (params, viewpoint) = regions::supervoxel_params(&r)?;
    Ok(regions::supervoxels_to(&ops::supervoxels(&cloud, &viewpoint, &params)?))
}

fn group_convex(_: &Toolbox, r: v1::GroupConvexRequest) -> Result<v1::GroupConvexResponse> {
    let (params, seed_size_m) = regions::convexity_params(&r);
    Ok(regions::groups_to(&ops::group_convex(&regions::supervoxels(&r)?, seed_size_m, &params)?))
}

fn segment_objects(t: &Toolbox, r: v1::SegmentObjectsRequest) -> Result<v1::SegmentObjectsResponse> {
    let cloud = convert::cloud(t, "cloud", r.cloud.as_ref())?;
    let (params, viewpoint) = regions::objects_params(&r)?;
    Ok(regions::objects_to(&ops::segment_objects(&cloud, &viewpoint, &params)?))
}

fn detect_objects(t: &Toolbox, r: v1::DetectObjectsRequest) -> Result<v1::DetectObjectsResponse> {
    let cloud = convert::cloud(t, "cloud", r.cloud.as_ref())?;
    let environment = segmentation::environment(&r)?;
    Ok(segmentation::detections_to(&ops::detect_objects(&cloud, t.detector(), &environment)?))
}
