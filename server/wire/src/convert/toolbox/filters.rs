//! Filters, sampling, normals: parameters of requests.

use super::{count, set};
use crate::convert::{geometry, unknown_enum};
use crate::v1;
use percept_perception::cloud::{NormalParams, RadiusOutlierParams, SpanningTreeParams, StatisticalOutlierParams};
use percept_service::Result;
use percept_service::toolbox::NormalOrientation;

/// Parameters of the outlier filter.
pub fn outlier_params(r: &v1::RemoveStatisticalOutliersRequest) -> StatisticalOutlierParams {
    let mut params = StatisticalOutlierParams::default();
    set(&mut params.num_neighbours, count(r.num_neighbours));
    set(&mut params.std_ratio, r.std_ratio);
    params
}

/// Parameters of the radius filter.
pub fn radius_params(r: &v1::RemoveRadiusOutliersRequest) -> RadiusOutlierParams {
    let mut params = RadiusOutlierParams::default();
    set(&mut params.radius_m, r.radius_m);
    set(&mut params.min_neighbours, count(r.min_neighbours));
    params
}

/// Edge of the voxels, metres.
pub fn voxel_size_m(r: &v1::DownsampleVoxelsRequest) -> f64 {
    r.voxel_size_m.unwrap_or(0.05)
}

/// Parameters of normals.
pub fn normal_params(r: &v1::EstimateNormalsRequest) -> NormalParams {
    let mut params = NormalParams::default();
    lay_over!(params, r: radius_m, max_neighbours, min_neighbours);
    params
}

/// To which side normals look.
///
/// # Errors
/// A viewpoint that is not finite; `ENUM_UNKNOWN`.
pub fn normal_orientation(r: &v1::EstimateNormalsRequest) -> Result<NormalOrientation> {
    use v1::NormalOrientation as O;
    match O::try_from(r.orientation) {
        Ok(O::Unspecified | O::Viewpoint) => {
            let viewpoint = geometry::vector("viewpoint_m", &r.viewpoint_m.unwrap_or_default())?;
            Ok(NormalOrientation::Viewpoint(viewpoint.into()))
        }
        Ok(O::SpanningTree) => {
            let mut params = SpanningTreeParams::default();
            lay_over!(params, r: tree_neighbours);
            Ok(NormalOrientation::SpanningTree(params))
        }
        Err(_) => Err(unknown_enum("orientation", r.orientation)),
    }
}
