"""The perception toolbox."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .. import _rpc
from .._arrays import Array
from .._call import Call
from ..types import frames
from ..types.geometry import CameraIntrinsics, PointCloud, Pose
from ..types.scene import Detection
from ..types.toolbox import (
    ClusterMethod,
    Clusters,
    FilteredCloud,
    PlaneKind,
    PlaneSegment,
    Registration,
    RegistrationMethod,
    Shape,
)
from ..v1 import toolbox_service_pb2 as service
from . import geometry, scene, sensors, words

Cloud = PointCloud | Array


def remove_statistical_outliers(
    cloud: Cloud, num_neighbors: int | None, std_ratio: float | None
) -> Call[service.RemoveStatisticalOutliersRequest, service.RemoveStatisticalOutliersResponse, FilteredCloud]:
    def read(answer: service.RemoveStatisticalOutliersResponse) -> FilteredCloud:
        indices = np.array(answer.indices, dtype=np.uint32)
        return FilteredCloud(cloud=geometry.cloud(answer.cloud), indices=indices)

    request = service.RemoveStatisticalOutliersRequest(
        cloud=geometry.cloud_to(cloud), num_neighbors=num_neighbors, std_ratio=std_ratio
    )
    return Call(_rpc.REMOVE_STATISTICAL_OUTLIERS, request, read)


def downsample_voxels(
    cloud: Cloud, voxel_size_m: float | None
) -> Call[service.DownsampleVoxelsRequest, service.DownsampleVoxelsResponse, PointCloud]:
    request = service.DownsampleVoxelsRequest(cloud=geometry.cloud_to(cloud), voxel_size_m=voxel_size_m)
    return Call(_rpc.DOWNSAMPLE_VOXELS, request, lambda a: geometry.cloud(a.cloud))


def estimate_normals(
    cloud: Cloud, radius_m: float | None, max_neighbors: int | None, viewpoint_m: Sequence[float] | None
) -> Call[service.EstimateNormalsRequest, service.EstimateNormalsResponse, PointCloud]:
    request = service.EstimateNormalsRequest(
        cloud=geometry.cloud_to(cloud),
        radius_m=radius_m,
        max_neighbors=max_neighbors,
        viewpoint_m=None if viewpoint_m is None else geometry.vector3_to("viewpoint_m", viewpoint_m),
    )
    return Call(_rpc.ESTIMATE_NORMALS, request, lambda a: geometry.cloud(a.cloud))


def segment_planes(
    cloud: Cloud,
    distance_m: float | None,
    max_iterations: int | None,
    max_planes: int | None,
    min_points: int | None,
    seed: int,
) -> Call[service.SegmentPlanesRequest, service.SegmentPlanesResponse, list[PlaneSegment]]:
    request = service.SegmentPlanesRequest(
        cloud=geometry.cloud_to(cloud),
        distance_m=distance_m,
        max_iterations=max_iterations,
        max_planes=max_planes,
        min_points=min_points,
        seed=seed,
    )
    return Call(_rpc.SEGMENT_PLANES, request, lambda a: [_segment(p) for p in a.planes])


def _segment(message: service.PlaneSegment) -> PlaneSegment:
    return PlaneSegment(
        plane=geometry.plane(message.plane),
        kind=words.word(PlaneKind, service.PlaneKind, message.kind),
        indices=np.array(message.indices, dtype=np.uint32),
    )


def cluster_points(
    cloud: Cloud, method: ClusterMethod | str, eps_m: float | None, min_points: int | None
) -> Call[service.ClusterPointsRequest, service.ClusterPointsResponse, Clusters]:
    def read(answer: service.ClusterPointsResponse) -> Clusters:
        labels = np.array(answer.labels, dtype=np.int32)
        return Clusters(labels=labels, num_clusters=answer.num_clusters)

    request = service.ClusterPointsRequest(
        cloud=geometry.cloud_to(cloud),
        method=words.number("method", service.ClusterMethod, method),
        eps_m=eps_m,
        min_points=min_points,
    )
    return Call(_rpc.CLUSTER_POINTS, request, read)


def compute_shape_features(
    cloud: Cloud,
) -> Call[service.ComputeShapeFeaturesRequest, service.ComputeShapeFeaturesResponse, Shape]:
    def read(answer: service.ComputeShapeFeaturesResponse) -> Shape:
        box = geometry.box(answer.upright_box)
        return Shape(features=scene.features(answer.features), upright_box=box)

    request = service.ComputeShapeFeaturesRequest(cloud=geometry.cloud_to(cloud))
    return Call(_rpc.COMPUTE_SHAPE_FEATURES, request, read)


def detect_objects(
    cloud: Cloud,
) -> Call[service.DetectObjectsRequest, service.DetectObjectsResponse, list[Detection]]:
    request = service.DetectObjectsRequest(cloud=geometry.cloud_to(cloud))
    return Call(_rpc.DETECT_OBJECTS, request, lambda a: [scene.detection(d) for d in a.detections])


def register_clouds(
    source: Cloud,
    target: Cloud,
    initial_guess: Pose | Array | None,
    method: RegistrationMethod | str,
    max_distance_m: float | None,
    max_iterations: int | None,
) -> Call[service.RegisterCloudsRequest, service.RegisterCloudsResponse, Registration]:
    request = service.RegisterCloudsRequest(
        source=geometry.cloud_to(source),
        target=geometry.cloud_to(target),
        initial_guess=None if initial_guess is None else geometry.pose_to(initial_guess),
        method=words.number("method", service.RegistrationMethod, method),
        max_distance_m=max_distance_m,
        max_iterations=max_iterations,
    )
    return Call(_rpc.REGISTER_CLOUDS, request, _registration)


def _registration(answer: service.RegisterCloudsResponse) -> Registration:
    return Registration(
        t_target_source=geometry.pose(answer.t_target_source),
        fitness=answer.fitness,
        rmse_m=answer.rmse_m,
        covariance=geometry.covariance(answer.covariance),
        iterations=answer.iterations,
        converged=answer.converged,
        degenerate_axes=tuple(answer.degenerate_axes),
    )


def unproject_depth(
    depth: Array | frames.EncodedImage,
    intrinsics: CameraIntrinsics,
    metres_per_unit: float | None,
    color: Array | frames.EncodedImage | None,
    stride: int | None,
    min_depth_m: float | None,
    max_depth_m: float | None,
) -> Call[service.UnprojectDepthRequest, service.UnprojectDepthResponse, PointCloud]:
    # The frames check the images.
    checked = frames.DepthFrame("", stamp_ns=0, depth=depth, metres_per_unit=metres_per_unit)
    request = service.UnprojectDepthRequest(
        intrinsics=geometry.intrinsics_to(intrinsics),
        stride=stride,
        min_depth_m=min_depth_m,
        max_depth_m=max_depth_m,
    )
    sensors.fill_depth(request.depth, checked.depth, metres_per_unit)
    if color is not None:
        sensors.fill_color(request.color, frames.CameraFrame("", stamp_ns=0, color=color).color)
    return Call(_rpc.UNPROJECT_DEPTH, request, lambda a: geometry.cloud(a.cloud))
