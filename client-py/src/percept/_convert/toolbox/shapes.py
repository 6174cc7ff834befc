"""Neighbours, local features, boxes, hulls."""

from __future__ import annotations

import numpy as np

from ... import _rpc
from ..._arrays import Array, checked
from ..._call import Call
from ...types.shapes import Boxes, ConvexHull, LocalFeatures, Neighbours
from ...v1 import toolbox_shapes_service_pb2 as shapes_pb
from .. import geometry
from .request import Cloud, floats, uint32s, with_cloud


def find_neighbours(
    cloud: Cloud, queries: Array | None, k: int | None, radius_m: float | None
) -> Call[shapes_pb.FindNeighboursRequest, shapes_pb.FindNeighboursResponse, Neighbours]:
    def read(answer: shapes_pb.FindNeighboursResponse) -> Neighbours:
        return Neighbours(
            offsets=uint32s(answer.offsets),
            indices=uint32s(answer.indices),
            distances_m=floats(answer.distances_m),
        )

    packed = None if queries is None else checked("queries", queries, ("Q", 3), np.float32).tobytes()
    request = with_cloud(shapes_pb.FindNeighboursRequest, cloud, queries=packed, k=k, radius_m=radius_m)
    return Call(_rpc.FIND_NEIGHBOURS, request, read)


def compute_local_features(
    cloud: Cloud, k: int | None
) -> Call[shapes_pb.ComputeLocalFeaturesRequest, shapes_pb.ComputeLocalFeaturesResponse, LocalFeatures]:
    def read(answer: shapes_pb.ComputeLocalFeaturesResponse) -> LocalFeatures:
        return LocalFeatures(
            linearity=floats(answer.linearity),
            planarity=floats(answer.planarity),
            scattering=floats(answer.scattering),
            verticality=floats(answer.verticality),
            curvature=floats(answer.curvature),
        )

    request = with_cloud(shapes_pb.ComputeLocalFeaturesRequest, cloud, k=k)
    return Call(_rpc.COMPUTE_LOCAL_FEATURES, request, read)


def fit_boxes(cloud: Cloud) -> Call[shapes_pb.FitBoxesRequest, shapes_pb.FitBoxesResponse, Boxes]:
    def read(answer: shapes_pb.FitBoxesResponse) -> Boxes:
        return Boxes(
            axis_aligned=geometry.box(answer.axis_aligned),
            upright=geometry.box(answer.upright),
            minimal=geometry.box(answer.minimal),
        )

    return Call(_rpc.FIT_BOXES, with_cloud(shapes_pb.FitBoxesRequest, cloud), read)


def compute_convex_hull(
    cloud: Cloud,
) -> Call[shapes_pb.ComputeConvexHullRequest, shapes_pb.ComputeConvexHullResponse, ConvexHull]:
    def read(answer: shapes_pb.ComputeConvexHullResponse) -> ConvexHull:
        return ConvexHull(
            vertices=np.frombuffer(answer.vertices, "<f8").reshape(-1, 3),
            triangles=uint32s(answer.triangles).reshape(-1, 3),
            volume_m3=answer.volume_m3,
            area_m2=answer.area_m2,
        )

    return Call(_rpc.COMPUTE_CONVEX_HULL, with_cloud(shapes_pb.ComputeConvexHullRequest, cloud), read)
