"""Depth and colour images."""

from __future__ import annotations

import numpy as np

from ... import _rpc
from ..._arrays import Array
from ..._call import Call
from ...errors import InvalidArgument
from ...types import frames
from ...types.cloud import PointCloud
from ...types.geometry import CameraIntrinsics
from ...v1 import sensor_pb2
from ...v1 import toolbox_depth_service_pb2 as depth_pb
from .. import geometry, sensors
from .request import floats, of


def put_depth(
    out: sensor_pb2.DepthImage, depth: Array | frames.EncodedImage | bytes, metres_per_unit: float | None
) -> None:
    """Writes a depth image; the bytes of a PNG need no size."""
    if isinstance(depth, bytes):
        depth = frames.EncodedImage(data=depth, width_px=0, height_px=0)
    # The frames check the images.
    checked = frames.DepthFrame("", stamp_ns=0, depth=depth, metres_per_unit=metres_per_unit)
    sensors.fill_depth(out, checked.depth, metres_per_unit)


def put_colour(out: sensor_pb2.ColourImage, colour: Array | frames.EncodedImage | bytes) -> None:
    """Writes a colour image; the bytes of a PNG or JPEG need no size."""
    if isinstance(colour, bytes):
        colour = frames.EncodedImage(data=colour, width_px=0, height_px=0)
    sensors.fill_colour(out, frames.CameraFrame("", stamp_ns=0, colour=colour).colour)


def depth_image(message: sensor_pb2.DepthImage) -> Array:
    """(H, W) float32 metres; 0 is no return."""
    return floats(message.data, message.height_px, message.width_px)


def colour_image(message: sensor_pb2.ColourImage) -> Array:
    """(H, W, 3) uint8."""
    return np.frombuffer(message.data, np.uint8).reshape(message.height_px, message.width_px, 3)


def unproject_depth(
    depth: Array | frames.EncodedImage,
    intrinsics: CameraIntrinsics,
    metres_per_unit: float | None,
    colour: Array | frames.EncodedImage | None,
    stride: int | None,
    min_depth_m: float | None,
    max_depth_m: float | None,
) -> Call[depth_pb.UnprojectDepthRequest, depth_pb.UnprojectDepthResponse, PointCloud]:
    request = of(
        depth_pb.UnprojectDepthRequest,
        intrinsics=intrinsics,
        stride=stride,
        min_depth_m=min_depth_m,
        max_depth_m=max_depth_m,
    )
    put_depth(request.depth, depth, metres_per_unit)
    if colour is not None:
        put_colour(request.colour, colour)
    return Call(_rpc.UNPROJECT_DEPTH, request, lambda a: geometry.cloud(a.cloud))


def decode_depth(
    data: bytes, metres_per_unit: float
) -> Call[depth_pb.ConvertDepthRequest, depth_pb.ConvertDepthResponse, Array]:
    request = of(depth_pb.ConvertDepthRequest, encoding="f32")
    put_depth(request.depth, data, metres_per_unit)
    return Call(_rpc.CONVERT_DEPTH, request, lambda a: depth_image(a.depth))


def encode_depth(
    depth: Array, metres_per_unit: float | None, units: float
) -> Call[depth_pb.ConvertDepthRequest, depth_pb.ConvertDepthResponse, bytes]:
    request = of(depth_pb.ConvertDepthRequest, encoding="png16", metres_per_unit=units)
    put_depth(request.depth, depth, metres_per_unit)
    return Call(_rpc.CONVERT_DEPTH, request, lambda a: a.depth.data)


def convert_depth(
    depth: Array, metres_per_unit: float
) -> Call[depth_pb.ConvertDepthRequest, depth_pb.ConvertDepthResponse, Array]:
    def read(answer: depth_pb.ConvertDepthResponse) -> Array:
        image = answer.depth
        if image.encoding == sensor_pb2.DEPTH_ENCODING_U16:
            return np.frombuffer(image.data, "<u2").reshape(image.height_px, image.width_px)
        return depth_image(image)

    units = isinstance(depth, np.ndarray) and depth.dtype.kind == "u"
    request = of(
        depth_pb.ConvertDepthRequest,
        encoding="f32" if units else "u16",
        metres_per_unit=None if units else metres_per_unit,
    )
    put_depth(request.depth, depth, metres_per_unit if units else None)
    return Call(_rpc.CONVERT_DEPTH, request, read)


def decode_colour(data: bytes) -> Call[depth_pb.ConvertColourRequest, depth_pb.ConvertColourResponse, Array]:
    request = of(depth_pb.ConvertColourRequest, encoding="rgb8")
    put_colour(request.colour, data)
    return Call(_rpc.CONVERT_COLOUR, request, lambda a: colour_image(a.colour))


def encode_colour(
    colour: Array, encoding: str, quality: int | None
) -> Call[depth_pb.ConvertColourRequest, depth_pb.ConvertColourResponse, bytes]:
    if encoding not in ("png", "jpeg"):
        message = f"encoding is {encoding!r}; choose png or jpeg"
        raise InvalidArgument(message, reason="ENUM_UNKNOWN", field="encoding")
    request = of(depth_pb.ConvertColourRequest, encoding=encoding, quality=quality)
    put_colour(request.colour, colour)
    return Call(_rpc.CONVERT_COLOUR, request, lambda a: a.colour.data)
