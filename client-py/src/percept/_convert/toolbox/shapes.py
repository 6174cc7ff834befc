"""Neighbours, local features, boxes, hulls."""

from __future__ import annotations

import numpy as np

from ... import _rpc
from ..._arrays import Array, checked
from ..._call import Call
from ...types.shapes import Boxes, ConvexHull, LocalFeatures, Neighbors
from ...v1 import toolbox_service_pb2 as service
from .. import geometry
from .request import Cloud, floats, uint32s, with_cloud


def find_neighbors(
    cloud: Cloud, queries: Array | None, k: int | None, radius_m: float | None
) -> Call[service.FindNeighborsRequest, service.FindNeighborsResponse, Neighbors]:
    def read(answer: service.FindNeighborsResponse) -> Neighbors:
        return Neighbors(
            offsets=uint32s(answer.offsets),
            indices=uint32s(answer.indices),
            distances_m=floats(answer.distances_m),
        )

    packed = None if queries is None else checked("queries", queries, ("Q", 3), np.float32).tobytes()
    request = with_cloud(service.FindNeighborsRequest, cloud, queries=packed, k=k, radius_m=radius_m)
    return Call(_rpc.FIND_NEIGHBORS, request, read)


def compute_local_features(
    cloud: Cloud, k: int | None
) -> Call[service.ComputeLocalFeaturesRequest, service.ComputeLocalFeaturesResponse, LocalFeatures]:
    def read(answer: service.ComputeLocalFeaturesResponse) -> LocalFeatures:
        return LocalFeatures(
            linearity=floats(answer.linearity),
            planarity=floats(answer.planarity),
            scattering=floats(answer.scattering),
            verticality=floats(answer.verticality),
            curvature=floats(answer.curvature),
        )

    request = with_cloud(service.ComputeLocalFeaturesRequest, cloud, k=k)
    return Call(_rpc.COMPUTE_LOCAL_FEATURES, request, read)


def fit_boxes(cloud: Cloud) -> Call[service.FitBoxesRequest, service.FitBoxesResponse, Boxes]:
    def read(answer: service.FitBoxesResponse) -> Boxes:
        return Boxes(
            axis_aligned=geometry.box(answer.axis_aligned),
            upright=geometry.box(answer.upright),
            minimal=geometry.box(answer.minimal),
        )

    return Call(_rpc.FIT_BOXES, with_cloud(service.FitBoxesRequest, cloud), read)


def compute_convex_hull(
    cloud: Cloud,
) -> Call[service.ComputeConvexHullRequest, service.ComputeConvexHullResponse, ConvexHull]:
    def read(answer: service.ComputeConvexHullResponse) -> ConvexHull:
        return ConvexHull(
            vertices=np.frombuffer(answer.vertices, "<f8").reshape(-1, 3),
            triangles=uint32s(answer.triangles).reshape(-1, 3),
            volume_m3=answer.volume_m3,
            area_m2=answer.area_m2,
        )

    return Call(_rpc.COMPUTE_CONVEX_HULL, with_cloud(service.ComputeConvexHullRequest, cloud), read)
