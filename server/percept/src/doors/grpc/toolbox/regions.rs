//! Ground, smooth regions, convex parts: decode, call, encode.

use percept_service::Result;
use percept_service::toolbox::{self as ops, Toolbox};
use percept_wire::convert::toolbox::{self as convert, regions};
use percept_wire::v1;

pub(super) fn segment_ground(t: &Toolbox, r: v1::SegmentGroundRequest) -> Result<v1::SegmentGroundResponse> {
    let cloud = convert::cloud(t, "cloud", r.cloud.as_ref(), r.cloud_handle.as_deref())?;
    Ok(regions::ground_to(&ops::segment_ground(&cloud, &regions::ground_params(&r))?))
}

pub(super) fn grow_regions(t: &Toolbox, r: v1::GrowRegionsRequest) -> Result<v1::GrowRegionsResponse> {
    let cloud = convert::cloud(t, "cloud", r.cloud.as_ref(), r.cloud_handle.as_deref())?;
    Ok(regions::regions_to(&ops::grow_regions(&cloud, &regions::region_params(&r))?))
}

pub(super) fn compute_supervoxels(
    t: &Toolbox,
    r: v1::ComputeSupervoxelsRequest,
) -> Result<v1::ComputeSupervoxelsResponse> {
    let cloud = convert::cloud(t, "cloud", r.cloud.as_ref(), r.cloud_handle.as_deref())?;
    let (params, viewpoint) = regions::supervoxel_params(&r)?;
    Ok(regions::supervoxels_to(&ops::supervoxels(&cloud, &viewpoint, &params)?))
}

pub(super) fn group_convex(_: &Toolbox, r: v1::GroupConvexRequest) -> Result<v1::GroupConvexResponse> {
    let (params, seed_size_m) = regions::convexity_params(&r);
    Ok(regions::groups_to(&ops::group_convex(&regions::supervoxels(&r)?, seed_size_m, &params)?))
}

pub(super) fn segment_objects(t: &Toolbox, r: v1::SegmentObjectsRequest) -> Result<v1::SegmentObjectsResponse> {
    let cloud = convert::cloud(t, "cloud", r.cloud.as_ref(), r.cloud_handle.as_deref())?;
    let (params, viewpoint) = regions::objects_params(&r)?;
    Ok(regions::objects_to(&ops::segment_objects(&cloud, &viewpoint, &params)?))
}
