"""Filters, sampling, normals."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ... import _rpc
from ..._arrays import Array, checked
from ..._call import Call
from ...errors import InvalidArgument
from ...types.cloud import PointCloud
from ...types.geometry import OrientedBox, Pose
from ...types.toolbox import FilteredCloud
from ...v1 import toolbox_clouds_service_pb2 as clouds_pb
from .. import geometry
from .request import Cloud, of, uint32s, with_cloud


def remove_statistical_outliers(
    cloud: Cloud, num_neighbours: int | None, std_ratio: float | None
) -> Call[
    clouds_pb.RemoveStatisticalOutliersRequest, clouds_pb.RemoveStatisticalOutliersResponse, FilteredCloud
]:
    def read(answer: clouds_pb.RemoveStatisticalOutliersResponse) -> FilteredCloud:
        return FilteredCloud(cloud=geometry.cloud(answer.cloud), indices=uint32s(answer.indices))

    request = with_cloud(
        clouds_pb.RemoveStatisticalOutliersRequest, cloud, num_neighbours=num_neighbours, std_ratio=std_ratio
    )
    return Call(_rpc.REMOVE_STATISTICAL_OUTLIERS, request, read)


def remove_radius_outliers(
    cloud: Cloud, radius_m: float | None, min_neighbours: int | None
) -> Call[clouds_pb.RemoveRadiusOutliersRequest, clouds_pb.RemoveRadiusOutliersResponse, FilteredCloud]:
    def read(answer: clouds_pb.RemoveRadiusOutliersResponse) -> FilteredCloud:
        return FilteredCloud(cloud=geometry.cloud(answer.cloud), indices=uint32s(answer.indices))

    request = with_cloud(
        clouds_pb.RemoveRadiusOutliersRequest, cloud, radius_m=radius_m, min_neighbours=min_neighbours
    )
    return Call(_rpc.REMOVE_RADIUS_OUTLIERS, request, read)


def remove_non_finite(
    cloud: Cloud,
) -> Call[clouds_pb.RemoveNonFiniteRequest, clouds_pb.RemoveNonFiniteResponse, PointCloud]:
    request = with_cloud(clouds_pb.RemoveNonFiniteRequest, cloud)
    return Call(_rpc.REMOVE_NON_FINITE, request, lambda a: geometry.cloud(a.cloud))


def transform_cloud(
    cloud: Cloud, t_a_b: Pose | Array
) -> Call[clouds_pb.TransformCloudRequest, clouds_pb.TransformCloudResponse, PointCloud]:
    request = with_cloud(clouds_pb.TransformCloudRequest, cloud, t_a_b=t_a_b)
    return Call(_rpc.TRANSFORM_CLOUD, request, lambda a: geometry.cloud(a.cloud))


def downsample_voxels(
    cloud: Cloud, voxel_size_m: float | None
) -> Call[clouds_pb.DownsampleVoxelsRequest, clouds_pb.DownsampleVoxelsResponse, PointCloud]:
    request = with_cloud(clouds_pb.DownsampleVoxelsRequest, cloud, voxel_size_m=voxel_size_m)
    return Call(_rpc.DOWNSAMPLE_VOXELS, request, lambda a: geometry.cloud(a.cloud))


def estimate_normals(
    cloud: Cloud, **fields: object
) -> Call[clouds_pb.EstimateNormalsRequest, clouds_pb.EstimateNormalsResponse, PointCloud]:
    request = with_cloud(clouds_pb.EstimateNormalsRequest, cloud, **fields)
    return Call(_rpc.ESTIMATE_NORMALS, request, lambda a: geometry.cloud(a.cloud))


def sample_points(
    cloud: Cloud, every: int | None, random: int | None, farthest: int | None, seed: int
) -> Call[clouds_pb.SamplePointsRequest, clouds_pb.SamplePointsResponse, FilteredCloud]:
    if sum(way is not None for way in (every, random, farthest)) != 1:
        message = "give one of every, random and farthest"
        raise InvalidArgument(message, reason="FIELD_MISSING", field="sample")

    def read(answer: clouds_pb.SamplePointsResponse) -> FilteredCloud:
        return FilteredCloud(cloud=geometry.cloud(answer.cloud), indices=uint32s(answer.indices))

    request = with_cloud(
        clouds_pb.SamplePointsRequest, cloud, every=every, random=random, farthest=farthest, seed=seed
    )
    return Call(_rpc.SAMPLE_POINTS, request, read)


def crop_cloud(
    cloud: Cloud,
    box: OrientedBox | None,
    range_m: tuple[float, float] | None,
    centre: Sequence[float] | None,
    polygon: Array | None,
    z_m: tuple[float | None, float | None],
    outside: bool,
) -> Call[clouds_pb.CropCloudRequest, clouds_pb.CropCloudResponse, FilteredCloud]:
    if sum(region is not None for region in (box, range_m, polygon)) != 1:
        message = "give one of box, range_m and polygon"
        raise InvalidArgument(message, reason="FIELD_MISSING", field="region")

    def read(answer: clouds_pb.CropCloudResponse) -> FilteredCloud:
        return FilteredCloud(cloud=geometry.cloud(answer.cloud), indices=uint32s(answer.indices))

    request = with_cloud(clouds_pb.CropCloudRequest, cloud, box=box, outside=outside)
    if range_m is not None:
        low, high = range_m
        band = of(clouds_pb.RangeBand, centre=centre, min_range_m=low, max_range_m=high)
        request.range.CopyFrom(band)
    if polygon is not None:
        prism = of(clouds_pb.PolygonPrism, z_min_m=z_m[0], z_max_m=z_m[1])
        corners = checked("polygon", polygon, ("N", 2), np.float64, np.float32)
        prism.corners.extend(geometry.vector2_to("polygon", c) for c in corners)
        request.polygon.CopyFrom(prism)
    return Call(_rpc.CROP_CLOUD, request, read)
