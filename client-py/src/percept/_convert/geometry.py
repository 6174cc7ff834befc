"""Poses, boxes, clouds, cameras."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from .._arrays import Array, vector
from ..errors import InvalidArgument, WrongType
from ..types._value import told
from ..types.cloud import PointCloud
from ..types.geometry import (
    CameraIntrinsics,
    DistortionModel,
    FloorPoint,
    OrientedBox,
    Plane,
    Pose,
    as_pose,
)
from ..v1 import geometry_pb2 as g
from ..v1 import layers_service_pb2, sensor_pb2
from . import words


def vector3_to(field: str, value: object) -> g.Vector3:
    """Three numbers as a message."""
    x, y, z = vector(field, value, 3).tolist()
    return g.Vector3(x=x, y=y, z=z)


def vector3(message: g.Vector3) -> npt.NDArray[np.float64]:
    """(3,)."""
    return np.array([message.x, message.y, message.z])


def vector2_to(field: str, value: object) -> g.Vector2:
    """Two numbers as a message."""
    x, y = vector(field, value, 2).tolist()
    return g.Vector2(x=x, y=y)


def vector2(message: g.Vector2) -> npt.NDArray[np.float64]:
    """(2,)."""
    return np.array([message.x, message.y])


def floor_to(field: str, value: FloorPoint) -> g.Vector2:
    """A place on the floor as a message: (x, y) in metres, or a pose there."""
    if isinstance(value, Pose):
        return vector2_to(field, value.translation[:2])
    try:
        length = len(value)
    except TypeError:
        length = 0
    if length == 2:
        return vector2_to(field, value)
    message = (
        f"{field} is {value!r}, which is no place on the floor; x, y, z and x, y, yaw look alike: "
        "give (x, y) in metres of the map, or Pose.from_xy_yaw(x, y, yaw)"
    )
    raise WrongType(message, reason="PLACE_INVALID", field=field)


def pose_to(value: Pose | Array, field: str = "pose") -> g.Pose:
    """A pose, or its (4, 4) matrix, as a message."""
    pose = as_pose(field, value)
    x, y, z, w = pose.rotation.tolist()
    translation = vector3_to("translation", pose.translation)
    return g.Pose(translation=translation, rotation=g.Quaternion(x=x, y=y, z=z, w=w))


def pose(message: g.Pose) -> Pose:
    """Absent parts are zero and no rotation."""
    q = message.rotation
    rotation = np.array([q.x, q.y, q.z, q.w]) if message.HasField("rotation") else np.array([0.0, 0, 0, 1])
    return Pose(translation=vector3(message.translation), rotation=rotation)


def covariance(message: g.Covariance6) -> npt.NDArray[np.float64]:
    """(6, 6); NaN where the server gave none."""
    values = np.array(message.values, dtype=np.float64)
    return values.reshape(6, 6) if values.size == 36 else np.full((6, 6), np.nan)


def box_to(box: OrientedBox) -> g.OrientedBox:
    """A box as a message."""
    return g.OrientedBox(t_frame_box=pose_to(box.t_frame_box), size_m=vector3_to("size_m", box.size_m))


def box(message: g.OrientedBox) -> OrientedBox:
    """A box."""
    return OrientedBox(t_frame_box=pose(message.t_frame_box), size_m=vector3(message.size_m))


def plane(message: g.Plane) -> Plane:
    """A plane."""
    return Plane(normal=vector3(message.normal), offset_m=message.offset_m)


def intrinsics_to(camera: CameraIntrinsics) -> sensor_pb2.CameraIntrinsics:
    """A camera as a message."""
    model = str(camera.distortion_model)
    enum = sensor_pb2.DistortionModel
    return sensor_pb2.CameraIntrinsics(
        width_px=camera.width_px,
        height_px=camera.height_px,
        fx_px=camera.fx_px,
        fy_px=camera.fy_px,
        cx_px=camera.cx_px,
        cy_px=camera.cy_px,
        distortion_model=words.number("distortion_model", enum, "unspecified" if model == "none" else model),
        distortion=camera.distortion,
    )


def intrinsics(message: sensor_pb2.CameraIntrinsics) -> CameraIntrinsics:
    """A camera."""
    if message.distortion_model == sensor_pb2.DISTORTION_MODEL_UNSPECIFIED:
        model = DistortionModel.NONE
    else:
        name = sensor_pb2.DistortionModel.Name(message.distortion_model)
        model = DistortionModel(name.removeprefix("DISTORTION_MODEL_").lower())
    return told(
        CameraIntrinsics,
        width_px=message.width_px,
        height_px=message.height_px,
        fx_px=message.fx_px,
        fy_px=message.fy_px,
        cx_px=message.cx_px,
        cy_px=message.cy_px,
        distortion_model=model,
        distortion=tuple(message.distortion),
    )


def cloud_to(cloud: PointCloud | Array) -> g.PointCloud:
    """A cloud, or its (N, 3) float32 points, as a message."""
    out = g.PointCloud()
    fill_cloud(out, cloud if isinstance(cloud, PointCloud) else PointCloud(cloud))
    return out


def fill_cloud(out: g.PointCloud, cloud: PointCloud) -> None:
    """Writes a cloud; channels that it has not stay absent."""
    out.num_points = cloud.num_points
    for name, field, _, _ in _CHANNELS:
        channel: Array | None = getattr(cloud, name)
        if channel is not None:
            setattr(out, field, channel.tobytes())


def sliced(cloud: PointCloud, part: slice) -> PointCloud:
    """Some of a cloud's points, with all channels."""
    channels = {name: getattr(cloud, name) for name, _, _, _ in _CHANNELS}
    points = channels.pop("points")[part]
    return PointCloud(points, **{name: c if c is None else c[part] for name, c in channels.items()})


def cloud(message: g.PointCloud) -> PointCloud:
    """A cloud; its arrays are views of what came in, and cannot be written."""
    return joined_cloud([message])


_CHANNELS: tuple[tuple[str, str, type, int], ...] = (
    ("points", "positions", np.float32, 3),
    ("colours", "colours", np.uint8, 3),
    ("intensities", "intensities", np.float32, 1),
    ("normals", "normals", np.float32, 3),
    ("time_offsets_s", "time_offsets_s", np.float32, 1),
)


def joined_cloud(messages: Sequence[g.PointCloud]) -> PointCloud:
    """One cloud of its parts; channels that the first part lacks are absent."""
    channels: dict[str, Any] = {}
    filled = [m for m in messages if m.num_points] or list(messages[:1])
    for name, field, dtype, width in _CHANNELS:
        if name == "points" or (filled and filled[0].HasField(field)):  # type: ignore[arg-type]
            data = b"".join(getattr(m, field) for m in filled)
            flat = np.frombuffer(data, np.dtype(dtype).newbyteorder("<"))
            channels[name] = flat.reshape(-1, width) if width > 1 else flat
    return PointCloud(channels.pop("points"), **channels)


def box3_to(
    field: str, low: Sequence[float] | None, high: Sequence[float] | None
) -> layers_service_pb2.Box3 | None:
    """A box between two corners; none if neither is given."""
    if (low is None) != (high is None):
        message = "low and high belong together; give both or neither"
        raise InvalidArgument(message, reason="FIELD_MISSING", field=field)
    if low is None or high is None:
        return None
    return layers_service_pb2.Box3(min=vector3_to(f"{field}.min", low), max=vector3_to(f"{field}.max", high))
