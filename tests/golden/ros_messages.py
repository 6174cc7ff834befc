#!/usr/bin/env python3
"""Writes what server/ros is tested against: messages as `rosbags`, an implementation of its own, has them.

    pip install rosbags
    tests/golden/ros_messages.py [FOLDER]        # default: server/ros/tests/golden

One JSON file a type: its type hash, and cases, each with the encoding (`cdr_le`, `cdr_be`, `ros1`), the bytes in
hexadecimal, and the value of every field. Values are made up so that no two fields of a message are alike.
"""

from __future__ import annotations

import json
import math
import pathlib
import sys
import typing

import numpy
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

ROOT = pathlib.Path(__file__).resolve().parents[2]

TYPES = [
    "builtin_interfaces/msg/Time",
    "builtin_interfaces/msg/Duration",
    "std_msgs/msg/Header",
    "std_msgs/msg/ColorRGBA",
    "geometry_msgs/msg/Point",
    "geometry_msgs/msg/PointStamped",
    "geometry_msgs/msg/Vector3",
    "geometry_msgs/msg/Quaternion",
    "geometry_msgs/msg/Pose",
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseArray",
    "geometry_msgs/msg/PoseWithCovariance",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "geometry_msgs/msg/Transform",
    "geometry_msgs/msg/TransformStamped",
    "geometry_msgs/msg/Twist",
    "geometry_msgs/msg/TwistStamped",
    "geometry_msgs/msg/TwistWithCovariance",
    "geometry_msgs/msg/TwistWithCovarianceStamped",
    "geometry_msgs/msg/Accel",
    "sensor_msgs/msg/PointCloud2",
    "sensor_msgs/msg/Image",
    "sensor_msgs/msg/CompressedImage",
    "sensor_msgs/msg/CameraInfo",
    "sensor_msgs/msg/LaserScan",
    "sensor_msgs/msg/Imu",
    "sensor_msgs/msg/JointState",
    "sensor_msgs/msg/NavSatFix",
    "nav_msgs/msg/Odometry",
    "nav_msgs/msg/OccupancyGrid",
    "nav_msgs/msg/Path",
    "map_msgs/msg/OccupancyGridUpdate",
    "point_cloud_interfaces/msg/CompressedPointCloud2",
    "tf2_msgs/msg/TFMessage",
    "visualization_msgs/msg/MarkerArray",
    "vision_msgs/msg/Detection3DArray",
]

# What `rosbags` does not bring along, by the packages' own definitions.
ADDED = {
    "map_msgs/msg/OccupancyGridUpdate": (
        "std_msgs/Header header\nint32 x\nint32 y\nuint32 width\nuint32 height\nint8[] data\n"
    ),
    "point_cloud_interfaces/msg/CompressedPointCloud2": (
        "std_msgs/Header header\nuint32 height\nuint32 width\nsensor_msgs/PointField[] fields\nbool is_bigendian\n"
        "uint32 point_step\nuint32 row_step\nuint8[] compressed_data\nbool is_dense\nstring format\n"
    ),
}
ADDED_ROS2 = {
    "vision_msgs/msg/ObjectHypothesis": "string class_id\nfloat64 score\n",
    "vision_msgs/msg/ObjectHypothesisWithPose": (
        "ObjectHypothesis hypothesis\ngeometry_msgs/PoseWithCovariance pose\n"
    ),
    "vision_msgs/msg/BoundingBox3D": "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size\n",
    "vision_msgs/msg/Detection3D": (
        "std_msgs/Header header\nObjectHypothesisWithPose[] results\nBoundingBox3D bbox\nstring id\n"
    ),
    "vision_msgs/msg/Detection3DArray": "std_msgs/Header header\nvision_msgs/Detection3D[] detections\n",
}
ADDED_ROS1 = {"tf2_msgs/msg/TFMessage": "geometry_msgs/TransformStamped[] transforms\n"}
# What ROS 1 has otherwise, and the crate does not read.
NOT_IN_ROS1 = {"vision_msgs/msg/Detection3DArray"}

DTYPES = {
    "float32": numpy.float32,
    "float64": numpy.float64,
    **{f"{u}int{bits}": getattr(numpy, f"{u}int{bits}") for u in ("", "u") for bits in (8, 16, 32, 64)},
}
INTEGERS = {f"{u}int{bits}": 2**bits for u in ("", "u") for bits in (8, 16, 32, 64)}


class Maker:
    """Values that differ from each other, of any type of a store; sequences of `length`."""

    def __init__(self, store: Typestore, length: int) -> None:
        """Begin to count."""
        self.store, self.length, self.count = store, length, 0

    def message(self, name: str) -> object:
        """Make a message, field by field."""
        fields = self.store.fielddefs[name][1]
        return self.store.types[name](**{field: self.value(*definition) for field, definition in fields})

    def value(self, kind: typing.Any, definition: typing.Any) -> object:
        """Make a value of a field."""
        if kind.name == "BASE":
            return self.primitive(definition[0])
        if kind.name == "NAME":
            return self.message(definition)
        (inner_kind, inner), bound = definition
        length = bound if kind.name == "ARRAY" else self.length
        if inner_kind.name == "BASE" and inner[0] in DTYPES:
            return numpy.array([self.primitive(inner[0]) for _ in range(length)], dtype=DTYPES[inner[0]])
        return [self.value(inner_kind, inner) for _ in range(length)]

    def primitive(self, name: str) -> object:
        """Make a value of a primitive type: negative where it may be, and not finite now and then."""
        self.count += 1
        if name == "string":
            return "" if self.length == 0 else "é" * (self.count % 3) + f"text{self.count}"
        if name == "bool":
            return self.count % 2 == 0
        if name.startswith("float"):
            odd = {7: math.inf, 11: -math.inf, 13: math.nan} if self.length else {}
            return odd.get(self.count % 17, self.count * 1.25 * (-1) ** self.count)
        value = self.count * 0x0102_0408_1020_4081 % INTEGERS[name]
        return value - INTEGERS[name] // 2 if name.startswith("int") else value


def plain(value: object, store: Typestore) -> object:
    """Bring a value of a message into what JSON has; of numbers that are not finite, their names."""
    if isinstance(value, numpy.ndarray):
        return [plain(v, store) for v in value.tolist()]
    if isinstance(value, list):
        return [plain(v, store) for v in value]
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    if hasattr(value, "__msgtype__"):
        names = [name for name, _ in store.fielddefs[value.__msgtype__][1]]
        # ROS 1 writes the camera's matrices in capitals.
        return {n.lower() if len(n) == 1 else n: plain(getattr(value, n), store) for n in names}
    return value


def stores() -> tuple[Typestore, Typestore]:
    """Know the types of ROS 2 and of ROS 1."""
    ros2, ros1 = get_typestore(Stores.ROS2_JAZZY), get_typestore(Stores.ROS1_NOETIC)
    for store, definitions in [(ros2, ADDED | ADDED_ROS2), (ros1, ADDED | ADDED_ROS1)]:
        new = {}
        for name, text in definitions.items():
            if name not in store.fielddefs:
                new.update(get_types_from_msg(text, name))
        store.register(new)
    return ros2, ros1


def main() -> None:
    """Write the files."""
    folder = pathlib.Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "server/ros/tests/golden"
    folder.mkdir(parents=True, exist_ok=True)
    ros2, ros1 = stores()
    for name in TYPES:
        cases = []
        for length in (2, 0):
            message = Maker(ros2, length).message(name)
            for encoding, little in [("cdr_le", True), ("cdr_be", False)]:
                data = bytes(ros2.serialize_cdr(message, name, little_endian=little))
                cases.append({"encoding": encoding, "bytes": data.hex(), "value": plain(message, ros2)})
            if name not in NOT_IN_ROS1:
                message = Maker(ros1, length).message(name)
                data = bytes(ros1.serialize_ros1(message, name))
                cases.append({"encoding": "ros1", "bytes": data.hex(), "value": plain(message, ros1)})
        golden = {"type": name, "hash": ros2.hash_rihs01(name), "cases": cases}
        path = folder / (name.replace("/msg/", ".") + ".json")
        path.write_text(json.dumps(golden, ensure_ascii=False) + "\n")


if __name__ == "__main__":
    main()
