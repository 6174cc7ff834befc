"""Ground, smooth regions, convex parts; pictures."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ... import _rpc
from ..._arrays import Array, checked
from ..._call import Call
from ...types import frames
from ...types.toolbox import Clusters, Ground, GroundPatch, Supervoxels, SupportedObjects
from ...v1 import toolbox_pictures_pb2 as pictures
from ...v1 import toolbox_service_pb2 as service
from .. import geometry
from . import depth as images
from .request import Cloud, floats, of, uint32s, with_cloud


def _labels(data: bytes) -> npt.NDArray[np.int32]:
    return np.frombuffer(data, "<i4")


def segment_ground(
    cloud: Cloud, **fields: object
) -> Call[service.SegmentGroundRequest, service.SegmentGroundResponse, Ground]:
    return Call(_rpc.SEGMENT_GROUND, with_cloud(service.SegmentGroundRequest, cloud, **fields), ground)


def ground(answer: service.SegmentGroundResponse) -> Ground:
    patches = tuple(
        GroundPatch(plane=geometry.plane(p.plane), center=geometry.vector3(p.center), num_points=p.num_points)
        for p in answer.patches
    )
    return Ground(indices=uint32s(answer.indices), patches=patches)


def grow_regions(
    cloud: Cloud, **fields: object
) -> Call[service.GrowRegionsRequest, service.GrowRegionsResponse, Clusters]:
    return Call(_rpc.GROW_REGIONS, with_cloud(service.GrowRegionsRequest, cloud, **fields), regions)


def regions(answer: service.GrowRegionsResponse) -> Clusters:
    return Clusters(labels=_labels(answer.labels), num_clusters=answer.num_regions)


def compute_supervoxels(
    cloud: Cloud, **fields: object
) -> Call[service.ComputeSupervoxelsRequest, service.ComputeSupervoxelsResponse, Supervoxels]:
    def read(answer: service.ComputeSupervoxelsResponse) -> Supervoxels:
        return Supervoxels(
            labels=_labels(answer.labels),
            centers=floats(answer.centers, -1, 3),
            normals=floats(answer.normals, -1, 3),
            edges=uint32s(answer.edges).reshape(-1, 2),
        )

    request = with_cloud(service.ComputeSupervoxelsRequest, cloud, **fields)
    return Call(_rpc.COMPUTE_SUPERVOXELS, request, read)


def group_convex(
    parts: Supervoxels, **fields: object
) -> Call[service.GroupConvexRequest, service.GroupConvexResponse, Clusters]:
    def read(answer: service.GroupConvexResponse) -> Clusters:
        return Clusters(labels=_labels(answer.labels), num_clusters=answer.num_groups)

    request = of(
        service.GroupConvexRequest,
        centers=checked("centers", parts.centers, ("M", 3), np.float32).astype("<f4").tobytes(),
        normals=checked("normals", parts.normals, ("M", 3), np.float32).astype("<f4").tobytes(),
        edges=checked("edges", parts.edges, ("E", 2), np.uint32).astype("<u4").tobytes(),
        **fields,
    )
    return Call(_rpc.GROUP_CONVEX, request, read)


def segment_objects(
    cloud: Cloud, **fields: object
) -> Call[service.SegmentObjectsRequest, service.SegmentObjectsResponse, SupportedObjects]:
    return Call(_rpc.SEGMENT_OBJECTS, with_cloud(service.SegmentObjectsRequest, cloud, **fields), objects)


def objects(answer: service.SegmentObjectsResponse) -> SupportedObjects:
    return SupportedObjects(
        labels=_labels(answer.labels),
        num_objects=answer.num_objects,
        support=geometry.plane(answer.support) if answer.HasField("support") else None,
    )


def render_cloud(
    cloud: Cloud, labels: Array | None, coloring: str | None, **fields: object
) -> Call[pictures.RenderCloudRequest, pictures.RenderCloudResponse, bytes]:
    packed = None if labels is None else checked("labels", labels, ("N",), np.int32).astype("<i4").tobytes()
    request = with_cloud(pictures.RenderCloudRequest, cloud, labels=packed, coloring=coloring, **fields)
    return Call(_rpc.RENDER_CLOUD, request, lambda a: a.png)


def render_depth(
    depth: Array | frames.EncodedImage | bytes, metres_per_unit: float | None, **fields: object
) -> Call[pictures.RenderDepthRequest, pictures.RenderDepthResponse, bytes]:
    request = of(pictures.RenderDepthRequest, **fields)
    images.put_depth(request.depth, depth, metres_per_unit)
    return Call(_rpc.RENDER_DEPTH, request, lambda a: a.png)
