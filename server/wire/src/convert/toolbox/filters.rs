//! Filters, sampling, normals: parameters of requests.

use super::{count, set};
use crate::convert::geometry;
use crate::v1;
use nalgebra::Point3;
use percept_perception::cloud::{NormalParams, RadiusOutlierParams, StatisticalOutlierParams};
use percept_service::Result;

/// Parameters of the outlier filter.
pub fn outlier_params(r: &v1::RemoveStatisticalOutliersRequest) -> StatisticalOutlierParams {
    let mut params = StatisticalOutlierParams::default();
    set(&mut params.num_neighbors, count(r.num_neighbors));
    set(&mut params.std_ratio, r.std_ratio);
    params
}

/// Parameters of the radius filter.
pub fn radius_params(r: &v1::RemoveRadiusOutliersRequest) -> RadiusOutlierParams {
    let mut params = RadiusOutlierParams::default();
    set(&mut params.radius_m, r.radius_m);
    set(&mut params.min_neighbors, count(r.min_neighbors));
    params
}

/// Edge of the voxels, metres.
pub fn voxel_size_m(r: &v1::DownsampleVoxelsRequest) -> f64 {
    r.voxel_size_m.unwrap_or(0.05)
}

/// Parameters of normals, and the viewpoint.
///
/// # Errors
/// A viewpoint that is not finite.
pub fn normal_params(r: &v1::EstimateNormalsRequest) -> Result<(NormalParams, Point3<f64>)> {
    let mut params = NormalParams::default();
    set(&mut params.radius_m, r.radius_m);
    set(&mut params.max_neighbors, count(r.max_neighbors));
    let viewpoint = geometry::vector("viewpoint_m", &r.viewpoint_m.unwrap_or_default())?;
    Ok((params, viewpoint.into()))
}
