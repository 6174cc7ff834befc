"""Planes, clusters, shapes, objects."""

from __future__ import annotations

import numpy as np

from ... import _rpc
from ..._call import Call
from ...types.scene import Detection
from ...types.toolbox import ClusterMethod, Clusters, PlaneKind, PlaneSegment, Shape
from ...v1 import toolbox_service_pb2 as service
from .. import geometry, scene, words
from .request import Cloud, uint32_array, with_cloud


def segment_planes(
    cloud: Cloud,
    distance_m: float | None,
    max_iterations: int | None,
    max_planes: int | None,
    min_points: int | None,
    seed: int,
    early_stop: bool | None,
) -> Call[service.SegmentPlanesRequest, service.SegmentPlanesResponse, list[PlaneSegment]]:
    request = with_cloud(
        service.SegmentPlanesRequest,
        cloud,
        distance_m=distance_m,
        max_iterations=max_iterations,
        max_planes=max_planes,
        min_points=min_points,
        seed=seed,
        early_stop=early_stop,
    )
    return Call(_rpc.SEGMENT_PLANES, request, planes)


def planes(answer: service.SegmentPlanesResponse) -> list[PlaneSegment]:
    return [
        PlaneSegment(
            plane=geometry.plane(p.plane),
            kind=words.word(PlaneKind, service.PlaneKind, p.kind),
            indices=uint32_array(p.indices),
        )
        for p in answer.planes
    ]


def cluster_points(
    cloud: Cloud,
    method: ClusterMethod | str,
    eps_m: float | None,
    min_points: int | None,
    eps_slope: float | None,
) -> Call[service.ClusterPointsRequest, service.ClusterPointsResponse, Clusters]:
    request = with_cloud(
        service.ClusterPointsRequest,
        cloud,
        method=method,
        eps_m=eps_m,
        min_points=min_points,
        eps_slope=eps_slope,
    )
    return Call(_rpc.CLUSTER_POINTS, request, clusters)


def clusters(answer: service.ClusterPointsResponse) -> Clusters:
    labels = np.fromiter(answer.labels, np.int32, len(answer.labels))
    return Clusters(labels=labels, num_clusters=answer.num_clusters)


def compute_shape_features(
    cloud: Cloud,
) -> Call[service.ComputeShapeFeaturesRequest, service.ComputeShapeFeaturesResponse, Shape]:
    return Call(_rpc.COMPUTE_SHAPE_FEATURES, with_cloud(service.ComputeShapeFeaturesRequest, cloud), shape)


def shape(answer: service.ComputeShapeFeaturesResponse) -> Shape:
    return Shape(features=scene.features(answer.features), upright_box=geometry.box(answer.upright_box))


def detect_objects(
    cloud: Cloud,
) -> Call[service.DetectObjectsRequest, service.DetectObjectsResponse, list[Detection]]:
    return Call(_rpc.DETECT_OBJECTS, with_cloud(service.DetectObjectsRequest, cloud), detections)


def detections(answer: service.DetectObjectsResponse) -> list[Detection]:
    return [scene.detection(d) for d in answer.detections]
