"""Planes, clusters, shapes, objects."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ... import _rpc
from ..._call import Call
from ...types.scene import Detection
from ...types.toolbox import ClusterMethod, Clusters, Environment, PlaneKind, PlaneSegment, Shape
from ...v1 import toolbox_segmentation_service_pb2 as segmentation_pb
from ...v1 import toolbox_shapes_service_pb2 as shapes_pb
from .. import geometry, scene, words
from .request import Cloud, int32s, with_cloud


def segment_planes(
    cloud: Cloud,
    distance_m: float | None,
    max_iterations: int | None,
    max_planes: int | None,
    min_points: int | None,
    seed: int,
    early_stop: bool | None,
    up: npt.ArrayLike | None,
) -> Call[segmentation_pb.SegmentPlanesRequest, segmentation_pb.SegmentPlanesResponse, list[PlaneSegment]]:
    request = with_cloud(
        segmentation_pb.SegmentPlanesRequest,
        cloud,
        distance_m=distance_m,
        max_iterations=max_iterations,
        max_planes=max_planes,
        min_points=min_points,
        seed=seed,
        early_stop=early_stop,
        up=up,
    )
    return Call(_rpc.SEGMENT_PLANES, request, planes)


def planes(answer: segmentation_pb.SegmentPlanesResponse) -> list[PlaneSegment]:
    labels = int32s(answer.labels)
    return [
        PlaneSegment(
            plane=geometry.plane(p.plane),
            kind=words.word(PlaneKind, segmentation_pb.PlaneKind, p.kind),
            tilt_rad=p.tilt_rad,
            indices=np.flatnonzero(labels == number).astype(np.uint32),
        )
        for number, p in enumerate(answer.planes)
    ]


def cluster_points(
    cloud: Cloud,
    method: ClusterMethod | str,
    eps_m: float | None,
    min_points: int | None,
    eps_slope: float | None,
) -> Call[segmentation_pb.ClusterPointsRequest, segmentation_pb.ClusterPointsResponse, Clusters]:
    request = with_cloud(
        segmentation_pb.ClusterPointsRequest,
        cloud,
        method=method,
        eps_m=eps_m,
        min_points=min_points,
        eps_slope=eps_slope,
    )
    return Call(_rpc.CLUSTER_POINTS, request, clusters)


def clusters(answer: segmentation_pb.ClusterPointsResponse) -> Clusters:
    return Clusters(labels=int32s(answer.labels), num_clusters=answer.num_clusters)


def compute_shape_features(
    cloud: Cloud,
) -> Call[shapes_pb.ComputeShapeFeaturesRequest, shapes_pb.ComputeShapeFeaturesResponse, Shape]:
    return Call(_rpc.COMPUTE_SHAPE_FEATURES, with_cloud(shapes_pb.ComputeShapeFeaturesRequest, cloud), shape)


def shape(answer: shapes_pb.ComputeShapeFeaturesResponse) -> Shape:
    return Shape(features=scene.features(answer.features), upright_box=geometry.box(answer.upright_box))


def detect_objects(
    cloud: Cloud,
    environment: Environment | str,
    sensor_height_m: float | None,
) -> Call[segmentation_pb.DetectObjectsRequest, segmentation_pb.DetectObjectsResponse, list[Detection]]:
    request = with_cloud(
        segmentation_pb.DetectObjectsRequest,
        cloud,
        environment=environment,
        sensor_height_m=sensor_height_m,
    )
    return Call(_rpc.DETECT_OBJECTS, request, detections)


def detections(answer: segmentation_pb.DetectObjectsResponse) -> list[Detection]:
    return [scene.detection(d) for d in answer.detections]
