//! Ground, smooth regions, convex parts.

use super::cloud_error;
use crate::Result;
use nalgebra::Point3;
use percept_geometry::PointCloud;
use percept_perception::cloud::{Clusters, NormalParams, estimate_normals};
use percept_perception::segmentation::{
    self, ConvexityParams, Ground, GroundParams, Objects, ObjectsParams, RegionGrowingParams, SupervoxelParams,
    Supervoxels,
};

/// The ground of a scan in the sensor's frame, z up.
///
/// # Errors
/// `OUT_OF_RANGE` naming the parameter.
pub fn segment_ground(cloud: &PointCloud, params: &GroundParams) -> Result<Ground> {
    Ok(segmentation::segment_ground(&cloud.positions, params)?)
}

/// Regions in which the normal turns little; normals are estimated if the cloud has none.
///
/// # Errors
/// `OUT_OF_RANGE` naming the parameter.
pub fn grow_regions(cloud: &PointCloud, params: &RegionGrowingParams) -> Result<Clusters> {
    let estimated;
    let normals = match &cloud.normals {
        Some(normals) => normals,
        None => {
            params.validate()?;
            let (radius_m, max_neighbours) = (params.radius_m, params.max_neighbours);
            let normals = NormalParams { radius_m, max_neighbours, ..NormalParams::default() };
            estimated = estimate_normals(&cloud.positions, &normals, None)?;
            &estimated
        }
    };
    Ok(segmentation::grow_regions(&cloud.positions, normals, params)?)
}

/// Patches of even surface seen from a viewpoint, metres.
///
/// # Errors
/// `OUT_OF_RANGE` naming the parameter, `VOXEL_TOO_SMALL`.
pub fn supervoxels(cloud: &PointCloud, viewpoint: &Point3<f64>, params: &SupervoxelParams) -> Result<Supervoxels> {
    segmentation::supervoxels(&cloud.positions, viewpoint, params).map_err(cloud_error)
}

/// The convex group of each supervoxel; `labels` are not looked at. `seed_size_m` is that of the supervoxels.
///
/// # Errors
/// `OUT_OF_RANGE` naming the parameter.
pub fn group_convex(parts: &Supervoxels, seed_size_m: f64, params: &ConvexityParams) -> Result<Vec<u32>> {
    Ok(segmentation::group_convex(parts, seed_size_m, params)?)
}

/// What stands on the largest plane, seen from a viewpoint, metres.
///
/// # Errors
/// `OUT_OF_RANGE` naming the parameter, `VOXEL_TOO_SMALL`.
pub fn segment_objects(cloud: &PointCloud, viewpoint: &Point3<f64>, params: &ObjectsParams) -> Result<Objects> {
    segmentation::segment_objects(&cloud.positions, viewpoint, params).map_err(cloud_error)
}
