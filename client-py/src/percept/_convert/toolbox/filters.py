"""Filters, sampling, normals."""

from __future__ import annotations

from collections.abc import Sequence

from ... import _rpc
from ..._arrays import Array
from ..._call import Call
from ...types.geometry import PointCloud, Pose
from ...types.toolbox import FilteredCloud
from ...v1 import toolbox_service_pb2 as service
from .. import geometry
from .request import Cloud, uint32_array, uint32s, with_cloud


def remove_statistical_outliers(
    cloud: Cloud, num_neighbors: int | None, std_ratio: float | None
) -> Call[service.RemoveStatisticalOutliersRequest, service.RemoveStatisticalOutliersResponse, FilteredCloud]:
    def read(answer: service.RemoveStatisticalOutliersResponse) -> FilteredCloud:
        return FilteredCloud(cloud=geometry.cloud(answer.cloud), indices=uint32_array(answer.indices))

    request = with_cloud(
        service.RemoveStatisticalOutliersRequest, cloud, num_neighbors=num_neighbors, std_ratio=std_ratio
    )
    return Call(_rpc.REMOVE_STATISTICAL_OUTLIERS, request, read)


def remove_radius_outliers(
    cloud: Cloud, radius_m: float | None, min_neighbors: int | None
) -> Call[service.RemoveRadiusOutliersRequest, service.RemoveRadiusOutliersResponse, FilteredCloud]:
    def read(answer: service.RemoveRadiusOutliersResponse) -> FilteredCloud:
        return FilteredCloud(cloud=geometry.cloud(answer.cloud), indices=uint32s(answer.indices))

    request = with_cloud(
        service.RemoveRadiusOutliersRequest, cloud, radius_m=radius_m, min_neighbors=min_neighbors
    )
    return Call(_rpc.REMOVE_RADIUS_OUTLIERS, request, read)


def remove_non_finite(
    cloud: Cloud,
) -> Call[service.RemoveNonFiniteRequest, service.RemoveNonFiniteResponse, PointCloud]:
    request = with_cloud(service.RemoveNonFiniteRequest, cloud)
    return Call(_rpc.REMOVE_NON_FINITE, request, lambda a: geometry.cloud(a.cloud))


def transform_cloud(
    cloud: Cloud, t_a_b: Pose | Array
) -> Call[service.TransformCloudRequest, service.TransformCloudResponse, PointCloud]:
    request = with_cloud(service.TransformCloudRequest, cloud, t_a_b=t_a_b)
    return Call(_rpc.TRANSFORM_CLOUD, request, lambda a: geometry.cloud(a.cloud))


def downsample_voxels(
    cloud: Cloud, voxel_size_m: float | None
) -> Call[service.DownsampleVoxelsRequest, service.DownsampleVoxelsResponse, PointCloud]:
    request = with_cloud(service.DownsampleVoxelsRequest, cloud, voxel_size_m=voxel_size_m)
    return Call(_rpc.DOWNSAMPLE_VOXELS, request, lambda a: geometry.cloud(a.cloud))


def estimate_normals(
    cloud: Cloud, radius_m: float | None, max_neighbors: int | None, viewpoint_m: Sequence[float] | None
) -> Call[service.EstimateNormalsRequest, service.EstimateNormalsResponse, PointCloud]:
    request = with_cloud(
        service.EstimateNormalsRequest,
        cloud,
        radius_m=radius_m,
        max_neighbors=max_neighbors,
        viewpoint_m=viewpoint_m,
    )
    return Call(_rpc.ESTIMATE_NORMALS, request, lambda a: geometry.cloud(a.cloud))
