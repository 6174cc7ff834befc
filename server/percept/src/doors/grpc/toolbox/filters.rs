//! Filters, sampling, normals: decode, call, encode.

use percept_service::Result;
use percept_service::toolbox::{self as ops, Toolbox};
use percept_wire::convert::toolbox::{filters, subsets};
use percept_wire::convert::{geometry, toolbox as convert};
use percept_wire::v1;

pub(super) fn remove_statistical_outliers(
    t: &Toolbox,
    r: v1::RemoveStatisticalOutliersRequest,
) -> Result<v1::RemoveStatisticalOutliersResponse> {
    let cloud = convert::cloud(t, "cloud", r.cloud.as_ref(), r.cloud_handle.as_deref())?;
    let (cloud, kept) = ops::remove_statistical_outliers(&cloud, &filters::outlier_params(&r))?;
    let indices = kept.into_iter().map(|i| i as u32).collect();
    let (cloud, kept) = convert::result(t, cloud, r.keep_result)?;
    Ok(v1::RemoveStatisticalOutliersResponse { cloud, indices, kept })
}

pub(super) fn remove_radius_outliers(
    t: &Toolbox,
    r: v1::RemoveRadiusOutliersRequest,
) -> Result<v1::RemoveRadiusOutliersResponse> {
    let cloud = convert::cloud(t, "cloud", r.cloud.as_ref(), r.cloud_handle.as_deref())?;
    let (cloud, kept) = ops::remove_radius_outliers(&cloud, &filters::radius_params(&r))?;
    let indices = convert::bytes_of_indices(&kept);
    let (cloud, kept) = convert::result(t, cloud, r.keep_result)?;
    Ok(v1::RemoveRadiusOutliersResponse { cloud, indices, kept })
}

pub(super) fn remove_non_finite(t: &Toolbox, r: v1::RemoveNonFiniteRequest) -> Result<v1::RemoveNonFiniteResponse> {
    let cloud = convert::cloud(t, "cloud", r.cloud.as_ref(), r.cloud_handle.as_deref())?;
    let (cloud, kept) = convert::result(t, cloud.retain_finite(), r.keep_result)?;
    Ok(v1::RemoveNonFiniteResponse { cloud, kept })
}

pub(super) fn transform_cloud(t: &Toolbox, r: v1::TransformCloudRequest) -> Result<v1::TransformCloudResponse> {
    let cloud = convert::cloud(t, "cloud", r.cloud.as_ref(), r.cloud_handle.as_deref())?;
    let t_a_b = geometry::pose("t_a_b", r.t_a_b.as_ref())?;
    let (cloud, kept) = convert::result(t, cloud.transformed(&t_a_b), r.keep_result)?;
    Ok(v1::TransformCloudResponse { cloud, kept })
}

pub(super) fn downsample_voxels(t: &Toolbox, r: v1::DownsampleVoxelsRequest) -> Result<v1::DownsampleVoxelsResponse> {
    let cloud = convert::cloud(t, "cloud", r.cloud.as_ref(), r.cloud_handle.as_deref())?;
    let cloud = ops::downsample_voxels(&cloud, filters::voxel_size_m(&r))?;
    let (cloud, kept) = convert::result(t, cloud, r.keep_result)?;
    Ok(v1::DownsampleVoxelsResponse { cloud, kept })
}

pub(super) fn estimate_normals(t: &Toolbox, r: v1::EstimateNormalsRequest) -> Result<v1::EstimateNormalsResponse> {
    let cloud = convert::cloud(t, "cloud", r.cloud.as_ref(), r.cloud_handle.as_deref())?;
    let (params, orientation) = (filters::normal_params(&r), filters::normal_orientation(&r)?);
    let (cloud, kept) = convert::result(t, ops::estimate_normals(&cloud, &params, &orientation)?, r.keep_result)?;
    Ok(v1::EstimateNormalsResponse { cloud, kept })
}

pub(super) fn sample_points(t: &Toolbox, r: v1::SamplePointsRequest) -> Result<v1::SamplePointsResponse> {
    let cloud = convert::cloud(t, "cloud", r.cloud.as_ref(), r.cloud_handle.as_deref())?;
    let (cloud, taken) = ops::sample_points(&cloud, &subsets::sample(&r)?)?;
    let indices = convert::bytes_of_indices(&taken);
    let (cloud, kept) = convert::result(t, cloud, r.keep_result)?;
    Ok(v1::SamplePointsResponse { cloud, indices, kept })
}

pub(super) fn crop_cloud(t: &Toolbox, r: v1::CropCloudRequest) -> Result<v1::CropCloudResponse> {
    let cloud = convert::cloud(t, "cloud", r.cloud.as_ref(), r.cloud_handle.as_deref())?;
    let (cloud, inside) = ops::crop_cloud(&cloud, &subsets::region(&r)?, r.outside)?;
    let indices = convert::bytes_of_indices(&inside);
    let (cloud, kept) = convert::result(t, cloud, r.keep_result)?;
    Ok(v1::CropCloudResponse { cloud, indices, kept })
}
