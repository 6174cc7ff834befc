"""Requests by their fields."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeAlias, TypeVar

import numpy as np
import numpy.typing as npt
from google.protobuf.internal.enum_type_wrapper import EnumTypeWrapper
from google.protobuf.message import Message

from ..._arrays import Array
from ...errors import InvalidArgument
from ...types.cloud import PointCloud
from ...types.toolbox import CloudFile, CloudHandle, SessionCloud
from ...v1 import toolbox_pb2 as shared
from .. import geometry, words

Cloud: TypeAlias = PointCloud | Array | CloudHandle | CloudFile | SessionCloud | bytes
M = TypeVar("M", bound=Message)


def of(kind: type[M], /, **fields: object) -> M:
    """A request of its fields; those that are None stay absent."""
    out = kind()
    fill(out, fields)
    return out


def with_cloud(kind: type[M], cloud: Cloud, /, **fields: object) -> M:
    """A request that works on a cloud."""
    out = of(kind, **fields)
    put_cloud(out, "cloud", cloud)
    return out


def put_cloud(out: Message, field: str, cloud: Cloud) -> None:
    """Says which cloud a field is about."""
    fill_source(getattr(out, field), cloud)


def fill_source(out: shared.CloudSource, cloud: Cloud) -> None:
    """A cloud or file that goes along, or where the server has it."""
    if isinstance(cloud, CloudHandle):
        out.handle = cloud.handle
    elif isinstance(cloud, SessionCloud):
        out.session.session_id = cloud.session_id
        fill(out.session, {"centre": cloud.centre, "radius_m": cloud.radius_m})
    elif isinstance(cloud, bytes):
        out.file.data = cloud
    elif isinstance(cloud, CloudFile):
        fill(out.file, {"data": cloud.data, "format": cloud.file_format})
    else:
        # An empty cloud is present, too.
        out.cloud.SetInParent()
        geometry.fill_cloud(out.cloud, cloud if isinstance(cloud, PointCloud) else PointCloud(cloud))


def fill(out: Message, fields: Mapping[str, object]) -> None:
    """Sets fields; words become enums, three numbers vectors, matrices poses."""
    known = out.DESCRIPTOR.fields_by_name
    for name, value in fields.items():
        if name not in known:
            message = f"{name} is no parameter; there are {', '.join(known)}"
            raise InvalidArgument(message, reason="PARAMS_INVALID", field=name)
        if value is not None:
            _set(out, known[name], value)


def _set(out: Message, field: Any, value: Any) -> None:  # noqa: ANN401
    name = field.name
    if hasattr(getattr(out, name), "extend"):
        try:
            getattr(out, name).extend(value)
        except (TypeError, ValueError) as cause:
            message = f"{name} is {value!r}, which does not fit: {cause}"
            raise InvalidArgument(message, reason="PARAMS_INVALID", field=name) from cause
    elif field.enum_type is not None:
        setattr(out, name, words.number(name, EnumTypeWrapper(field.enum_type), value))
    elif field.message_type is not None:
        getattr(out, name).CopyFrom(_message(name, field.message_type.name, value))
    else:
        try:
            setattr(out, name, value)
        except (TypeError, ValueError) as cause:
            message = f"{name} is {value!r}, which does not fit: {cause}"
            raise InvalidArgument(message, reason="PARAMS_INVALID", field=name) from cause


def _message(name: str, kind: str, value: Any) -> Message:  # noqa: ANN401
    if kind == "Vector3":
        return geometry.vector3_to(name, value)
    if kind == "Vector2":
        return geometry.vector2_to(name, value)
    if kind == "Pose" and not isinstance(value, Message):
        return geometry.pose_to(value, name)
    if kind == "OrientedBox":
        return geometry.box_to(value)
    if kind == "CameraIntrinsics":
        return geometry.intrinsics_to(value)
    if isinstance(value, Message):
        return value
    message = f"{name} is {value!r}, which is no {kind}"
    raise InvalidArgument(message, reason="PARAMS_INVALID", field=name)


def uint32s(data: bytes) -> npt.NDArray[np.uint32]:
    """(N,) of packed bytes."""
    return np.frombuffer(data, "<u4")


def floats(data: bytes, *shape: int) -> npt.NDArray[np.float32]:
    """float32 of packed bytes in a shape."""
    return np.frombuffer(data, "<f4").reshape(shape or (-1,))


def int32s(data: bytes) -> npt.NDArray[np.int32]:
    """(N,) of packed bytes."""
    return np.frombuffer(data, "<i4")
