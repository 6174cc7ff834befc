"""Ground, smooth regions, convex parts; pictures."""

from __future__ import annotations

import numpy as np

from ... import _rpc
from ..._arrays import Array, checked
from ..._call import Call
from ...types import frames
from ...types.cloud import Labels, labels_of
from ...types.toolbox import Clusters, Ground, GroundPatch, Supervoxels, SupportedObjects
from ...v1 import toolbox_pictures_service_pb2 as pictures_pb
from ...v1 import toolbox_segmentation_service_pb2 as segmentation_pb
from .. import geometry
from . import depth as images
from .request import Cloud, floats, int32s, of, uint32s, with_cloud


def segment_ground(
    cloud: Cloud, **fields: object
) -> Call[segmentation_pb.SegmentGroundRequest, segmentation_pb.SegmentGroundResponse, Ground]:
    return Call(
        _rpc.SEGMENT_GROUND, with_cloud(segmentation_pb.SegmentGroundRequest, cloud, **fields), ground
    )


def ground(answer: segmentation_pb.SegmentGroundResponse) -> Ground:
    patches = tuple(
        GroundPatch(plane=geometry.plane(p.plane), centre=geometry.vector3(p.centre), num_points=p.num_points)
        for p in answer.patches
    )
    return Ground(indices=uint32s(answer.indices), patches=patches)


def grow_regions(
    cloud: Cloud, **fields: object
) -> Call[segmentation_pb.GrowRegionsRequest, segmentation_pb.GrowRegionsResponse, Clusters]:
    return Call(_rpc.GROW_REGIONS, with_cloud(segmentation_pb.GrowRegionsRequest, cloud, **fields), regions)


def regions(answer: segmentation_pb.GrowRegionsResponse) -> Clusters:
    return Clusters(labels=int32s(answer.labels), num_clusters=answer.num_regions)


def compute_supervoxels(
    cloud: Cloud, **fields: object
) -> Call[segmentation_pb.ComputeSupervoxelsRequest, segmentation_pb.ComputeSupervoxelsResponse, Supervoxels]:
    def read(answer: segmentation_pb.ComputeSupervoxelsResponse) -> Supervoxels:
        return Supervoxels(
            labels=int32s(answer.labels),
            centres=floats(answer.centres, -1, 3),
            normals=floats(answer.normals, -1, 3),
            edges=uint32s(answer.edges).reshape(-1, 2),
        )

    request = with_cloud(segmentation_pb.ComputeSupervoxelsRequest, cloud, **fields)
    return Call(_rpc.COMPUTE_SUPERVOXELS, request, read)


def group_convex(
    parts: Supervoxels, **fields: object
) -> Call[segmentation_pb.GroupConvexRequest, segmentation_pb.GroupConvexResponse, Clusters]:
    def read(answer: segmentation_pb.GroupConvexResponse) -> Clusters:
        return Clusters(labels=int32s(answer.labels), num_clusters=answer.num_groups)

    request = of(
        segmentation_pb.GroupConvexRequest,
        centres=checked("centres", parts.centres, ("M", 3), np.float32).astype("<f4").tobytes(),
        normals=checked("normals", parts.normals, ("M", 3), np.float32).astype("<f4").tobytes(),
        edges=checked("edges", parts.edges, ("E", 2), np.uint32).astype("<u4").tobytes(),
        **fields,
    )
    return Call(_rpc.GROUP_CONVEX, request, read)


def segment_objects(
    cloud: Cloud, **fields: object
) -> Call[segmentation_pb.SegmentObjectsRequest, segmentation_pb.SegmentObjectsResponse, SupportedObjects]:
    return Call(
        _rpc.SEGMENT_OBJECTS, with_cloud(segmentation_pb.SegmentObjectsRequest, cloud, **fields), objects
    )


def objects(answer: segmentation_pb.SegmentObjectsResponse) -> SupportedObjects:
    return SupportedObjects(
        labels=int32s(answer.labels),
        num_objects=answer.num_objects,
        support=geometry.plane(answer.support) if answer.HasField("support") else None,
    )


def render_cloud(
    cloud: Cloud, labels: Labels | None, colouring: str | None, **fields: object
) -> Call[pictures_pb.RenderCloudRequest, pictures_pb.RenderCloudResponse, bytes]:
    packed = None if labels is None else labels_of(labels).astype("<i4").tobytes()
    request = with_cloud(pictures_pb.RenderCloudRequest, cloud, labels=packed, colouring=colouring, **fields)
    return Call(_rpc.RENDER_CLOUD, request, lambda a: a.png)


def render_depth(
    depth: Array | frames.EncodedImage | bytes, metres_per_unit: float | None, **fields: object
) -> Call[pictures_pb.RenderDepthRequest, pictures_pb.RenderDepthResponse, bytes]:
    request = of(pictures_pb.RenderDepthRequest, **fields)
    images.put_depth(request.depth, depth, metres_per_unit)
    return Call(_rpc.RENDER_DEPTH, request, lambda a: a.png)
