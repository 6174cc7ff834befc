//! Files, filters, samples, normals: decode, call, encode.

use percept_service::Result;
use percept_service::toolbox::{self as ops, Toolbox};
use percept_wire::convert::toolbox::{files, filters, subsets};
use percept_wire::convert::{geometry, toolbox as convert};
use percept_wire::v1;

operations! {
    toolbox_clouds_service_server::ToolboxCloudsService, "ToolboxCloudsService/*",
    one {}
    parts {
        decode_cloud(DecodeCloudRequest) -> DecodeCloudResponse as DecodeCloudStream,
        encode_cloud(EncodeCloudRequest) -> EncodeCloudResponse as EncodeCloudStream,
        remove_non_finite(RemoveNonFiniteRequest) -> RemoveNonFiniteResponse as RemoveNonFiniteStream,
        sample_points(SamplePointsRequest) -> SamplePointsResponse as SamplePointsStream,
        crop_cloud(CropCloudRequest) -> CropCloudResponse as CropCloudStream,
        transform_cloud(TransformCloudRequest) -> TransformCloudResponse as TransformCloudStream,
        remove_radius_outliers(RemoveRadiusOutliersRequest) -> RemoveRadiusOutliersResponse as RemoveRadiusOutliersStream,
        remove_statistical_outliers(RemoveStatisticalOutliersRequest) -> RemoveStatisticalOutliersResponse as RemoveStatisticalOutliersStream,
        downsample_voxels(DownsampleVoxelsRequest) -> DownsampleVoxelsResponse as DownsampleVoxelsStream,
        estimate_normals(EstimateNormalsRequest) -> EstimateNormalsResponse as EstimateNormalsStream,
    }
}

fn decode_cloud(t: &Toolbox, r: v1::DecodeCloudRequest) -> Result<v1::DecodeCloudResponse> {
    let (cloud, origin_m) = files::decoded(r.file.as_ref(), t.limits())?;
    let (cloud, kept) = convert::result(t, cloud, r.keep_result)?;
    Ok(v1::DecodeCloudResponse { cloud, origin_m: Some(origin_m), kept })
}

fn encode_cloud(t: &Toolbox, r: v1::EncodeCloudRequest) -> Result<v1::EncodeCloudResponse> {
    let cloud = convert::cloud(t, "cloud", r.cloud.as_ref())?;
    Ok(v1::EncodeCloudResponse { file: Some(files::encoded(&cloud, r.origin_m, r.format)?) })
}

fn remove_non_finite(t: &Toolbox, r: v1::RemoveNonFiniteRequest) -> Result<v1::RemoveNonFiniteResponse> {
    let cloud = convert::cloud(t, "cloud", r.cloud.as_ref())?;
    let (cloud, kept) = convert::result(t, cloud.retain_finite(), r.keep_result)?;
    Ok(v1::RemoveNonFiniteResponse { cloud, kept })
}

fn sample_points(t: &Toolbox, r: v1::SamplePointsRequest) -> Result<v1::SamplePointsResponse> {
    let cloud = convert::cloud(t, "cloud", r.cloud.as_ref())?;
    let (cloud, taken) = ops::sample_points(&cloud, &subsets::sample(&r)?)?;
    let indices = convert::bytes_of_indices(&taken);
    let (cloud, kept) = convert::result(t, cloud, r.keep_result)?;
    Ok(v1::SamplePointsResponse { cloud, indices, kept })
}

fn crop_cloud(t: &Toolbox, r: v1::CropCloudRequest) -> Result<v1::CropCloudResponse> {
    let cloud = convert::cloud(t, "cloud", r.cloud.as_ref())?;
    let (cloud, inside) = ops::crop_cloud(&cloud, &subsets::region(&r)?, r.outside)?;
    let indices = convert::bytes_of_indices(&inside);
    let (cloud, kept) = convert::result(t, cloud, r.keep_result)?;
    Ok(v1::CropCloudResponse { cloud, indices, kept })
}

fn transform_cloud(t: &Toolbox, r: v1::TransformCloudRequest) -> Result<v1::TransformCloudResponse> {
    let cloud = convert::cloud(t, "cloud", r.cloud.as_ref())?;
    let t_a_b = geometry::pose("t_a_b", r.t_a_b.as_ref())?;
    let (cloud, kept) = convert::result(t, cloud.transformed(&t_a_b), r.keep_result)?;
    Ok(v1::TransformCloudResponse { cloud, kept })
}

fn remove_radius_outliers(t: &Toolbox, r: v1::RemoveRadiusOutliersRequest) -> Result<v1::RemoveRadiusOutliersResponse> {
    let cloud = convert::cloud(t, "cloud", r.cloud.as_ref())?;
    let (cloud, kept) = ops::remove_radius_outliers(&cloud, &filters::radius_params(&r))?;
    let indices = convert::bytes_of_indices(&kept);
    let (cloud, kept) = convert::result(t, cloud, r.keep_result)?;
    Ok(v1::RemoveRadiusOutliersResponse { cloud, indices, kept })
}

fn remove_statistical_outliers(
    t: &Toolbox,
    r: v1::RemoveStatisticalOutliersRequest,
) -> Result<v1::RemoveStatisticalOutliersResponse> {
    let cloud = convert::cloud(t, "cloud", r.cloud.as_ref())?;
    let (cloud, kept) = ops::remove_statistical_outliers(&cloud, &filters::outlier_params(&r))?;
    let indices = convert::bytes_of_indices(&kept);
    let (cloud, kept) = convert::result(t, cloud, r.keep_result)?;
    Ok(v1::RemoveStatisticalOutliersResponse { cloud, indices, kept })
}

fn downsample_voxels(t: &Toolbox, r: v1::DownsampleVoxelsRequest) -> Result<v1::DownsampleVoxelsResponse> {
    let cloud = convert::cloud(t, "cloud", r.cloud.as_ref())?;
    let cloud = ops::downsample_voxels(&cloud, filters::voxel_size_m(&r))?;
    let (cloud, kept) = convert::result(t, cloud, r.keep_result)?;
    Ok(v1::DownsampleVoxelsResponse { cloud, kept })
}

fn estimate_normals(t: &Toolbox, r: v1::EstimateNormalsRequest) -> Result<v1::EstimateNormalsResponse> {
    let cloud = convert::cloud(t, "cloud", r.cloud.as_ref())?;
    let (params, orientation) = (filters::normal_params(&r), filters::normal_orientation(&r)?);
    let (cloud, kept) = convert::result(t, ops::estimate_normals(&cloud, &params, &orientation)?, r.keep_result)?;
    Ok(v1::EstimateNormalsResponse { cloud, kept })
}
