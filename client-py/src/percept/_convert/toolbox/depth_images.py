"""Depth images cleaned up and taken apart."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from ... import _rpc
from ..._arrays import Array
from ..._call import Call
from ...errors import InvalidArgument
from ...types.frames import EncodedImage
from ...types.geometry import CameraIntrinsics, Pose
from ...types.shapes import DepthPlane, DepthPlanes
from ...v1 import toolbox_depth_service_pb2 as depth_pb
from .. import geometry
from .depth import colour_image, depth_image, put_colour, put_depth
from .request import fill, floats, of

Image = Array | EncodedImage | bytes


def filter_depth(
    depth: Image, metres_per_unit: float | None, filters: Sequence[tuple[str, Mapping[str, object]]]
) -> Call[depth_pb.FilterDepthRequest, depth_pb.FilterDepthResponse, Array]:
    request = depth_pb.FilterDepthRequest()
    put_depth(request.depth, depth, metres_per_unit)
    known = list(depth_pb.DepthFilter.DESCRIPTOR.fields_by_name)
    for name, params in filters:
        if name not in known:
            message = f"filter is {name!r}; choose one of {', '.join(known)}"
            raise InvalidArgument(message, reason="FILTER_UNKNOWN", field="filters")
        inner = getattr(request.filters.add(), name)
        inner.SetInParent()
        fill(inner, params)
    return Call(_rpc.FILTER_DEPTH, request, lambda a: depth_image(a.depth))


def _with_depth(
    kind: Any,  # noqa: ANN401
    depth: Image,
    metres_per_unit: float | None,
    fields: Mapping[str, object],
) -> Any:  # noqa: ANN401
    request = of(kind, **fields)
    put_depth(request.depth, depth, metres_per_unit)
    return request


def compute_depth_normals(
    depth: Image, intrinsics: CameraIntrinsics, metres_per_unit: float | None, **fields: object
) -> Call[depth_pb.ComputeDepthNormalsRequest, depth_pb.ComputeDepthNormalsResponse, Array]:
    def read(answer: depth_pb.ComputeDepthNormalsResponse) -> Array:
        return floats(answer.normals, intrinsics.height_px, intrinsics.width_px, 3)

    given = {"intrinsics": intrinsics, **fields}
    request = _with_depth(depth_pb.ComputeDepthNormalsRequest, depth, metres_per_unit, given)
    return Call(_rpc.COMPUTE_DEPTH_NORMALS, request, read)


def segment_depth_planes(
    depth: Image, intrinsics: CameraIntrinsics, metres_per_unit: float | None, **fields: object
) -> Call[depth_pb.SegmentDepthPlanesRequest, depth_pb.SegmentDepthPlanesResponse, DepthPlanes]:
    def read(answer: depth_pb.SegmentDepthPlanesResponse) -> DepthPlanes:
        planes = tuple(
            DepthPlane(
                plane=geometry.plane(p.plane),
                centre=geometry.vector3(p.centre),
                num_pixels=p.num_pixels,
                rms_m=p.rms_m,
            )
            for p in answer.planes
        )
        labels = np.frombuffer(answer.labels, "<i4").reshape(intrinsics.height_px, intrinsics.width_px)
        return DepthPlanes(planes=planes, labels=labels)

    given = {"intrinsics": intrinsics, **fields}
    request = _with_depth(depth_pb.SegmentDepthPlanesRequest, depth, metres_per_unit, given)
    return Call(_rpc.SEGMENT_DEPTH_PLANES, request, read)


def find_depth_edges(
    depth: Image, intrinsics: CameraIntrinsics, metres_per_unit: float | None, **fields: object
) -> Call[depth_pb.FindDepthEdgesRequest, depth_pb.FindDepthEdgesResponse, npt.NDArray[np.uint8]]:
    def read(answer: depth_pb.FindDepthEdgesResponse) -> npt.NDArray[np.uint8]:
        return np.frombuffer(answer.edges, np.uint8).reshape(intrinsics.height_px, intrinsics.width_px)

    given = {"intrinsics": intrinsics, **fields}
    request = _with_depth(depth_pb.FindDepthEdgesRequest, depth, metres_per_unit, given)
    return Call(_rpc.FIND_DEPTH_EDGES, request, read)


def register_colour(
    depth: Image,
    depth_camera: CameraIntrinsics,
    colour: Image,
    colour_camera: CameraIntrinsics,
    t_colour_depth: Pose | Array,
    metres_per_unit: float | None,
    max_jump_fraction: float | None,
) -> Call[
    depth_pb.RegisterColourRequest, depth_pb.RegisterColourResponse, tuple[Array, npt.NDArray[np.bool_]]
]:
    def read(answer: depth_pb.RegisterColourResponse) -> tuple[Array, npt.NDArray[np.bool_]]:
        image = colour_image(answer.colour)
        return image, np.frombuffer(answer.seen, np.uint8).reshape(image.shape[:2]).astype(bool)

    given = {
        "depth_camera": depth_camera,
        "colour_camera": colour_camera,
        "t_colour_depth": t_colour_depth,
        "max_jump_fraction": max_jump_fraction,
    }
    request = _with_depth(depth_pb.RegisterColourRequest, depth, metres_per_unit, given)
    put_colour(request.colour, colour)
    return Call(_rpc.REGISTER_COLOUR, request, read)
